"""The alarm of a rig that does not deliver: of class ``quality``, so nobody takes it for a change of the machine.

It is raised by a silent rig, a bus that was left or an interface that cannot be read, and clears with the next
whole period. Its node is ``*``: it concerns all of them.
"""

import math
import uuid
from dataclasses import dataclass, replace

from creak.alarms import ACTIVE, TRANSITIONS, Signal
from creak.records import AlarmChange, AlarmState, Fault, FaultKind, Run

RAISING = frozenset({FaultKind.SILENT, FaultKind.BUS_OFF, FaultKind.DISCONNECTED})
"""Faults after which no samples come."""
ALL_NODES = "*"
_NAMESPACE = uuid.UUID("6f1d2c0e-8f0b-5a3e-9a57-6372656b0002")


@dataclass(frozen=True)
class QualityAlarm:
    """The alarm as it stands; ``since`` and ``id`` are those of the occurrence."""

    state: AlarmState = AlarmState.NORMAL
    id: str = ""
    since: int = 0


_Stepped = tuple[QualityAlarm, tuple[AlarmChange, ...]]


def step_on_fault(run: Run, alarm: QualityAlarm, fault: Fault) -> _Stepped:
    """Take a fault; one that stops the samples raises the alarm."""
    if fault.kind not in RAISING:
        return alarm, ()
    return _step(run, alarm, Signal.RAISE, fault.time)


def step_on_frame(run: Run, alarm: QualityAlarm, end: int) -> _Stepped:
    """Take note of a period that came, with the recorded time at its end."""
    return _step(run, alarm, Signal.CLEAR, end)


def _step(
    run: Run, alarm: QualityAlarm, signal: Signal, time: int
) -> tuple[QualityAlarm, tuple[AlarmChange, ...]]:
    found = TRANSITIONS.get((alarm.state, signal))
    if found is None:
        return alarm, ()
    state, event = found
    if alarm.state is AlarmState.NORMAL:
        alarm = QualityAlarm(id=str(uuid.uuid5(_NAMESPACE, f"{run.id}/{time}")), since=time)
    alarm = replace(alarm, state=state)
    change = AlarmChange(
        id=alarm.id,
        rig=run.rig.name,
        node=ALL_NODES,
        class_="quality",
        severity="alarm",
        event=event,
        state=state,
        active=state in ACTIVE,
        acknowledged=state is AlarmState.ACKNOWLEDGED,
        shelved=state is AlarmState.SHELVED,
        since=alarm.since,
        time=time,
        level_db=math.nan,
    )
    return alarm, (change,)
