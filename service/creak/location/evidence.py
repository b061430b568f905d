"""What the data say about missing forces, place by place, whitened by noise."""

from dataclasses import dataclass

import numpy as np
import scipy.special
from numpy.typing import NDArray

from creak.compiling import vectorised
from creak.records import Complex, Real
from creak.statistics import Sums

Edge = tuple[int, int]
"""Indices of two nodes, the lower one first; the ground is number n."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the data say about forces, whitened by noise.

    Parameters
    ----------
    J, H : array, (F, n, n)
        See the module.
    free : int
        E - n, degrees of freedom of H.
    noise_free : int
        E(P - 1), degrees of freedom of the noise covariance.
    size : array, (F,)
        Factor by which forces are enlarged squared, so that no line is badly scaled.
    leverage : array, (F,)
        By how much the error of the estimated ``S``, acting on strong forces, raises the noise elsewhere.
    taken : tuple of Edge
        Elements whose forces were taken out; no circle among them.
    """

    J: Complex
    H: Complex
    free: int
    noise_free: int
    size: Real
    leverage: Real
    taken: tuple[Edge, ...] = ()

    @classmethod
    def of(cls, sums: Sums) -> "Evidence":
        """Whiten the sums' residuals."""
        n = sums.inputs
        E, P = sums.experiments, sums.periods
        noise = sums.within[:, n:, n:] / (E * (P - 1))
        # Nodes may have different units; with rows of unit noise the inverse stays sharp.
        unit = np.sqrt(np.einsum("fii->fi", noise).real)
        if not unit.all():
            raise np.linalg.LinAlgError("a channel without noise")
        noise = noise / (unit[:, :, None] * unit[:, None, :])
        between = sums.between[:, n:, n:] / (unit[:, :, None] * unit[:, None, :])
        S = sums.S / unit[:, :, None]
        size = np.linalg.norm(S, axis=(1, 2))
        S = S / size[:, None, None]
        weighted = np.linalg.solve(noise, S)
        J = _hermitian(_adjoint(S) @ weighted)
        H = _hermitian(_adjoint(weighted) @ between @ weighted / (E - n))
        inverse = np.linalg.inv(J)
        force = inverse @ H @ inverse / size[:, None, None] ** 2
        # The noise in S is that of the responses over the inputs, N_S = N U^H (U U^H)^-1, and a force f that is
        # there leaves N_S f at every other node.
        leverage = np.einsum("fii->f", np.linalg.solve(sums.between[:, :n, :n], force)).real
        return cls(J, H, E - n, E * (P - 1), size**2, leverage)

    @property
    def nodes(self) -> int:
        """Number of nodes, n."""
        return int(self.J.shape[1])

    @property
    def dimensions(self) -> int:
        """Directions of force that are left."""
        return self.nodes - len(self.taken)

    @property
    def bias(self) -> float:
        """Mean gain where there is no force: above 1, since the noise covariance is itself estimated.

        The product of the means of ``a^H C^-1 a`` and of 1 over the loss factor of I. S. Reed et al., *IEEE
        Trans. Aerospace and Electronic Systems* 10 (1974) 853, as it is known from adaptive arrays.
        """
        nu, n = self.noise_free, self.dimensions
        return nu**2 / ((nu - n) * (nu - n + 1)) if nu > n else np.inf

    def without(self, edges: tuple[Edge, ...]) -> "Evidence":
        """Take the forces of these elements out."""
        if not edges:
            return self
        J, H = self.J.copy(), self.H.copy()
        for i, j in edges:
            take_out(J, H, i, j)
        return Evidence(J, H, self.free, self.noise_free, self.size, self.leverage, self.taken + edges)

    def gains(self) -> tuple[tuple[Edge, ...], Real]:
        """Gain of every place that is left, over what noise alone gives: places, and ``(F, places)``."""
        n = self.nodes
        rows, columns = np.triu_indices(n, 1)
        power, reference = (np.empty((len(self.J), rows.size + n)) for _ in range(2))
        place_powers(self.H, power)
        place_powers(self.J, reference)
        edges = [*zip(rows.tolist(), columns.tolist(), strict=True), *((i, n) for i in range(n))]
        # An edge that closes a circle with elements taken out has nothing left but rounding.
        part = {
            vertex: number for number, edge in enumerate(parts_of(self.taken)) for end in edge for vertex in end
        }
        left = [k for k, (i, j) in enumerate(edges) if part.get(i, -1) != part.get(j, -2)]
        gains = power[:, left] / (reference[:, left] * (self.bias * (1.0 + self.leverage[:, None])))
        return tuple(edges[k] for k in left), np.maximum(gains, 1e-300)

    def explained(self, edges: tuple[Edge, ...]) -> float:
        """Part of the whitened power above noise that these elements account for."""
        rest = self.without(edges)
        whole = np.einsum("fij,fji->f", np.linalg.inv(self.J), self.H).real.sum()
        inside = np.einsum("fij,fji->f", np.linalg.inv(along(self.J, edges)), along(self.H, edges)).real.sum()
        floor, rest_floor = (
            len(self.J) * x.dimensions * x.noise_free / (x.noise_free - x.dimensions) for x in (self, rest)
        )
        return float(1.0 - np.clip((whole - inside - rest_floor) / (whole - floor), 0.0, 1.0))

    def scores(self, gains: Real) -> Real:
        """Log-likelihood ratio per line of a force of any power against none."""
        above = np.maximum(gains, 1.0)
        return np.asarray(self.free * (above - 1.0 - np.log(above)))

    def p_values(self, gains: Real) -> Real:
        """Probability of so large a gain if there is no force: a variance ratio for each line."""
        second = self.noise_free - self.dimensions + 1.0
        ratio = gains * second / (second - 1.0)
        return np.asarray(scipy.special.fdtrc(2.0 * self.free, 2.0 * second, ratio))


@vectorised
def take_out(J: Complex, H: Complex, i: int, j: int) -> None:
    """Take the force of one element out: ``J - p p^H / s`` with ``p = J a``, ``s = a^H J a``, and H likewise.

    One after another is the same as together: each leaves nothing of the evidence along its own vector a.

    Parameters
    ----------
    J, H : array, (F, n, n)
        Hermitian; changed in place.
    i, j : int
        Nodes of the element; j = n is the ground.
    """
    F, n, _ = J.shape
    p, b = np.empty(n, dtype=np.complex128), np.empty(n, dtype=np.complex128)
    for f in range(F):
        for k in range(n):
            p[k] = J[f, k, i]
            b[k] = H[f, k, i]
        if j < n:
            for k in range(n):
                p[k] -= J[f, k, j]
                b[k] -= H[f, k, j]
        own, power = p[i].real, b[i].real
        if j < n:
            own -= p[j].real
            power -= b[j].real
        # (I - p a^H / s) H (I - a p^H / s) = H - p c^H - c p^H with c = (b - p (a^H H a) / 2s) / s
        inverse = 1.0 / own
        for k in range(n):
            b[k] = (b[k] - p[k] * (0.5 * power * inverse)) * inverse
        for k in range(n):
            x = p[k] * inverse
            for m in range(k):
                J[f, k, m] -= x * p[m].conjugate()
                H[f, k, m] -= p[k] * b[m].conjugate() + b[k] * p[m].conjugate()
                J[f, m, k] = J[f, k, m].conjugate()
                H[f, m, k] = H[f, k, m].conjugate()
            J[f, k, k] = J[f, k, k].real - (p[k].real ** 2 + p[k].imag ** 2) * inverse
            H[f, k, k] = H[f, k, k].real - 2.0 * (p[k].real * b[k].real + p[k].imag * b[k].imag)


@vectorised
def place_powers(matrices: Complex, powers: Real) -> None:
    """``a^T M a`` of every place, ``(F, n, n)`` to ``(F, n (n + 1) / 2)``: pairs of nodes, then grounds."""
    F, n, _ = matrices.shape
    for f in range(F):
        place = 0
        for i in range(n):
            for j in range(i + 1, n):
                powers[f, place] = matrices[f, i, i].real + matrices[f, j, j].real - 2.0 * matrices[f, i, j].real
                place += 1
        for i in range(n):
            powers[f, place + i] = matrices[f, i, i].real


def along(matrix: Complex, edges: tuple[Edge, ...]) -> Complex:
    """``A^T M A`` with the incidence vectors as columns of A, ``(F, edges, edges)``."""
    powers = np.empty((len(matrix), len(edges), len(edges)), dtype=np.complex128)
    forces_along(matrix, np.array(edges), powers)
    return powers


@vectorised
def forces_along(matrices: Complex, edges: NDArray[np.int64], powers: Complex) -> None:
    """``A^T M A``, ``(F, n, n)`` to ``(F, edges, edges)``; edges are pairs of nodes, of which n is the ground."""
    F, n, _ = matrices.shape
    for f in range(F):
        for k in range(len(edges)):
            for m in range(len(edges)):
                total = 0.0j
                for a in range(2):
                    for b in range(2):
                        i, j = edges[k, a], edges[m, b]
                        if i < n and j < n:
                            total += matrices[f, i, j] if a == b else -matrices[f, i, j]
                powers[f, k, m] = total


def parts_of(edges: tuple[Edge, ...]) -> list[tuple[Edge, ...]]:
    """Edges that hang together, part by part."""
    parts: list[list[Edge]] = []
    for edge in edges:
        touched = [part for part in parts if any(set(edge) & set(other) for other in part)]
        parts = [part for part in parts if part not in touched]
        parts.append([*(other for part in touched for other in part), edge])
    return [tuple(part) for part in parts]


def incidence(edges: tuple[Edge, ...], nodes: int) -> Real:
    """Incidence vectors as columns, ``(n, edges)``; the ground has no row."""
    A = np.zeros((nodes + 1, len(edges)))
    for column, (i, j) in enumerate(edges):
        A[i, column], A[j, column] = 1.0, -1.0
    return A[:nodes]


def _adjoint(M: Complex) -> Complex:
    return M.conj().swapaxes(-1, -2)


def _hermitian(M: Complex) -> Complex:
    return (M + _adjoint(M)) / 2
