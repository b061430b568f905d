"""From a rate of false alarms to a threshold.

An operator sets how many false alarms a year are tolerable, not a level of one test. The bound used here needs no
independence: an alarm is raised at a window only if that window exceeds, whatever K, N and the overlap of windows
are, so of a healthy rig

    expected false alarms a year  <=  windows a year * tests a window * p

(Boole's inequality; tests a window: the nodes, twice with baselines). The p that makes the right side the wanted
rate keeps it for the life of the monitor. Overlapping windows exceed in clusters, of which each raises once, so
the rate met with lies below the bound.
"""

from math import expm1

from scipy.optimize import brentq

from creak.records import Run

YEAR_S = 365.25 * 86_400.0


def update_interval_s(run: Run) -> float:
    """Recorded seconds between windows: those of one realisation."""
    return run.rig.q * run.periods * run.rig.period_ns * 1e-9


def windows_per_year(run: Run) -> float:
    """Windows that are judged in a year of recorded time."""
    return YEAR_S / update_interval_s(run)


def p_threshold(run: Run) -> float:
    """Largest p-value of a window that is significant."""
    rate = run.limits.false_alarms_per_year
    if rate is None:
        return run.limits.p_value
    tests = run.rig.n * (2 if run.baseline.realisations else 1)
    return min(rate / (windows_per_year(run) * tests), 0.5)


def trend_run_length(run: Run) -> float | None:
    """Mean number of disjoint windows between false trends of one node; None if there is no trend test.

    A trend is tested once in R realisations, where no window shares data with the one before.
    """
    rate = run.baseline.trend_false_alarms_per_year
    if rate is None or not run.baseline.realisations:
        return None
    return max(windows_per_year(run) / run.window * run.rig.n / rate, 2.0)


def cusum_run_length(threshold: float, allowance: float) -> float:
    """Mean number of independent standard normal values until a one-sided CUSUM first exceeds its threshold.

    D. Siegmund, *Sequential Analysis* (Springer 1985), with the correction 1.166 for the overshoot: within a few
    percent of the exact value for thresholds of 2 and more.

    Parameters
    ----------
    threshold, allowance : float
        h and k, in standard deviations.
    """
    b = 2.0 * allowance * (threshold + 1.166)
    return (expm1(b) - b) / (2.0 * allowance**2)


def cusum_threshold(run_length: float, allowance: float) -> float:
    """The h at which a one-sided CUSUM has a given mean run length."""

    def excess(threshold: float) -> float:
        return cusum_run_length(threshold, allowance) - run_length

    upper = 1.0
    while excess(upper) < 0:
        upper *= 2.0
    return float(brentq(excess, -1.0, upper))
