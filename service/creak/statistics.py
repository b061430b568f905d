"""The streaming sums over realisations: ``of`` one, ``+`` of any, and nothing else.

Per excited line a block of realisations is held in a normal form: the best linear approximation ``S`` of the
block itself (28) and moments of ``V = [U; R]`` with the residual ``R = Y - S U``. Two blocks are merged by moving
both to the common ``S``, which is exact algebra on the moments (``R' = R + (S_old - S_new) U``), and adding.
Since ``R`` is as small as noise and distortion are, nothing large cancels however high the signal-to-noise ratio;
raw sums of ``Y`` would lose 4e-2 at 120 dB. Blocks whose residuals are taken about one and the same matrix near
their ``S`` (:attr:`Sums.about`) need no moving: they are added entry by entry, and brought into the normal form
when they are read.

In memory the lines come last, as :mod:`creak.moments` has them; the shapes below are views of that.

Everything in :mod:`creak.network` is algebra on these sums, whose size does not depend on how many realisations
they hold.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from creak.moments import quadratic_forms, residual_moments, responses, shear, shear_vectors
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
    between : array, (F, q + n, q + n)
        ``P sum_e conj-outer(mean_p V)``: moments of the period means.
    within : array, (F, q + n, q + n)
        ``sum_e sum_p conj-outer(V - mean_p V)``: what changes from period to period is noise.
    period_sums : array, (P, F, q + n)
        ``sum_e V`` for each period.
    about : array, (F, n, q), or None
        What the residuals in the moments are taken about, ``R = Y - about U``; None for ``S``, the normal form.
    """

    realisations: int
    periods: int
    S: Complex
    spread: Real
    between: Complex
    within: Complex
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
            between=np.zeros((lines, width, width), dtype=np.complex128),
            within=np.zeros((lines, width, width), dtype=np.complex128),
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
        between = np.empty((width, width, lines), dtype=np.complex128)
        within = np.empty_like(between)
        period_sums = np.empty((periods, width, lines), dtype=np.complex128)
        residual_moments(V, _lines_last(S), between, within, period_sums)
        return cls(
            realisations=1,
            periods=periods,
            S=S,
            spread=np.zeros_like(S, dtype=np.float64),
            between=_lines_first(between),
            within=_lines_first(within),
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
        S = (self.realisations * self.S + other.realisations * other.S) / M
        apart = self.S - other.S
        weight = self.realisations * other.realisations / M
        about = self.about if _same(self.about, other.about) else None
        a, b = (self, other) if about is not None else (self.moved(S), other.moved(S))
        return Sums(
            realisations=M,
            periods=self.periods,
            S=S,
            spread=self.spread + other.spread + weight * (apart.real**2 + apart.imag**2),
            between=a.between + b.between,
            within=a.within + b.within,
            period_sums=a.period_sums + b.period_sums,
            about=about,
        )

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
        return reference + _divide(self.between[:, q:, :q], self.between[:, :q, :q])

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
        between, within = (np.einsum("fii->i", moments)[q:].real for moments in (self.between, self.within))
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
        D = _lines_last(D)
        between, within = (_lines_last(moments) for moments in (self.between, self.within))
        sheared = np.empty_like(between), np.empty_like(within)
        shear(between, D, sheared[0])
        shear(within, D, sheared[1])
        vectors = np.ascontiguousarray(self.period_sums.swapaxes(1, 2))
        period_sums = np.empty_like(vectors)
        shear_vectors(vectors, D, period_sums)
        return replace(
            self,
            between=_lines_first(sheared[0]),
            within=_lines_first(sheared[1]),
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


def quadratic(forms: Complex, moments: Complex) -> Real:
    """Quadratic forms ``g A g^H`` per line and row.

    Parameters
    ----------
    forms : array, (F, rows, channels)
        g.
    moments : array, (F, channels, channels)
        A, Hermitian.

    Returns
    -------
    array, (F, rows)
    """
    powers = np.empty((forms.shape[1], forms.shape[0]))
    quadratic_forms(_lines_last(forms), _lines_last(moments), powers)
    return powers.T


def _same(a: Complex | None, b: Complex | None) -> bool:
    return a is not None and b is not None and (a is b or np.array_equal(a, b))


def _divide(Y: Complex, U: Complex) -> Complex:
    """``Y U^-1`` for stacks of matrices."""
    transposed = np.linalg.solve(U.swapaxes(-1, -2), Y.swapaxes(-1, -2))
    return np.asarray(transposed.swapaxes(-1, -2), dtype=np.complex128)


def _lines_last(matrices: Complex) -> Complex:
    """``(F, rows, columns)`` as :mod:`creak.moments` takes them, ``(rows, columns, F)``."""
    return np.ascontiguousarray(matrices.transpose(1, 2, 0))


def _lines_first(matrices: _Array) -> _Array:
    return matrices.transpose(2, 0, 1)
