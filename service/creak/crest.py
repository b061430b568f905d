"""Crest factor of periodic signals, and phases that lower it.

The crest factor is peak over RMS value. A random-phase multisine of many lines has one of 3.5 to 5; since the peak
is what an actuator can give, halving it doubles the signal-to-noise ratio's amplitude for the same peak.
"""

from dataclasses import dataclass

import numpy as np

from creak.records import Complex, Real

_FINE = 8  # samples at least in a cycle of the highest line, so that peaks between samples are seen


@dataclass(frozen=True, eq=False)
class Phases:
    """Phases of the inputs of one realisation, ``angle U_ci = turn_ci + inputs_i + experiments_c``.

    Parameters
    ----------
    inputs : array, (q, F)
        Of each input, in all experiments; rad.
    experiments : array, (q, F)
        Of each experiment, in all inputs; zero for the rotation of the paper.
    """

    inputs: Real
    experiments: Real

    def spectrum(self, modulus: Real, turn: Complex) -> Complex:
        """Spectra of all inputs in all experiments.

        Parameters
        ----------
        modulus : array, (q, F)
            Of each input.
        turn : array, (q, q)
            Unit numbers, experiment by input, that make the experiments orthogonal.

        Returns
        -------
        array, (q, q, F)
            Experiment, input, line.
        """
        phase = self.inputs[None]
        if self.experiments.any():
            phase = phase + self.experiments[:, None]
        return np.asarray(modulus * turn[:, :, None] * np.exp(1j * phase), dtype=np.complex128)


def crest_factor(u: Real) -> Real:
    """Peak over RMS value of periodic band-limited signals, the peaks between samples included.

    Parameters
    ----------
    u : array, (..., N)
        One period; not zero.

    Returns
    -------
    array, (...)
    """
    size = u.shape[-1]
    fine = np.fft.irfft(np.fft.rfft(u) * 4, n=4 * size)  # the Nyquist line, if there, counts twice: a bound
    peak = np.maximum(np.abs(fine).max(axis=-1), np.abs(u).max(axis=-1))
    return np.asarray(peak / np.sqrt(np.mean(u**2, axis=-1)), dtype=np.float64)


def reduce_crest(
    phases: Phases, modulus: Real, turn: Complex, lines: tuple[int, ...], iterations: int = 100
) -> Phases:
    """Phases near the given ones with a lower crest factor in every experiment and input.

    Iterative clipping (Van der Ouderaa, Schoukens and Renneboog 1988): cut the peaks in time, go back to the
    amplitudes wanted in frequency, keep the phases; here for all experiments of a realisation together, so that
    they stay orthogonal and their amplitudes exact. The end depends on the random start, so realisations still
    differ; but the samples are no longer spread like a Gaussian, and a best linear approximation and the
    distortion depend on that spread.

    Parameters
    ----------
    phases : Phases
        Random ones. Zero ``experiments`` stay zero.
    modulus : array, (q, F)
    turn : array, (q, q)
    lines : tuple of int
    iterations : int

    Returns
    -------
    Phases
        Those of the lowest worst crest factor that was met, the given ones included.
    """
    size = 1 << (_FINE * lines[-1]).bit_length()
    at = np.asarray(lines)
    rotation_only = not phases.experiments.any()
    undone = turn.conj()[:, :, None]
    best, lowest = phases, np.inf
    for step in range(iterations + 1):
        full = np.zeros((*turn.shape, size // 2 + 1), dtype=np.complex128)
        full[..., at] = phases.spectrum(modulus, turn)
        u = np.fft.irfft(full * size, n=size)
        peak = np.abs(u).max(axis=-1, keepdims=True)
        worst = float((peak[..., 0] / np.sqrt(np.mean(u**2, axis=-1))).max())
        if worst < lowest:
            best, lowest = phases, worst
        level = peak * (0.6 + 0.35 * step / max(1, iterations))  # boldly first, then finely
        clipped = np.fft.rfft(np.clip(u, -level, level))[..., at] * undone
        inputs = np.angle((clipped * np.exp(-1j * phases.experiments[:, None])).sum(axis=0))
        experiments = phases.experiments
        if not rotation_only:
            experiments = np.angle((clipped * np.exp(-1j * inputs)).sum(axis=1))
        phases = Phases(inputs, experiments)
    return best
