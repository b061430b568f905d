"""Alarms about the data: their own class, which never touches a process alarm.

Silence and staleness have a deadline, which lies at a recorded time whenever it is noticed; everything else is
judged where frames and realisations come.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import fdtrc

from creak.alarm_records import AlarmChange, Limits, Verdict
from creak.alarms.judge import Watch, watch_on
from creak.alarms.life import Alarm, demand
from creak.limits import update_interval_s
from creak.records import Complex, FaultKind, Frame, Real, Run

SPOILING = {FaultKind.INCOMPLETE, FaultKind.SINGULAR}
"""Faults that say that a realisation was left out."""

STOPPING = {FaultKind.SILENT, FaultKind.BUS_OFF, FaultKind.DISCONNECTED}
"""Faults after which no samples come: a source that sees them need not wait for a deadline."""

_STUCK_SHARE = 0.005  # of the samples at one extreme value
_STUCK_LEAST = 8
_UNSETTLED_RATIO = 1.5
_UNSETTLED_P = 1e-6
_SILENT_PERIODS, _SILENT_S = 10.0, 10.0


@dataclass(frozen=True)
class Quality:
    """The quality alarms of a rig and what they go by.

    Parameters
    ----------
    alarms : mapping of (str, str) to Alarm
        By condition and node (empty: the rig).
    watches : mapping of (str, str) to Watch
        The last realisations, where K of N decide.
    heard : int or None
        Recorded time up to which frames have come, ns since the Unix epoch; None before the first.
    completed : int or None
        End of the last complete realisation; the first frame before that.
    closed : int
        Realisations that are over, complete or not.
    clipped : frozenset of str
        Nodes that clip in the open realisation.
    """

    alarms: Mapping[tuple[str, str], Alarm] = field(default_factory=dict)
    watches: Mapping[tuple[str, str], Watch] = field(default_factory=dict)
    heard: int | None = None
    completed: int | None = None
    closed: int = 0
    clipped: frozenset[str] = frozenset()


Stepped = tuple[Quality, tuple[AlarmChange, ...]]


def clipped(y: Real) -> tuple[bool, ...]:
    """Channels that stay at their largest or smallest value for many samples.

    Noise and rounding make it unlikely that a channel which is free meets the same extreme twice.

    Parameters
    ----------
    y : array, (n, N)
    """
    least = max(_STUCK_LEAST, round(_STUCK_SHARE * y.shape[-1]))
    at_top = (y == y.max(axis=-1, keepdims=True)).sum(axis=-1)
    at_bottom = (y == y.min(axis=-1, keepdims=True)).sum(axis=-1)
    return tuple((np.maximum(at_top, at_bottom) >= least).tolist())


def unsettled(spectra: Complex, inputs: int) -> tuple[bool, ...] | None:
    """Nodes whose response still settled when the first steady period began; None with fewer than three periods.

    In a steady state the first two periods differ by noise, as the last two do. Their powers, summed over lines
    and experiments, then have a ratio that follows F(2qF, 2qF), or a law closer to 1 where they share a period.

    Parameters
    ----------
    spectra : array, (q, P, F, q + n)
    inputs : int
        q.
    """
    q, periods, lines = spectra.shape[:3]
    if periods < 3:
        return None
    y = spectra[..., inputs:]
    first = (np.abs(y[:, 0] - y[:, 1]) ** 2).sum(axis=(0, 1))
    last = (np.abs(y[:, -2] - y[:, -1]) ** 2).sum(axis=(0, 1))
    freedom = 2.0 * q * lines
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = first / last
    found = (ratio > _UNSETTLED_RATIO) & (fdtrc(freedom, freedom, ratio) < _UNSETTLED_P)
    return tuple(found.tolist())


def silence_ns(run: Run) -> int:
    """Silence that is an alarm, ns."""
    given = run.alarms.silence_s
    periods = _SILENT_PERIODS * run.rig.period_ns
    return round(max(periods, _SILENT_S * 1e9) if given is None else given * 1e9)


def clock(quality: Quality, run: Run, time: int) -> Stepped:
    """Raise what is overdue at a recorded time, at the time at which it fell due."""
    changes: tuple[AlarmChange, ...] = ()
    deadlines = []
    if quality.heard is not None:
        deadlines.append((quality.heard + silence_ns(run), "silence"))
    if quality.completed is not None:
        length = round(run.alarms.stale_realisations * update_interval_s(run) * 1e9)
        deadlines.append((quality.completed + length, "stale_estimate"))
    for at, condition in sorted(deadlines):
        if time >= at and not _stands(quality, condition):
            quality, more = _demand(quality, run, condition, "", True, at)
            changes += more
    return quality, changes


def stopped(quality: Quality, run: Run, time: int) -> Stepped:
    """Take note of a source that says that nothing comes any more."""
    return (quality, ()) if _stands(quality, "silence") else _demand(quality, run, "silence", "", True, time)


def frame(quality: Quality, run: Run, taken: Frame) -> Stepped:
    """Take note of a frame that came."""
    quality, changes = clock(quality, run, taken.time)
    end = taken.time + round(run.rig.period_ns)
    heard = end if quality.heard is None else max(quality.heard, end)
    completed = taken.time if quality.completed is None else quality.completed
    quality = replace(quality, heard=heard, completed=completed)
    if _stands(quality, "silence"):
        quality, more = _demand(quality, run, "silence", "", False, taken.time)
        changes += more
    names = [node.name for node in run.rig.nodes]
    if taken.y.shape == (run.rig.n, run.rig.period_samples):
        for name, stuck in zip(names, clipped(taken.y), strict=True):
            if stuck:
                quality = replace(quality, clipped=quality.clipped | {name})
                quality, more = _demand(quality, run, "clipped_sensor", name, True, end)
                changes += more
    return quality, changes


def closed(quality: Quality, run: Run, time: int, complete: int, spectra: Complex | None) -> Stepped:
    """Take note of a realisation that is over.

    Parameters
    ----------
    quality : Quality
    run : Run
    time : int
        Recorded time of its end, ns since the Unix epoch.
    complete : int
        Complete realisations in the window now.
    spectra : array, (q, P, F, q + n), or None
        None if it was left out.
    """
    count = quality.closed + 1
    quality = replace(quality, closed=count, completed=quality.completed if spectra is None else time)
    wanted = {("too_few_realisations", ""): complete < 2 and count >= max(run.window, 2)}
    quality, wanted["lost_frames", ""] = _k_of_n(quality, run.limits, ("lost_frames", ""), spectra is None)
    if spectra is not None:
        wanted["stale_estimate", ""] = False
        names = [node.name for node in run.rig.nodes]
        for name in names:
            wanted["clipped_sensor", name] = name in quality.clipped
        for name, still in zip(names, unsettled(spectra, run.rig.q) or (), strict=False):
            key = ("transient_not_settled", name)
            quality, wanted[key] = _k_of_n(quality, run.limits, key, still)
    changes: tuple[AlarmChange, ...] = ()
    for (condition, node), stands in wanted.items():
        if stands or _stands(quality, condition, node):
            quality, more = _demand(quality, run, condition, node, stands, time)
            changes += more
    return replace(quality, clipped=frozenset()), changes


def _stands(quality: Quality, condition: str, node: str = "") -> bool:
    alarm = quality.alarms.get((condition, node))
    return alarm is not None and alarm.standing is not None


def _demand(quality: Quality, run: Run, condition: str, node: str, stands: bool, time: int) -> Stepped:
    key = (condition, node)
    alarm = quality.alarms.get(key) or Alarm(run.rig.name, node, "quality", condition=condition)
    alarm, changes = demand(alarm, "warning" if stands else None, time, run.alarms, run.id, condition)
    return replace(quality, alarms={**quality.alarms, key: alarm}), changes


def _k_of_n(quality: Quality, limits: Limits, key: tuple[str, str], poor: bool) -> tuple[Quality, bool]:
    verdict = Verdict.EXCEEDS if poor else Verdict.BELOW
    watch = watch_on(quality.watches.get(key, Watch()), verdict, limits)
    return replace(quality, watches={**quality.watches, key: watch}), watch.stands
