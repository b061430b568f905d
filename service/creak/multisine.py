"""Random-phase multisines: excited lines, grids and orthogonal experiments (method of the paper, (6) and (25))."""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from creak.crest import Phases, reduce_crest
from creak.errors import InputError
from creak.records import Complex, Grid, Real, Rig

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


@dataclass(frozen=True, eq=False)
class Design:
    """How the multisines of a realisation are made.

    Parameters
    ----------
    orthogonal : {"rotation", "random"}
        What makes the experiments orthogonal. ``rotation``: the inputs keep their phases and are rotated against
        each other (25). ``random``: each experiment has random phases of its own besides (full random orthogonal;
        Dobrowiecki, Schoukens and Guillaume 2006), so that the distortions of a realisation's experiments are
        independent.
    amplitudes : array, (F,) or (q, F), or None
        Amplitude spectrum, any scale; None for a flat one.
    crest_iterations : int
        Steps of :func:`creak.crest.reduce_crest`; 0 leaves the phases random.
    """

    orthogonal: Literal["rotation", "random"] = "rotation"
    amplitudes: Real | None = None
    crest_iterations: int = 0


PAPER = Design()
"""Flat amplitudes, random phases, rotation: the paper's."""


def realisation(rig: Rig, rms: float, seed: int, index: int, design: Design = PAPER) -> Real:
    """One period of every input in the ``q`` orthogonal experiments of one realisation.

    Phases uniform on [0, 2 pi), zero mean. Within the realisation ``u[c, i] = exp(-2j pi i c / q) u[0, i]``, which
    makes the input matrix of every line orthogonal (25); a design may ask for more.

    Parameters
    ----------
    rig : Rig
    rms : float
        RMS value of every input, in its unit.
    seed, index : int
        Seed of the run and index of the realisation: the same two give the same signals, whatever came before.
    design : Design

    Returns
    -------
    array, (q, q, N)
        Experiment, input, sample.

    Raises
    ------
    InputError
        If an amplitude of the design is not above 0.
    """
    size = rig.period_samples
    spectrum = np.zeros((rig.q, rig.q, size // 2 + 1), dtype=np.complex128)
    spectrum[:, :, list(rig.lines)] = planned_spectra(rig, rms, seed, index, design)
    return np.fft.irfft(spectrum * size, n=size, axis=-1)


def planned_spectra(rig: Rig, rms: float, seed: int, index: int, design: Design = PAPER) -> Complex:
    """Spectra of `realisation` at the excited lines, DFT divided by N, ``(q, q, F)``: experiment, input, line.

    Raises
    ------
    InputError
        As `realisation`.
    """
    q, F = rig.q, len(rig.lines)
    rng = np.random.default_rng(np.random.SeedSequence((seed, index, EXCITATION)))
    inputs = rng.uniform(0.0, 2.0 * np.pi, (q, F))
    own = rng.uniform(0.0, 2.0 * np.pi, (q, F)) if design.orthogonal == "random" else np.zeros((q, F))
    phases = Phases(inputs, own)
    turn = np.exp(-2j * np.pi * np.outer(np.arange(q), np.arange(q)) / q)
    # A cosine of amplitude a has the power a^2/2 and the lines of a real DFT scaled by 1/N the modulus a/2.
    shape = np.ones((q, F)) if design.amplitudes is None else np.broadcast_to(design.amplitudes, (q, F))
    if not ((shape > 0) & (shape < np.inf)).all():
        raise InputError("an excited line has an amplitude that is not a number above 0")
    modulus = rms * shape / np.sqrt(2 * (shape**2).sum(axis=1, keepdims=True))
    if design.crest_iterations:
        phases = reduce_crest(phases, modulus, turn, rig.lines, design.crest_iterations)
    return phases.spectrum(modulus, turn)
