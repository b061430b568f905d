"""A node's own baseline: every real machine is a little nonlinear, so what counts is that it changes.

The level that is followed is the nonlinear power on a scale that stays finite where there is none,

    x = 10 log10( (sigma_t^2 - sigma_n^2 + s) / s ) dB,

a started logarithm (J. W. Tukey, *Exploratory Data Analysis*, 1977): proportional to sigma_s^2 where that is small
against the noise power s of the time of learning, its logarithm where it is large. More noise does not move it.
A baseline holds mean and spread of x over windows that share no data, per node and operating state, which is the
rms of the excitation. Complete, it stays as it is: one that followed the machine would learn its wear.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from math import log10, sqrt

import numpy as np
from scipy.special import stdtr

from creak import trend as trends
from creak.alarm_records import Verdict
from creak.limits import cusum_threshold, p_threshold, trend_run_length
from creak.records import NodeLevel, Run
from creak.statistics import Sums
from creak.trend import Trend

_LEAST_WINDOWS = 4
_FLOOR = 0.1  # of s: a window whose noise swelled by chance says "nothing", not minus infinity


@dataclass(frozen=True)
class Baseline:
    """What is known of a node in one operating state.

    Parameters
    ----------
    node : str
    state_rms : float
        RMS of the excitation, mean over the inputs, in their units.
    reference_power : float
        s, noise power when learning began, unit squared.
    reference : Trend
        Windows learnt from; only its count, mean and squares are used.
    realisations : int
        In those windows.
    complete : bool
        It is in force, and frozen: only `relearn` replaces it.
    next_realisation : int
        First one, among the complete ones of the run, whose window shares no data with the last one learnt from.
    since, updated : int
        Recorded times of the first and the last window learnt from, ns since the Unix epoch.
    growth : Trend
        The trend test's memory.
    successor : Baseline or None
        One that is being learnt to take this one's place.
    """

    node: str
    state_rms: float
    reference_power: float
    reference: Trend = field(default_factory=Trend)
    realisations: int = 0
    complete: bool = False
    next_realisation: int = 0
    since: int = 0
    updated: int = 0
    growth: Trend = field(default_factory=Trend)
    successor: "Baseline | None" = None

    @property
    def mean_db(self) -> float:
        """Mean level, dB."""
        return self.reference.mean

    @property
    def deviation_db(self) -> float | None:
        """Standard deviation of the level from window to window, dB; None before the second window."""
        return self.reference.deviation


def input_rms(sums: Sums) -> float:
    """RMS of the excitation in the sums, mean power over inputs, in their units."""
    q = sums.inputs
    power = np.einsum("fii->", sums.between[:, :q, :q]).real / (sums.periods * sums.experiments * q)
    return float(np.sqrt(2.0 * power))


def same_state(one_rms: float, other_rms: float, tolerance_db: float) -> bool:
    """Tell whether two excitations are one operating state."""
    if one_rms <= 0 or other_rms <= 0:
        return one_rms == other_rms
    return abs(20.0 * log10(one_rms / other_rms)) <= tolerance_db


def find(baselines: Iterable[Baseline], node: str, rms: float, tolerance_db: float) -> Baseline | None:
    """The baseline of a node whose state lies nearest, if any lies within the tolerance."""
    near = [b for b in baselines if b.node == node and same_state(b.state_rms, rms, tolerance_db)]
    return min(near, key=lambda b: abs(b.state_rms - rms), default=None)


def level_db(level: NodeLevel, reference_power: float) -> float | None:
    """The level x; None if the data carry no networked variances."""
    if level.total_db is None or level.noise_db is None or reference_power <= 0:
        return None
    nonlinear = 10 ** (level.total_db / 10) - 10 ** (level.noise_db / 10)
    return 10.0 * log10(max(nonlinear / reference_power + 1.0, _FLOOR))


def begin(level: NodeLevel, rms: float) -> Baseline | None:
    """An empty baseline for the state of this window; None if the window has no noise level."""
    if level.total_db is None or level.noise_db is None:
        return None
    return Baseline(level.name, rms, 10 ** (level.noise_db / 10))


def step(
    run: Run, baseline: Baseline, level: NodeLevel, realisation: int, time: int, healthy: bool
) -> tuple[Baseline, dict[str, Verdict]]:
    """Compare a window with the baseline, and learn from it where that is called for.

    Parameters
    ----------
    run : Run
        Gives window, rules and limits.
    baseline : Baseline
        Of the node and the window's operating state.
    level : NodeLevel
        Of the window.
    realisation : int
        Complete realisations of the run before the last one in it: those that were lost are in no window.
    time : int
        Recorded time of its end, ns since the Unix epoch.
    healthy : bool
        No alarm of the node stands: it may be learnt from.

    Returns
    -------
    Baseline
    dict of str to Verdict
        ``baseline`` and ``trend``, as far as they can be judged.
    """
    x = level_db(level, baseline.reference_power)
    if x is None:
        return baseline, {}
    verdicts: dict[str, Verdict] = {}
    if baseline.complete:
        verdicts["baseline"] = judge(run, baseline, x)
    if baseline.successor is not None:
        after, _ = step(run, baseline.successor, level, realisation, time, healthy=True)
        baseline = after if after.complete else replace(baseline, successor=after)
    if realisation < baseline.next_realisation:
        return baseline, verdicts
    if not baseline.complete and not healthy:
        return baseline, verdicts
    baseline = replace(baseline, next_realisation=realisation + run.window)
    run_length = trend_run_length(run)
    if run_length is not None:
        growth, verdict = trends.take(
            baseline.growth, x, cusum_threshold(run_length, trends.ALLOWANCE), learn=healthy
        )
        baseline = replace(baseline, growth=growth)
        if baseline.complete:
            verdicts["trend"] = verdict
    if not baseline.complete:
        baseline = _learn(run, baseline, x, time)
    return baseline, verdicts


def carried_over(baseline: Baseline, first: int) -> Baseline:
    """Take a baseline, and what is being learnt to replace it, into a run; from its realisation `first` on."""
    successor = baseline.successor
    later = None if successor is None else carried_over(successor, first)
    return replace(baseline, next_realisation=first, successor=later)


def judge(run: Run, baseline: Baseline, x: float) -> Verdict:
    """Where a level lies: it exceeds if it changed by enough, and by more than chance allows.

    A healthy window lies within the prediction interval ``mean + t s sqrt(1 + 1/m)`` of the m windows learnt from.
    """
    change = x - baseline.mean_db
    if not _significant(baseline, change, p_threshold(run)):
        return Verdict.BELOW
    if change > run.baseline.change_db:
        return Verdict.EXCEEDS
    return Verdict.BELOW if change < run.baseline.change_db - run.limits.dead_band_db else Verdict.BETWEEN


def relearn(baseline: Baseline) -> Baseline:
    """Learn a new one, for a machine that was changed on purpose; the old one is in force until that is complete.

    The new one is learnt from whatever comes: that it departs from the old one is why it was asked for.
    """
    fresh = Baseline(baseline.node, baseline.state_rms, baseline.reference_power)
    return replace(baseline, successor=fresh) if baseline.complete else fresh


def _learn(run: Run, baseline: Baseline, x: float, time: int) -> Baseline:
    reference = trends.add(baseline.reference, x)
    realisations = baseline.realisations + run.window
    return replace(
        baseline,
        reference=reference,
        realisations=realisations,
        complete=realisations >= run.baseline.realisations and reference.count >= _LEAST_WINDOWS,
        since=baseline.since if baseline.reference.count else time,
        updated=time,
    )


def _significant(baseline: Baseline, change: float, p_limit: float) -> bool:
    deviation = baseline.deviation_db
    m = baseline.reference.count
    if deviation is None:
        return False
    if deviation == 0.0:
        return change > 0
    return bool(stdtr(m - 1, -change / (deviation * sqrt(1.0 + 1.0 / m))) < p_limit)
