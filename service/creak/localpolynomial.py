"""Local polynomial method for periodic excitation: steady state and noise from records that hold a transient.

R. Pintelon, G. Vandersteen, J. Schoukens and Y. Rolain, *Improved (non-)parametric identification of dynamic
systems excited by periodic signals: the multivariate case*, Mechanical Systems and Signal Processing 25 (2011).

The DFT of a record of ``P`` periods has the response at every ``P``-th line and nothing but transient and noise
at those between. The transient is a smooth function of frequency, so it is fitted to the lines around an excited
one, read off there and subtracted; what the fit leaves at the lines between is the noise. No period is lost.

Smooth means: on the scale of the window. A lightly damped mode is narrower, and a polynomial of low degree cannot
follow it. Where it pays, the fit is therefore a polynomial over a denominator of second degree, shared by all
responses and experiments, since they share their poles (local rational method; McKelvey and Guerin 2012).
"""

import numpy as np

from creak.errors import MeasurementError
from creak.records import Complex, Real

_DEGREE = 2  # of the numerator: the transient's value, slope and curvature
_WINDOW = 24  # lines in a fit
_SWEEPS = 4  # of the iteration that takes the denominator's weight out of the fit
_PAYS = 20.0  # F value beyond which a denominator is worth its two parameters


def settled(records: Real, periods: int, lines: tuple[int, ...]) -> Complex:
    """Steady-state periods of records that hold a transient, the first period included.

    Parameters
    ----------
    records : array, (q, channels, P N)
        Experiments of one realisation, all periods of each in one piece.
    periods : int
        P, at least 2.
    lines : tuple of int
        Lines of one period, from 1 to below ``N/2``.

    Returns
    -------
    array, (q, P, lines, channels)
        As many periods, DFT divided by N, whose mean is the response without its transient and whose scatter about
        it is the noise. The scatter is that of the mean times P, so it counts also what the uncertainty of the
        transient adds (some 10 %, 0.4 dB): ratios and p-values of all that follows hold as for settled periods.
        The order of the periods means nothing.

    Raises
    ------
    MeasurementError
        One period, or records too short for a window of 24 lines between the excited ones.
    """
    q, channels, samples = records.shape
    P, N = periods, samples // periods
    if P < 2 or samples != P * N:
        raise MeasurementError(f"{P} periods in records of {samples} samples, expected at least 2 whole periods")
    Y = np.fft.rfft(records)[..., : samples // 2] / samples
    columns = Y.reshape(q * channels, -1).T  # (record lines, C)
    at = np.asarray(lines) * P
    between = np.setdiff1d(np.arange(1, len(columns)), np.arange(0, len(columns), P))
    if len(between) < _WINDOW:
        raise MeasurementError(f"records of {samples} samples have {len(between)} lines between the excited ones")
    # The lines nearest to each excited one; at the ends of the band more of them lie on one side.
    first = np.clip(np.searchsorted(between, at) - _WINDOW // 2, 0, len(between) - _WINDOW)
    window = between[first[:, None] + np.arange(_WINDOW)]  # (lines, window)
    offset = window - at[:, None]
    scale = np.abs(offset).max(axis=1)
    X = columns[window]  # (lines, window, C)
    r = offset / scale[:, None]
    powers = r[..., None] ** np.arange(_DEGREE + 1)
    basis = _basis(powers, r, X, np.abs(columns[between]) ** 2)
    inverse = np.linalg.pinv(basis)  # (lines, degree + 1, window)
    coefficients = inverse @ X
    transient = coefficients[:, 0]  # the denominator is 1 in the middle
    rest = X - basis @ coefficients
    spread = (np.abs(inverse[:, 0]) ** 2).sum(axis=1)  # variance of the transient's value per that of a line
    leverage = np.einsum("fjd,fdj->fj", basis, inverse).real  # what the fit takes from the noise of a line
    # The P - 1 lines around each excited one are its alone, so the noise of different lines stays independent.
    order = np.argsort(np.abs(offset), axis=1, kind="stable")[:, : P - 1]
    own = np.take_along_axis(rest, order[..., None], axis=1)
    left = 1 - np.take_along_axis(leverage, order, axis=1)
    own = own * np.sqrt(P * (1 + spread[:, None]) / left)[..., None]
    mean = columns[at] - transient
    deviations = np.einsum("pj,fjc->pfc", _contrasts(P), own)
    steady = mean[None] + deviations  # (P, lines, C)
    return np.ascontiguousarray(steady.reshape(P, len(at), q, channels).transpose(2, 0, 1, 3))


def _basis(powers: Complex | Real, r: Real, X: Complex, level: Real) -> Complex:
    """Functions of which the transient is a sum, ``(lines, window, degree + 1)``: powers, over a denominator."""
    weight = 1 / np.maximum(np.median(level, axis=0), np.finfo(np.float64).tiny)
    weight = np.where(np.median(level, axis=0) > 0, weight, 0.0)
    polynomial = np.asarray(powers, dtype=np.complex128)
    plain = _rest(polynomial, X, weight)
    denominator = np.ones(r.shape, dtype=np.complex128)
    for _ in range(_SWEEPS):
        basis = polynomial / denominator[..., None]
        # X (1 + a1 r + a2 r^2) = B(r), all divided by the denominator found before (Sanathanan and Koerner).
        scaled = X / denominator[..., None]
        project = np.eye(r.shape[1]) - basis @ np.linalg.pinv(basis)
        target = project @ scaled
        one, two = project @ (r[..., None] * scaled), project @ (r[..., None] ** 2 * scaled)
        regressors = np.stack((one, two), axis=-1) * np.sqrt(weight)[:, None]
        flat = regressors.reshape(len(r), -1, 2)
        goal = -(target * np.sqrt(weight)).reshape(len(r), -1, 1)
        normal = flat.conj().swapaxes(1, 2) @ flat
        ridge = 1e-12 * np.einsum("fii->f", normal).real[:, None, None] + np.finfo(np.float64).tiny
        a = np.linalg.solve(normal + ridge * np.eye(2), flat.conj().swapaxes(1, 2) @ goal)[..., 0]
        denominator = 1 + a[:, :1] * r + a[:, 1:] * r**2
        small = np.abs(denominator) < 1e-3  # a pole on a line of the window: no noise-free line is so sharp
        denominator[small] = 1e-3
    rational = polynomial / denominator[..., None]
    better = _rest(rational, X, weight)
    free = X.shape[2] * (r.shape[1] - powers.shape[-1]) - 2
    pays = (plain - better) / 2 > _PAYS * better / free
    return np.where(pays[:, None, None], rational, polynomial)


def _rest(basis: Complex, X: Complex, weight: Real) -> Real:
    """Weighted power that a basis leaves, ``(lines,)``."""
    rest = X - basis @ (np.linalg.pinv(basis) @ X)
    return np.asarray(((np.abs(rest) ** 2) * weight).sum(axis=(1, 2)), dtype=np.float64)


def _contrasts(P: int) -> Complex:
    """Orthonormal functions of the period that sum to zero, ``(P, P - 1)``."""
    p, j = np.arange(P), np.arange(1, P)
    return np.asarray(np.exp(2j * np.pi * np.outer(p, j) / P) / np.sqrt(P), dtype=np.complex128)
