"""Least squares of the whitened motion on columns ``q(w) Phi(w)``, from the sums over experiments alone.

A column is a pattern over the nodes, ``q (L, n)``, times the lines of one scalar force or signal,
``Phi (E, L)``. All that least squares needs of two columns is
``Re sum_l (q_i^H q_j)_l (sum_e conj(Phi_i) Phi_j)_l``, so a law is tried by one DFT and a few sums, however many
linear elements are free beside it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from creak.gap.layout import settle
from creak.gap.properties import Property, properties_of, stiffness_change
from creak.gap.view import View
from creak.mechanics.effects import GROUND, Damping, Effect, Mass, Stiffness
from creak.records import Complex, Real

Indices = NDArray[np.int64]

LinearKind = type[Stiffness] | type[Damping] | type[Mass]

LinearKey = tuple[LinearKind | Property, tuple[str, ...]]
"""A linear element: `Stiffness`, `Damping` or `Mass`, and its place; or a property of the whole model."""

LINEAR: dict[type[Effect], int] = {Stiffness: 0, Damping: 1, Mass: 2}
"""Linear elements, and how often the displacement is differentiated for their force."""

_KEPT = 4  # projections of the linear elements that are remembered


@dataclass(frozen=True, eq=False)
class Column:
    """One term of the regression.

    Parameters
    ----------
    q : array, (L, n)
    phi : array, (E, L)
        At the experiments of both sets.
    fixed : bool
        Its coefficient is 1 and not fitted.
    """

    q: Complex
    phi: Complex
    fixed: bool = False

    def __post_init__(self) -> None:
        """Settle the layout."""
        settle(self)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Result of one regression.

    Parameters
    ----------
    linear : array, (K,)
        Coefficients of the linear elements; 0 where they were held.
    own : array
        Coefficients of the other columns.
    left, held : float
        Whitened power that is left a complex sample, on the experiments of the fit and on those kept aside.
    """

    linear: Real
    own: Real
    left: float
    held: float


def internal_places(names: Sequence[str]) -> list[tuple[str, str]]:
    """Every pair of nodes, and every node with the ground."""
    pairs = [(name, GROUND) for name in names]
    return pairs + [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]


def linear_elements(names: Sequence[str]) -> list[tuple[LinearKind, tuple[str, str]]]:
    """Springs and dampers at every place, masses at every node."""
    places = internal_places(names)
    out: list[tuple[LinearKind, tuple[str, str]]] = [(Stiffness, at) for at in places]
    out += [(Damping, at) for at in places]
    return out + [(Mass, at) for at in places if at[1] == GROUND]


class Sums:
    """Sums over experiments of one view with its linear elements, for a set that is fitted and one kept aside.

    The properties of a beam come after the elements; their columns are no product of a pattern and a force, so
    they are kept whole.

    Parameters
    ----------
    view : View
    fitted, held : array of int
        Experiments; where none are held, the fitted ones stand in.
    """

    def __init__(self, view: View, fitted: Indices, held: Indices) -> None:
        self.view = view
        self.sets = (fitted, held if len(held) else fitted)
        elements = linear_elements(view.names)
        names = properties_of(view.model)
        self.elements: list[LinearKey] = [*elements, *((name, ()) for name in names)]
        lines, n = len(view.s), view.rig.n
        self.q = np.stack([view.pattern(at, "internal") for _, at in elements], axis=-1)
        self.phi = np.stack(
            [(view.D @ view.weights(at)) * view.s ** LINEAR[kind] for kind, at in elements], axis=-1
        )
        self.whole = np.zeros((*view.r.shape, len(names)), dtype=np.complex128)
        for i, name in enumerate(names):
            change = stiffness_change(view.rig, view.model, name, view.s)
            self.whole[..., i] = np.einsum(
                "lnm,elm->eln", (view.columns[..., :n] @ change) / view.sigma[..., None], view.D[..., :n]
            )
        self._along: dict[tuple[int, bytes, bytes], Complex] = {}
        self.counts = tuple(len(chosen) * lines * view.rig.n for chosen in self.sets)
        between = np.einsum("lni,lnj->lij", self.q.conj(), self.q)
        self.gram, self.right, self.power, self._psi = [], [], [], []
        for chosen in self.sets:
            phi, r, whole = self.phi[chosen], view.r[chosen], self.whole[chosen]
            psi = np.matmul(phi.transpose(1, 2, 0).conj(), phi.transpose(1, 0, 2))  # (L, K, K)
            self._psi.append(psi)
            gram = np.sum((between * psi).real, axis=0)
            cross = np.einsum("elk,lnk,elnp->kp", phi.conj(), self.q.conj(), whole, optimize=True).real
            flat = whole.reshape(r.size, len(names))
            self.gram.append(np.block([[gram, cross], [cross.T, (flat.conj().T @ flat).real]]))
            onto = np.matmul(phi.transpose(1, 2, 0).conj(), r.transpose(1, 0, 2))  # (L, K, n)
            right = np.sum((self.q.conj().transpose(0, 2, 1) * onto).real, axis=(0, 2))
            self.right.append(np.concatenate([right, (flat.conj().T @ r.reshape(-1)).real]))
            self.power.append(float(np.sum(np.abs(r) ** 2)))

    def fit(self, columns: Sequence[Column] = (), free: NDArray[np.bool_] | None = None) -> Fitted:
        """Fit columns beside linear elements.

        Parameters
        ----------
        columns : sequence of Column
        free : array of bool, (K,), optional
            Linear elements that are fitted too; by default none.
        """
        K = len(self.elements)
        free = np.zeros(K, dtype=bool) if free is None else free
        first = self._system(0, columns, free)
        systems = [first, first if self.sets[1] is self.sets[0] else self._system(1, columns, free)]
        fixed = np.array([False] * int(free.sum()) + [column.fixed for column in columns], dtype=bool)
        gram, right, _ = systems[0]
        theta = fixed.astype(float)
        moving = ~fixed
        theta[moving] = solve(
            gram[np.ix_(moving, moving)], right[moving] - gram[np.ix_(moving, fixed)].sum(axis=1)
        )
        left = [
            (power - 2 * theta @ right + theta @ gram @ theta) / count
            for (gram, right, power), count in zip(systems, self.counts, strict=True)
        ]
        linear = np.zeros(K)
        linear[free] = theta[: int(free.sum())]
        return Fitted(linear, theta[int(free.sum()) :], float(left[0]), float(left[1]))

    def along(self, q: Complex, free: NDArray[np.bool_], beside: Sequence[Column] = ()) -> "Along":
        """Prepare to try many forces of one pattern, see `Along`."""
        gram, right, power = self._system(0, beside, free)
        fixed = np.array([False] * int(free.sum()) + [column.fixed for column in beside], dtype=bool)
        chosen = self.sets[0]
        target = np.einsum("ln,eln->el", q.conj(), self.view.r[chosen])
        others = np.concatenate(
            [
                self._seen_along(0, q, free),
                *(
                    (np.einsum("ln,ln->l", q.conj(), column.q) * column.phi[chosen]).reshape(-1, 1)
                    for column in beside
                ),
            ],
            axis=1,
        )
        if fixed.any():
            power = power - 2 * right[fixed].sum() + gram[np.ix_(fixed, fixed)].sum()
            right = right - gram[:, fixed].sum(axis=1)
            target = target - others[:, fixed].sum(axis=1).reshape(target.shape)
        moving = ~fixed
        return Along(
            np.sum(np.abs(q) ** 2, axis=1),
            target,
            others[:, moving],
            gram[np.ix_(moving, moving)],
            right[moving],
            power,
            self.counts[0],
        )

    def _system(self, which: int, columns: Sequence[Column], free: NDArray[np.bool_]) -> tuple[Real, Real, float]:
        """Normal equations of free linear elements, then columns."""
        chosen = self.sets[which]
        m = int(free.sum())
        size = m + len(columns)
        gram, right = np.zeros((size, size)), np.zeros(size)
        gram[:m, :m] = self.gram[which][np.ix_(free, free)]
        right[:m] = self.right[which][free]
        r = self.view.r[chosen]
        for i, column in enumerate(columns, start=m):
            own = column.phi[chosen].conj()
            if m:
                gram[i, :m] = gram[:m, i] = (own.reshape(-1) @ self._seen_along(which, column.q, free)).real
            right[i] = np.sum((column.q.conj() * np.einsum("el,eln->ln", own, r)).real)
            for j, other in enumerate(columns[: i - m + 1], start=m):
                psi_own = np.sum(own * other.phi[chosen], axis=0)
                gram[i, j] = gram[j, i] = np.sum((np.sum(column.q.conj() * other.q, axis=1) * psi_own).real)
        return gram, right, self.power[which]

    def _seen_along(self, which: int, q: Complex, free: NDArray[np.bool_]) -> Complex:
        """Free linear elements projected on a pattern, ``(E L, m)``; kept while an inner parameter is searched."""
        key = which, q.tobytes(), free.tobytes()
        if key not in self._along:
            plain, bound = np.split(free, [self.q.shape[-1]])
            chosen = self.sets[which]
            near = np.matmul(q.conj()[:, None], self.q[..., plain])[:, 0] * self.phi[chosen][..., plain]
            far = np.einsum("ln,elnp->elp", q.conj(), self.whole[chosen][..., bound])
            if len(self._along) >= _KEPT:
                self._along.pop(next(iter(self._along)))
            self._along[key] = np.concatenate([near, far], axis=-1).reshape(len(chosen) * len(q), int(free.sum()))
        return self._along[key]

    def beside_free_forces(self, patterns: Complex) -> Real:
        """Whitened power a complex sample that free forces at every two of some places leave, no element moved.

        Parameters
        ----------
        patterns : array, (L, n, k)
            Of the places.

        Returns
        -------
        array, (k, k)
            Relative to what is left to noise; on the diagonal that of one place.
        """
        n = patterns.shape[1]
        unit = patterns / np.maximum(np.linalg.norm(patterns, axis=1, keepdims=True), 1e-300)
        seen = np.matmul(unit.conj().transpose(0, 2, 1), self.view.r[self.sets[0]].transpose(1, 2, 0))  # (L, k, E)
        power = np.matmul(seen, seen.conj().transpose(0, 2, 1))
        alike = np.matmul(unit.conj().transpose(0, 2, 1), unit)
        own = np.einsum("lii->li", power).real
        apart = 1 - np.abs(alike) ** 2
        both = own[:, :, None] + own[:, None, :] - 2 * (power * alike.conj()).real
        # Two places of one pattern take what either does.
        taken = np.sum(np.where(apart > 1e-6, both / np.maximum(apart, 1e-6), own[:, :, None]), axis=0)
        np.fill_diagonal(taken, np.sum(own, axis=0))
        samples = np.full(taken.shape, (n - 2) / n if n > 2 else np.nan)
        np.fill_diagonal(samples, (n - 1) / n)
        return np.asarray((self.power[0] - taken) / (self.counts[0] * samples))

    def beside_free_force(self, patterns: Complex, free: NDArray[np.bool_]) -> float:
        """Whitened power a complex sample that a free force per line and experiment leaves at a place.

        Parameters
        ----------
        patterns : array, (L, n, k)
            Patterns of the place, or of several places together.
        free : array of bool, (K,)
            Linear elements fitted beside it.

        Returns
        -------
        float
            Relative to what is left to noise, ``n - k`` of n samples.
        """
        return self.fit_beside_free_force(patterns, free)[0]

    def fit_beside_free_force(self, patterns: Complex, free: NDArray[np.bool_]) -> tuple[float, Real]:
        """As `beside_free_force`, with the coefficients ``(K,)`` of linear elements, 0 where they were held."""
        n, k = patterns.shape[1:]
        basis = np.linalg.qr(patterns)[0]
        chosen = self.sets[0]
        plain, bound = np.split(free, [self.q.shape[-1]])
        r, phi, whole = self.view.r[chosen], self.phi[chosen][..., plain], self.whole[chosen][..., bound]
        linear = np.zeros(len(free))
        along = np.einsum("lnk,eln->elk", basis.conj(), r)
        power = self.power[0] - float(np.sum(np.abs(along) ** 2))
        if free.any():
            hq = np.einsum("lnk,lnj->lkj", basis.conj(), self.q[..., plain])
            hw = np.einsum("lnk,elnp->elkp", basis.conj(), whole)
            psi = self._psi[0][np.ix_(np.arange(len(basis)), plain, plain)]
            near = np.sum((np.einsum("lki,lkj->lij", hq.conj(), hq) * psi).real, axis=0)
            cross = np.einsum("elj,lkj,elkp->jp", phi.conj(), hq.conj(), hw, optimize=True).real
            flat = hw.reshape(along.size, hw.shape[-1])
            taken = np.block([[near, cross], [cross.T, (flat.conj().T @ flat).real]])
            gram = self.gram[0][np.ix_(free, free)] - taken
            onto = np.einsum("elj,elk->lkj", phi.conj(), along)
            lost = [np.sum((hq.conj() * onto).real, axis=(0, 1)), (flat.conj().T @ along.reshape(-1)).real]
            right = self.right[0][free] - np.concatenate(lost)
            theta = solve(gram, right, np.diag(self.gram[0])[free])
            power += -2 * theta @ right + theta @ gram @ theta
            linear[free] = theta
        return float(power / (self.counts[0] * (n - k) / n)), linear


class Along:
    """What a force of one pattern leaves, beside terms that stay: tried in a few products a force.

    Parameters
    ----------
    weight : array, (L,)
        Power of the pattern.
    target : array, (E, L)
        Whitened motion seen along the pattern.
    others : array, (E L, m)
        Free terms seen along it.
    gram, right : array, (m, m), (m,)
        Normal equations of the free terms.
    power : float
        Of the whitened motion.
    count : int
        Samples.
    """

    def __init__(
        self, weight: Real, target: Complex, others: Complex, gram: Real, right: Real, power: float, count: int
    ) -> None:
        self.weight, self.count = weight, count
        self.target = np.ascontiguousarray(target).reshape(-1).view(np.float64)
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        values, vectors = np.linalg.eigh(gram / np.outer(scale, scale)) if len(gram) else (np.zeros(0), gram)
        kept = values > 1e-10 * max(values[-1], 1e-300) if len(values) else np.zeros(0, dtype=bool)
        root = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
        self.onto = root.T @ right
        # Rows that are orthonormal beside one another, so that what they take of a force is a sum of squares.
        self.rows = np.ascontiguousarray((others @ root).T).view(np.float64)
        self.power = power - float(self.onto @ self.onto)

    def left(self, phi: Complex, *, fixed: bool) -> float:
        """Whitened power a complex sample that a force leaves, its coefficient fitted or 1.

        Parameters
        ----------
        phi : array, (E, L)
        fixed : bool
        """
        flat = np.ascontiguousarray(phi).reshape(-1).view(np.float64)
        taken = self.rows @ flat
        whole = float(np.sum(self.weight * (phi.real**2 + phi.imag**2)))
        size = max(whole - float(taken @ taken), 1e-10 * whole, 1e-300)
        along = float(flat @ self.target) - float(taken @ self.onto)
        return (self.power + (size - 2 * along if fixed else -along * along / size)) / self.count


def solve(gram: Real, right: Real, size: Real | None = None) -> Real:
    """Solve normal equations of columns of very unlike size; what the data do not determine stays 0.

    Parameters
    ----------
    gram : array, (K, K)
    right : array, (K,)
    size : array, (K,), optional
        Power of the columns; that of a column which a projection has all but removed is rounding, and it is
        recognised by its power before.
    """
    if not len(right):
        return np.zeros(0)
    scale = np.sqrt(np.maximum(np.diag(gram) if size is None else size, 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    kept = values > 1e-10 * max(values[-1], 1e-300)
    along = vectors.T @ (right / scale)
    return np.asarray(vectors[:, kept] @ (along[kept] / values[kept]) / scale)
