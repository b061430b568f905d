"""Random-phase multisines: excited lines, grids and orthogonal experiments (method of the paper, (6) and (25))."""

import math

import numpy as np

from creak.records import Grid, Real, Rig

EXCITATION = 0
"""Purpose of a random stream: ``SeedSequence((seed, realisation, purpose))``; sensor noise is another."""

_GROUP = 4  # odd lines a group of the random-odd grid, one of which stays unexcited
_GRID_SEED = 1  # the grid belongs to the rig, not to a run: every process must draw the same


def grid_lines(grid: Grid, band: tuple[float, float], sample_rate: float, period_samples: int) -> tuple[int, ...]:
    """Excited lines of a grid inside a band.

    Parameters
    ----------
    grid : {"full", "odd", "random-odd"}
        All lines, the odd ones, or the odd ones less one in every group of four consecutive ones (the
        detection line, drawn once for the rig).
    band : tuple of float
        Lowest and highest frequency in Hz, ends included.
    sample_rate : float
        Hz.
    period_samples : int
        Samples a period, N.

    Returns
    -------
    tuple of int
        Multiples of ``sample_rate / period_samples``, rising, without DC and the Nyquist line.
    """
    resolution = sample_rate / period_samples
    slack = 1e-9  # a band edge that is a line but for rounding belongs to the band
    first = max(1, math.ceil(band[0] / resolution - slack))
    last = min((period_samples - 1) // 2, math.floor(band[1] / resolution + slack))
    lines = np.arange(first, last + 1)
    if grid == "full":
        return tuple(lines.tolist())
    lines = lines[lines % 2 == 1]
    if grid == "odd":
        return tuple(lines.tolist())
    rng = np.random.default_rng(_GRID_SEED)
    whole = len(lines) // _GROUP
    left_out = _GROUP * np.arange(whole) + rng.integers(_GROUP, size=whole)
    return tuple(np.delete(lines, left_out).tolist())


def realisation(rig: Rig, rms: float, seed: int, index: int) -> Real:
    """One period of every input in the ``q`` orthogonal experiments of one realisation.

    Flat amplitudes, phases uniform on [0, 2 pi), zero mean. Within the realisation the inputs keep their
    phases and are rotated against each other, ``u[c, i] = exp(-2j pi i c / q) u[0, i]``, which makes the
    input matrix of every line orthogonal (25).

    Parameters
    ----------
    rig : Rig
    rms : float
        RMS value of every input, in its unit.
    seed, index : int
        Seed of the run and index of the realisation: the same two give the same signals, whatever came before.

    Returns
    -------
    array, (q, q, N)
        Experiment, input, sample.
    """
    q, size = rig.q, rig.period_samples
    rng = np.random.default_rng(np.random.SeedSequence((seed, index, EXCITATION)))
    phases = rng.uniform(0.0, 2.0 * np.pi, (q, len(rig.lines)))
    inputs = np.arange(q)
    rotation = np.exp(-2j * np.pi * np.outer(np.arange(q), inputs) / q)
    # A cosine of amplitude a has the power a^2/2 and the lines of a real DFT scaled by 1/N the modulus a/2.
    modulus = rms / math.sqrt(2 * len(rig.lines))
    spectrum = np.zeros((q, q, size // 2 + 1), dtype=np.complex128)
    spectrum[:, :, list(rig.lines)] = modulus * rotation[:, :, None] * np.exp(1j * phases)
    return np.fft.irfft(spectrum * size, n=size, axis=-1)
