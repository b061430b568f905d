"""The streaming sums over realisations: ``of`` one, ``+`` of any, and nothing else.

Per excited line a block of realisations is held in a normal form: the best linear approximation ``S`` of the
block itself (28) and moments of ``V = [U; R]`` with the residual ``R = Y - S U``. Two blocks are merged by moving
both to the common ``S``, which is exact algebra on the moments (``R' = R + (S_old - S_new) U``), and adding.
Since ``R`` is as small as noise and distortion are, nothing large cancels however high the signal-to-noise ratio;
raw sums of ``Y`` would lose 4e-2 at 120 dB. Blocks whose residuals are taken about one and the same matrix near
their ``S`` (:attr:`Sums.about`) need no moving: they are added entry by entry, and brought into the normal form
when they are read.

In memory the lines come last, as :mod:`creak.moments` has them; the shapes below are views of that, except for the
moments, of which one half is kept, packed (:mod:`creak.hermitian`).

Everything in :mod:`creak.network` is algebra on these sums, whose size does not depend on how many realisations
they hold.
"""

import math
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from creak.hermitian import lines_last, quadratic_forms, shear, shear_vectors, unpack
from creak.moments import pool, residual_moments, responses
from creak.records import Complex, Real

_Array = TypeVar("_Array", Complex, Real)


@dataclass(frozen=True, eq=False)
class Sums:
    """Sufficient statistics of M complete realisations of q experiments of P periods.

    Merging is commutative, and associative but for rounding; :meth:`zero` is neutral. No operation changes an
    operand.

    Parameters
    ----------
    realisations : int
        M.
    periods : int
        P.
    S : array, (F, n, q)
        Mean over realisations of ``mean_p(Y) mean_p(U)^-1`` (28).
    spread : array, (F, n, q)
        Sum over realisations of ``|S[m] - S|^2``, entry by entry, as in (20).
    packed_between : array, ((q + n)^2, F)
        ``P sum_e conj-outer(mean_p V)``: moments of the period means; :attr:`between` has them as matrices.
    packed_within : array, ((q + n)^2, F)
        ``sum_e sum_p conj-outer(V - mean_p V)``: what changes from period to period is noise; so :attr:`within`.
    period_sums : array, (P, F, q + n)
        ``sum_e V`` for each period.
    about : array, (F, n, q), or None
        What the residuals in the moments are taken about, ``R = Y - about U``; None for ``S``, the normal form.
    """

    realisations: int
    periods: int
    S: Complex
    spread: Real
    packed_between: Real
    packed_within: Real
    period_sums: Complex
    about: Complex | None = None

    @classmethod
    def zero(cls, periods: int, lines: int, nodes: int, inputs: int) -> "Sums":
        """Sums of no realisation at all."""
        width = inputs + nodes
        return cls(
            realisations=0,
            periods=periods,
            S=np.zeros((lines, nodes, inputs), dtype=np.complex128),
            spread=np.zeros((lines, nodes, inputs)),
            packed_between=np.zeros((width**2, lines)),
            packed_within=np.zeros((width**2, lines)),
            period_sums=np.zeros((periods, lines, width), dtype=np.complex128),
        )

    @classmethod
    def of(cls, spectra: Complex, inputs: int, S: Complex | None = None) -> "Sums":
        """Sums of one complete realisation.

        Parameters
        ----------
        spectra : array, (q, P, F, q + n)
            DFT of inputs, then responses: experiment, period, line, channel. With the lines last in memory
            nothing is copied.
        inputs : int
            q.
        S : array, (F, n, q), or None
            ``mean_p(Y) mean_p(U)^-1`` if it is known already.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the input matrix of a line is singular.
        """
        V = np.ascontiguousarray(spectra.swapaxes(2, 3))
        periods, width, lines = V.shape[1:]
        if S is None:
            S = _response(V, inputs)
        between, within = np.empty((width**2, lines)), np.empty((width**2, lines))
        period_sums = np.empty((periods, width, lines), dtype=np.complex128)
        residual_moments(V, lines_last(S), between, within, period_sums)
        return cls(
            realisations=1,
            periods=periods,
            S=S,
            spread=np.zeros_like(S, dtype=np.float64),
            packed_between=between,
            packed_within=within,
            period_sums=period_sums.swapaxes(1, 2),
        )

    def __add__(self, other: "Sums") -> "Sums":
        """Sums of both operands' realisations together.

        Raises
        ------
        ValueError
            If they are not of the same rig and number of periods.
        """
        if (self.period_sums.shape, self.S.shape) != (other.period_sums.shape, other.S.shape):
            raise ValueError(
                f"sums of different measurements: periods, lines, channels {self.period_sums.shape} "
                f"and {other.period_sums.shape}, S {self.S.shape} and {other.S.shape}"
            )
        M = self.realisations + other.realisations
        if M == 0:
            return self
        S, spread = self._pooled(other)
        about = self.about if _same(self.about, other.about) else None
        a, b = (self, other) if about is not None else (self.moved(S), other.moved(S))
        return Sums(
            realisations=M,
            periods=self.periods,
            S=S,
            spread=spread,
            packed_between=a.packed_between + b.packed_between,
            packed_within=a.packed_within + b.packed_within,
            period_sums=a.period_sums + b.period_sums,
            about=about,
        )

    def _pooled(self, other: "Sums") -> tuple[Complex, Real]:
        """Mean `S` and `spread` of both operands' realisations."""
        own, others = lines_last(self.S), lines_last(other.S)
        S, spread = np.empty_like(own), np.empty(own.shape)
        weights = float(self.realisations), float(other.realisations)
        pool(own, lines_last(self.spread), weights[0], others, lines_last(other.spread), weights[1], S, spread)
        return _lines_first(S), _lines_first(spread)

    @property
    def between(self) -> Complex:
        """Moments of the period means, ``(F, q + n, q + n)``, made anew at every call."""
        return _matrices(self.packed_between)

    @property
    def within(self) -> Complex:
        """Moments of what changes from period to period, ``(F, q + n, q + n)``, made anew at every call."""
        return _matrices(self.packed_within)

    @property
    def powers(self) -> tuple[Real, Real]:
        """Diagonals of `between` and `within`, each ``(F, q + n)``."""
        own = np.arange(1, self.period_sums.shape[2] + 1) ** 2 - 1
        return self.packed_between[own].T, self.packed_within[own].T

    @property
    def inputs(self) -> int:
        """Number of inputs, q."""
        return int(self.S.shape[2])

    @property
    def experiments(self) -> int:
        """Number of experiments, E = M q."""
        return self.realisations * self.inputs

    def about_least_squares(self) -> "Sums":
        """Express the same with residuals about ``S = sum Y U^H (sum U U^H)^-1`` of the period means.

        Where amplitudes are equal and experiments orthogonal that is (28). Where they differ, (28) gives a weak
        realisation the weight of a strong one; its residuals then are no longer orthogonal to the inputs, and the
        F test of :mod:`creak.network` is spoilt. The moments make the change exact: ``sum R U^H (sum U U^H)^-1``
        is what is missing in ``S``.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the inputs do not span all directions.
        """
        S = self.least_squares()
        return replace(self.moved(S), S=S, about=None)

    def least_squares(self) -> Complex:
        """Return ``sum Y U^H (sum U U^H)^-1`` of the period means, ``(F, n, q)``.

        Raises
        ------
        numpy.linalg.LinAlgError
            As `about_least_squares`.
        """
        q = self.inputs
        reference = self.S if self.about is None else self.about
        between = self.between
        return reference + _divide(between[:, q:, :q], between[:, :q, :q])

    def normal(self) -> "Sums":
        """Express the same with residuals about ``S``."""
        return self if self.about is None else replace(self.moved(self.S), about=None)

    def excess(self) -> float:
        """How much larger residuals are between experiments than within, as power: rounding grows by this factor.

        Returns
        -------
        float
            Largest ratio of a node, over all lines, ``sum_e P |mean_p R|^2`` over the deviations from it.
        """
        q = self.inputs
        between, within = (powers[:, q:].sum(axis=0) for powers in self.powers)
        with np.errstate(divide="ignore", invalid="ignore"):
            return float(np.nan_to_num(between / within, nan=0.0, posinf=np.inf).max())

    def moved(self, about: Complex) -> "Sums":
        """Express the same with residuals about another matrix: ``V' = T V``, ``T = [I 0; D I]``.

        Parameters
        ----------
        about : array, (F, n, q)
        """
        D = (self.S if self.about is None else self.about) - about
        if not D.any():
            return replace(self, about=about)
        D = lines_last(D)
        between, within = np.empty_like(self.packed_between), np.empty_like(self.packed_within)
        shear(self.packed_between, D, between)
        shear(self.packed_within, D, within)
        vectors = np.ascontiguousarray(self.period_sums.swapaxes(1, 2))
        period_sums = np.empty_like(vectors)
        shear_vectors(vectors, D, period_sums)
        return replace(
            self,
            packed_between=between,
            packed_within=within,
            period_sums=period_sums.swapaxes(1, 2),
            about=about,
        )


def _response(V: Complex, q: int) -> Complex:
    """``mean_p(Y) mean_p(U)^-1`` of one realisation, ``(q, P, q + n, F)`` to ``(F, n, q)``."""
    S = np.empty((V.shape[2] - q, q, V.shape[3]), dtype=np.complex128)
    condition = np.empty(V.shape[3])
    responses(V, q, S, condition)
    if np.isinf(condition).any():
        raise np.linalg.LinAlgError("the input matrix of a line is singular")
    return _lines_first(S)


def quadratic(forms: Complex, packed: Real) -> Real:
    """Quadratic forms ``g A g^H`` per line and row.

    Parameters
    ----------
    forms : array, (F, rows, w)
        g.
    packed : array, (w^2, F)
        A, Hermitian, packed; of larger packed matrices the leading one.

    Returns
    -------
    array, (F, rows)
    """
    powers = np.empty((forms.shape[1], forms.shape[0]))
    quadratic_forms(lines_last(forms), packed, powers)
    return powers.T


def packed_moments(matrices: Complex) -> Real:
    """Hermitian matrices ``(F, w, w)``, packed, ``(w^2, F)``; the lower half is read."""
    F, w = matrices.shape[:2]
    packed = np.empty((w * w, F))
    for i in range(w):
        packed[i * i : i * i + 2 * i : 2] = matrices[:, i, :i].real.T
        packed[i * i + 1 : i * i + 2 * i : 2] = matrices[:, i, :i].imag.T
        packed[i * i + 2 * i] = matrices[:, i, i].real
    return packed


def _matrices(packed: Real) -> Complex:
    w = math.isqrt(len(packed))
    matrices = np.empty((w, w, packed.shape[1]), dtype=np.complex128)
    unpack(packed, matrices)
    return _lines_first(matrices)


def _same(a: Complex | None, b: Complex | None) -> bool:
    return a is not None and b is not None and (a is b or np.array_equal(a, b))


def _divide(Y: Complex, U: Complex) -> Complex:
    """``Y U^-1`` for stacks of matrices."""
    transposed = np.linalg.solve(U.swapaxes(-1, -2), Y.swapaxes(-1, -2))
    return np.asarray(transposed.swapaxes(-1, -2), dtype=np.complex128)


def _lines_first(matrices: _Array) -> _Array:
    return matrices.transpose(2, 0, 1)
