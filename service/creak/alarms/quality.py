"""Alarms about the data: their own class, which never touches a process alarm.

What is wrong with samples is found elsewhere and told as kinds of faults; here they become alarms. Silence and
staleness have a deadline, which lies at a recorded time whenever it is noticed; everything else is judged where
frames and realisations come.
"""

from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field, replace

from creak.alarm_records import AlarmChange, Limits, Verdict
from creak.alarms.judge import Watch, watch_on
from creak.alarms.life import Alarm, demand
from creak.limits import update_interval_s
from creak.records import FaultKind, Frame, Run

SPOILING = {FaultKind.INCOMPLETE, FaultKind.SINGULAR}
"""Faults that say that a realisation was left out."""

STOPPING = {FaultKind.SILENT, FaultKind.BUS_OFF, FaultKind.DISCONNECTED}
"""Faults after which no samples come: a source that sees them need not wait for a deadline."""

_CLIPPED = {FaultKind.CLIPPED, FaultKind.STUCK}
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
    """

    alarms: Mapping[tuple[str, str], Alarm] = field(default_factory=dict)
    watches: Mapping[tuple[str, str], Watch] = field(default_factory=dict)
    heard: int | None = None
    completed: int | None = None
    closed: int = 0


Stepped = tuple[Quality, tuple[AlarmChange, ...]]


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
    quality, more = heard(quality, run, taken.time, taken.time + round(run.rig.period_ns))
    return quality, changes + more


def heard(quality: Quality, run: Run, time: int, end: int) -> Stepped:
    """Take note that frames came from one recorded time to another, whatever lay before them."""
    last = end if quality.heard is None else max(quality.heard, end)
    completed = time if quality.completed is None else quality.completed
    quality = replace(quality, heard=last, completed=completed)
    if _stands(quality, "silence"):
        return _demand(quality, run, "silence", "", False, time)
    return quality, ()


def closed(
    quality: Quality, run: Run, time: int, complete: int, flaws: AbstractSet[tuple[FaultKind, str]] | None
) -> Stepped:
    """Take note of a realisation that is over.

    Parameters
    ----------
    quality : Quality
    run : Run
    time : int
        Recorded time of its end, ns since the Unix epoch.
    complete : int
        Complete realisations in the window now.
    flaws : set of (FaultKind, str), or None
        What is wrong with the response of which node; None if the realisation was left out.
    """
    count = quality.closed + 1
    quality = replace(quality, closed=count, completed=quality.completed if flaws is None else time)
    wanted = {("too_few_realisations", ""): complete < 2 and count >= max(run.window, 2)}
    quality, wanted["lost_frames", ""] = _k_of_n(quality, run.limits, ("lost_frames", ""), flaws is None)
    if flaws is not None:
        wanted["stale_estimate", ""] = False
        for name in (node.name for node in run.rig.nodes):
            wanted["clipped_sensor", name] = any((kind, name) in flaws for kind in _CLIPPED)
            key = ("transient_not_settled", name)
            quality, wanted[key] = _k_of_n(quality, run.limits, key, (FaultKind.TRANSIENT, name) in flaws)
    changes: tuple[AlarmChange, ...] = ()
    for (condition, node), stands in wanted.items():
        if stands or _stands(quality, condition, node):
            quality, more = _demand(quality, run, condition, node, stands, time)
            changes += more
    return quality, changes


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
