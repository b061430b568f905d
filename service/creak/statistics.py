"""The streaming sums over realisations: ``of`` one, ``+`` of any, and nothing else.

Per excited line a block of realisations is held in a normal form: the best linear approximation ``S`` of the
block itself (28) and moments of ``V = [U; R]`` with the residual ``R = Y - S U``. Two blocks are merged by moving
both to the common ``S``, which is exact algebra on the moments (``R' = R + (S_old - S_new) U``), and adding.
Since ``R`` is as small as noise and distortion are, nothing large cancels however high the signal-to-noise ratio;
raw sums of ``Y`` would lose 4e-2 at 120 dB.

Everything in :mod:`creak.network` is algebra on these sums, whose size does not depend on how many realisations
they hold.
"""

from dataclasses import dataclass

import numpy as np

from creak.records import Complex, Real


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
    """

    realisations: int
    periods: int
    S: Complex
    spread: Real
    between: Complex
    within: Complex
    period_sums: Complex

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
    def of(cls, spectra: Complex, inputs: int) -> "Sums":
        """Sums of one complete realisation.

        Parameters
        ----------
        spectra : array, (q, P, F, q + n)
            DFT of inputs, then responses: experiment, period, line, channel.
        inputs : int
            q.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the input matrix of a line is singular.
        """
        q = inputs
        periods = spectra.shape[1]
        mean = spectra.mean(axis=1)  # (q, F, q + n)
        U = mean[..., :q].transpose(1, 2, 0)  # (F, inputs, experiments)
        Y = mean[..., q:].transpose(1, 2, 0)
        S = _divide(Y, U)
        V = spectra.copy()
        V[..., q:] -= np.einsum("fij,epfj->epfi", S, spectra[..., :q])
        V_mean = V.mean(axis=1)
        return cls(
            realisations=1,
            periods=periods,
            S=S,
            spread=np.zeros(S.shape),
            between=periods * _moments(V_mean.transpose(1, 2, 0)),
            within=_moments((V - V_mean[:, None]).reshape(-1, *V.shape[2:]).transpose(1, 2, 0)),
            period_sums=V.sum(axis=0),
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
        weight = self.realisations * other.realisations / M
        a, b = self._about(S), other._about(S)
        return Sums(
            realisations=M,
            periods=self.periods,
            S=S,
            spread=self.spread + other.spread + weight * np.abs(self.S - other.S) ** 2,
            between=a.between + b.between,
            within=a.within + b.within,
            period_sums=a.period_sums + b.period_sums,
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
        q = self.inputs
        inputs, cross = self.between[:, :q, :q], self.between[:, q:, :q]
        return self._about(self.S + _divide(cross, inputs))

    def _about(self, S: Complex) -> "Sums":
        """Express the same realisations with residuals about another ``S``: ``V' = T V``, ``T = [I 0; D I]``."""
        D = self.S - S
        if not D.any():
            return self
        return Sums(
            realisations=self.realisations,
            periods=self.periods,
            S=S,
            spread=self.spread,
            between=_shear(self.between, D),
            within=_shear(self.within, D),
            period_sums=_shear_vector(self.period_sums, D),
        )


def _divide(Y: Complex, U: Complex) -> Complex:
    """``Y U^-1`` for stacks of matrices."""
    transposed = np.linalg.solve(U.swapaxes(-1, -2), Y.swapaxes(-1, -2))
    return np.asarray(transposed.swapaxes(-1, -2), dtype=np.complex128)


def _moments(V: Complex) -> Complex:
    """``V V^H`` per line: ``(F, channels, repetitions)`` to ``(F, channels, channels)``."""
    return V @ V.conj().swapaxes(-1, -2)


def _shear(moments: Complex, D: Complex) -> Complex:
    """``T A T^H`` with ``T = [I 0; D I]``, ``(F, q + n, q + n)``."""
    q = D.shape[-1]
    rows = moments.copy()
    rows[:, q:] += D @ rows[:, :q]
    rows[:, :, q:] += rows[:, :, :q] @ D.conj().swapaxes(-1, -2)
    return rows


def _shear_vector(vectors: Complex, D: Complex) -> Complex:
    """``T v`` for stacks of vectors, ``(P, F, q + n)``."""
    q = D.shape[-1]
    sheared = vectors.copy()
    sheared[..., q:] += np.einsum("fij,pfj->pfi", D, vectors[..., :q])
    return sheared
