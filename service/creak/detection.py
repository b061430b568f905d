"""Odd and even distortion read from the lines that the excitation leaves out.

If only odd lines are excited, an even nonlinearity puts its distortion on even lines and an odd one on odd lines.
A linear structure answers at neither, so what stands there above the noise is distortion: already in one
realisation, and without a second input. At the excited lines the same distortion is there too, as strong on
average as on the odd lines left out; but it hides under the response.

An input that is itself distorted (an amplifier, an actuator that the structure loads) shows at these lines as
well: then the lines tell that there is distortion, not that it is the structure's.
"""

from dataclasses import dataclass

import numpy as np

from creak.findings import DetectionLevel
from creak.moments import line_powers
from creak.records import Complex, Real, Rig


@dataclass(frozen=True)
class DetectionLines:
    """Lines between the first and the last excited one that are not excited, rising.

    Parameters
    ----------
    odd, even : tuple of int
        Both empty where an even line is excited: odd distortion then falls on even lines too, and the two cannot
        be told apart.
    """

    odd: tuple[int, ...]
    even: tuple[int, ...]

    @property
    def all(self) -> tuple[int, ...]:
        """Odd lines, then even ones."""
        return self.odd + self.even


def detection_lines(rig: Rig) -> DetectionLines:
    """Detection lines of a rig.

    Parameters
    ----------
    rig : Rig

    Returns
    -------
    DetectionLines
    """
    if any(line % 2 == 0 for line in rig.lines):
        return DetectionLines((), ())
    excited = set(rig.lines)
    left_out = [line for line in range(rig.lines[0], rig.lines[-1] + 1) if line not in excited]
    return DetectionLines(
        odd=tuple(line for line in left_out if line % 2 == 1),
        even=tuple(line for line in left_out if line % 2 == 0),
    )


@dataclass(frozen=True, eq=False)
class LineSums:
    """Powers at some lines, summed over experiments; blocks add, in any order.

    Parameters
    ----------
    experiments, periods : int
        E and P.
    mean : array, (lines, n)
        ``sum_e |mean_p Y|^2``.
    within : array, (lines, n)
        ``sum_e sum_p |Y - mean_p Y|^2``.
    """

    experiments: int
    periods: int
    mean: Real
    within: Real

    @classmethod
    def of(cls, spectra: Complex) -> "LineSums":
        """Sums of one realisation.

        Parameters
        ----------
        spectra : array, (q, P, lines, n)
            Responses, DFT divided by N.
        """
        E, P, lines, n = spectra.shape
        mean, within = np.empty((n, lines)), np.empty((n, lines))
        line_powers(np.ascontiguousarray(spectra.swapaxes(2, 3)), mean, within)
        return cls(experiments=E, periods=P, mean=mean.T, within=within.T)

    def __add__(self, other: "LineSums") -> "LineSums":
        """Sums of both operands' experiments together."""
        return LineSums(
            experiments=self.experiments + other.experiments,
            periods=self.periods,
            mean=self.mean + other.mean,
            within=self.within + other.within,
        )

    @property
    def power(self) -> Real:
        """Power of the period mean, noise included, ``(lines, n)``."""
        return np.asarray(self.mean / self.experiments)

    @property
    def noise(self) -> Real:
        """Noise power of the period mean, ``(lines, n)``; NaN for one period."""
        if self.periods < 2:
            return np.full(self.mean.shape, np.nan)
        return np.asarray(self.within / (self.experiments * (self.periods - 1) * self.periods))


def detection_levels(rig: Rig, excited: LineSums, left_out: LineSums) -> tuple[DetectionLevel, ...]:
    """Mean levels of excited, odd and even lines at every node.

    Parameters
    ----------
    rig : Rig
    excited : LineSums
        At the excited lines.
    left_out : LineSums
        At ``detection_lines(rig).all``, in that order.

    Returns
    -------
    tuple of DetectionLevel, (n,)
        Empty if the rig has no detection lines. With one period there is no noise to take off: the levels are
        then upper bounds.
    """
    lines = detection_lines(rig)
    if not lines.all:
        return ()
    odd = slice(0, len(lines.odd))
    even = slice(len(lines.odd), None)
    noise = np.nan_to_num(left_out.noise)
    above = left_out.power - noise
    levels = []
    for i, node in enumerate(rig.nodes):
        levels.append(
            DetectionLevel(
                name=node.name,
                excited_db=_mean_db(excited.power[:, i] - np.nan_to_num(excited.noise[:, i])),
                odd_db=_mean_db(above[odd, i]),
                even_db=_mean_db(above[even, i]),
                noise_db=_mean_db(left_out.noise[:, i]),
            )
        )
    return tuple(levels)


def _mean_db(power: Real) -> float | None:
    """Level of the mean power; None if there are no lines or nothing is above zero."""
    mean = float(power.mean()) if power.size else 0.0
    return float(10 * np.log10(mean)) if mean > 0 else None
