"""Slow growth: a self-starting CUSUM, whose rate of false alarms does not depend on what the machine's level is.

Let ``x_1, x_2, ...`` be levels of windows that share no data, independent and normal with *unknown* mean and
variance while nothing changes. Each is compared with the mean and the standard deviation of all before it,

    T_n = (x_n - mean_{n-1}) / s_{n-1},    U_n = Phi^-1( F_{n-2}( sqrt((n-1)/n) T_n ) ),

where F is Student's distribution function: then ``U_3, U_4, ...`` are independent and exactly standard normal
(D. M. Hawkins, Self-starting CUSUM charts for location and scale, *The Statistician* 36 (1987) 299-315), and

    C_n = max(0, C_{n-1} + U_n - k)

exceeds h with a known mean run length. A CUSUM against a mean learnt once from m values would not: the error of
that mean, s/sqrt(m), is itself a shift. U is cut at 3, as Hawkins advises, so that one outlier is no trend.
"""

from dataclasses import dataclass, replace
from math import sqrt

from scipy.special import ndtri, stdtr

from creak.alarm_records import Verdict

ALLOWANCE = 0.25
"""k, in standard deviations: shifts of twice this are found soonest."""

_CUT = 3.0


@dataclass(frozen=True)
class Trend:
    """What the test remembers.

    Parameters
    ----------
    count : int
        Levels in the reference.
    mean : float
        Of the reference, dB.
    squares : float
        Sum of squared deviations from the mean, dB squared.
    cusum : float
        C, in standard deviations.
    exceeded : bool
        C lies above its threshold, or did and has not come back to 0: growth is not taken into the reference.
    """

    count: int = 0
    mean: float = 0.0
    squares: float = 0.0
    cusum: float = 0.0
    exceeded: bool = False

    @property
    def deviation(self) -> float | None:
        """Standard deviation of the reference, dB; None with fewer than two levels."""
        return sqrt(self.squares / (self.count - 1)) if self.count > 1 else None


def take(trend: Trend, level_db: float, threshold: float, *, learn: bool = True) -> tuple[Trend, Verdict]:
    """Take the level of one more window, which shares no data with the one before.

    Parameters
    ----------
    trend : Trend
    level_db : float
    threshold : float
        h, see :func:`creak.limits.cusum_threshold`.
    learn : bool
        Take the level into the reference afterwards; not while the node has another alarm.

    Returns
    -------
    Trend
    Verdict
        ``between`` while C has risen and not exceeded; growth that exceeded stands until C is back at 0.
    """
    cusum = max(0.0, trend.cusum + min(_normal(trend, level_db), _CUT) - ALLOWANCE)
    exceeded = cusum > threshold or (trend.exceeded and cusum > 0)
    reference = trend if exceeded or not learn else add(trend, level_db)
    trend = replace(reference, cusum=cusum, exceeded=exceeded)
    if exceeded:
        return trend, Verdict.EXCEEDS
    return trend, Verdict.BETWEEN if cusum > 0 else Verdict.BELOW


def _normal(trend: Trend, level_db: float) -> float:
    """U of the next level; 0 while the reference cannot tell."""
    deviation = trend.deviation
    if deviation is None or deviation == 0.0:
        return 0.0
    n = trend.count + 1
    t = sqrt((n - 1) / n) * (level_db - trend.mean) / deviation
    # the survival side keeps its digits where the distribution function is 1
    return float(-ndtri(stdtr(n - 2, -t)))


def add(trend: Trend, level_db: float) -> Trend:
    """Take a level into the reference (Welford's update of mean and squares)."""
    count = trend.count + 1
    step = level_db - trend.mean
    mean = trend.mean + step / count
    return replace(trend, count=count, mean=mean, squares=trend.squares + step * (level_db - mean))
