"""When a node alarms: rules as data, state in and state out.

A window of a node *exceeds* its limits, lies *below* their dead band, or is *between*. K of the last N windows
decide, the newest among them; the table :data:`TRANSITIONS` says what follows. All times are recorded times, so a
replay gives the same alarms.
"""

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from creak.records import AlarmChange, AlarmState, Limits, NodeLevel, Run

_NAMESPACE = uuid.UUID("6f1d2c0e-8f0b-5a3e-9a57-6372656b0001")


class Verdict(StrEnum):
    """Where one window of one node lies."""

    EXCEEDS = "exceeds"
    BETWEEN = "between"
    BELOW = "below"


class Signal(StrEnum):
    """What the last windows together demand."""

    RAISE = "raise"
    CLEAR = "clear"


TRANSITIONS: Mapping[tuple[AlarmState, Signal], tuple[AlarmState, str]] = {
    (AlarmState.NORMAL, Signal.RAISE): (AlarmState.UNACKNOWLEDGED, "raised"),
    (AlarmState.UNACKNOWLEDGED, Signal.CLEAR): (AlarmState.RETURNED_UNACKNOWLEDGED, "cleared"),
    (AlarmState.RETURNED_UNACKNOWLEDGED, Signal.RAISE): (AlarmState.UNACKNOWLEDGED, "raised"),
}
"""State and signal to the next state and the name of the event; a pair that is absent changes nothing."""

ACTIVE = frozenset({AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED})
"""States in which the condition stands."""


@dataclass(frozen=True)
class NodeAlarm:
    """The alarm of one node as it stands.

    Parameters
    ----------
    state : AlarmState
    id : str
        Of the occurrence; empty if there was none.
    since : int
        Recorded time at which the occurrence was raised, ns since the Unix epoch.
    recent : tuple of Verdict
        The last N windows, oldest first.
    """

    state: AlarmState = AlarmState.NORMAL
    id: str = ""
    since: int = 0
    recent: tuple[Verdict, ...] = ()


def judge(level: NodeLevel, limits: Limits) -> Verdict | None:
    """Where a window lies; None if its data carry no networked ratio.

    A window exceeds if clearance and significance say so together. One without significance lies below however
    large its ratio, for then noise alone explains it.
    """
    if level.total_to_noise_db is None or level.p_value is None:
        return None
    if level.p_value >= limits.p_value:
        return Verdict.BELOW
    if level.total_to_noise_db > limits.total_to_noise_db:
        return Verdict.EXCEEDS
    if level.total_to_noise_db < limits.total_to_noise_db - limits.dead_band_db:
        return Verdict.BELOW
    return Verdict.BETWEEN


def step(run: Run, alarm: NodeAlarm, level: NodeLevel, time: int) -> tuple[NodeAlarm, tuple[AlarmChange, ...]]:
    """Take one more window of a node.

    Parameters
    ----------
    run : Run
        Gives limits, rig name and identity.
    alarm : NodeAlarm
        As it stood before.
    level : NodeLevel
        Of the window.
    time : int
        Recorded time at the window's end, ns since the Unix epoch.

    Returns
    -------
    NodeAlarm
        As it stands now.
    tuple of AlarmChange
        What changed, if anything.
    """
    limits = run.limits
    verdict = judge(level, limits)
    if verdict is None or level.total_to_noise_db is None:
        return alarm, ()
    alarm = replace(alarm, recent=(*alarm.recent, verdict)[-limits.windows :])
    signal = _signal(alarm.recent, limits)
    if signal is None or (alarm.state, signal) not in TRANSITIONS:
        return alarm, ()
    if alarm.state is AlarmState.NORMAL:  # a new occurrence
        name = f"{run.id}/{level.name}/{time}"
        alarm = replace(alarm, id=str(uuid.uuid5(_NAMESPACE, name)), since=time)
    state, event = TRANSITIONS[alarm.state, signal]
    alarm = replace(alarm, state=state)
    change = AlarmChange(
        id=alarm.id,
        rig=run.rig.name,
        node=level.name,
        class_="process",
        severity="alarm",
        event=event,
        state=state,
        active=state in ACTIVE,
        acknowledged=state is AlarmState.ACKNOWLEDGED,
        shelved=state is AlarmState.SHELVED,
        since=alarm.since,
        time=time,
        level_db=level.total_to_noise_db,
    )
    return alarm, (change,)


def _signal(recent: tuple[Verdict, ...], limits: Limits) -> Signal | None:
    """K of N, the newest window among the K: else an old window could raise what the newest denies."""
    newest = recent[-1]
    if recent.count(newest) < limits.exceeding:
        return None
    return {Verdict.EXCEEDS: Signal.RAISE, Verdict.BELOW: Signal.CLEAR}.get(newest)
