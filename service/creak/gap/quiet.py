"""Noise of recordings with one period an experiment, from the lines that the excitation leaves out."""

import numpy as np

from creak.errors import MeasurementError
from creak.records import Complex, Real, Rig

_SHARED = 0.5  # share of the mean over all lines in the variance of each
_WIDTH = 24  # quiet lines whose power makes one variance


def quiet_variance(rig: Rig, Y: Complex) -> tuple[Real, float]:
    """Estimate the variance of noise at all lines from those that no input excites.

    Distortion lies on such lines as well. Of an odd grid the even lines are taken, which odd distortion leaves
    free; what even distortion there is counts as noise. What a model lacks does not follow the noise over the
    lines, so that lines of little noise must not decide alone: each variance lies halfway to the mean of all,
    which leaves the whole what it is. (On the Silverbox, leaving one training realisation out at a time, less than
    a half costs, more gains nothing.) The mean of a response is not trusted at all: one period does not tell it
    from an offset.

    Parameters
    ----------
    rig : Rig
    Y : array, (E, L, n)
        Lines of the responses.

    Returns
    -------
    array, (L, n)
        Variance of one experiment; infinite at DC.
    float
        Complex degrees of freedom behind each.

    Raises
    ------
    MeasurementError
        If all lines of the band are excited.
    """
    excited = np.zeros(Y.shape[1], dtype=bool)
    excited[list(rig.lines)] = True
    quiet = ~excited
    quiet[0] = False
    if all(line % 2 for line in rig.lines):
        quiet[1::2] = False
    inside = np.flatnonzero(quiet[: rig.lines[-1]])
    if len(inside) < _WIDTH or inside[-1] < 0.9 * rig.lines[-1]:
        raise MeasurementError(
            "the recording has 1 steady period an experiment, so its noise is not known; needed are 2 or more, or "
            "lines in the band that are not excited (grid odd or random-odd)"
        )
    lines = np.flatnonzero(quiet)
    power = np.mean(np.abs(Y[:, lines]) ** 2, axis=0)
    total = np.vstack([np.zeros((1, power.shape[1])), np.cumsum(power, axis=0)])
    nearest = np.searchsorted(lines, np.arange(Y.shape[1]))
    first = np.clip(nearest - _WIDTH // 2, 0, len(lines) - _WIDTH)
    variance = (total[first + _WIDTH] - total[first]) / _WIDTH
    variance = (1 - _SHARED) * variance + _SHARED * variance.mean(axis=0)
    variance[0] = np.inf
    return variance, float(len(Y) * _WIDTH)
