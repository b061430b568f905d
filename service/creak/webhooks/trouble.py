"""A receiver that does not answer any more: it is disabled, and an alarm of class quality tells of it."""

import uuid
from dataclasses import replace

import sqlalchemy as sa

from creak.records import AlarmChange, AlarmState
from creak.sinks import receivers, tables
from creak.sinks.alarm_rows import change_of, put_alarm
from creak.sinks.receivers import Receiver

RIG = "creak"
"""Rig of alarms about the service itself."""

_NAMESPACE = uuid.UUID("6f1d2c0e-8f0b-5a3e-9a57-6372656b0003")
_GUIDANCE = (
    "Messages to this receiver are no longer sent. Find out why it does not take them, then POST "
    "/api/v1/webhooks/{}/enable: what waits is then delivered."
)


def disable(connection: sa.Connection, receiver: Receiver, reason: str, now: int) -> None:
    """Disable a receiver, and raise the alarm that tells of it; in the transaction of its last failure."""
    identifier = str(uuid.uuid5(_NAMESPACE, f"{receiver.id}/{now}"))
    receivers.update(connection, receiver.id, enabled=False, reason=reason, alarm=identifier)
    raised = AlarmChange(
        id=identifier,
        rig=RIG,
        node=receiver.id,
        class_="quality",
        severity="warning",
        event="raised",
        state=AlarmState.UNACKNOWLEDGED,
        active=True,
        acknowledged=False,
        shelved=False,
        since=now,
        time=now,
        level_db=float("nan"),
        version=1,
        condition="webhook",
        comment=reason,
        guidance=_GUIDANCE.format(receiver.id),
    )
    put_alarm(connection, "", raised)


def enable(connection: sa.Connection, receiver: Receiver, now: int) -> None:
    """Take a receiver into service again, and clear its alarm."""
    values = {"enabled": True, "reason": "", "alarm": None, "failing_since_at": None, "paused_until_at": 0}
    receivers.update(connection, receiver.id, **values)
    clear(connection, receiver, now)


def clear(connection: sa.Connection, receiver: Receiver, now: int) -> None:
    """Clear the alarm of a receiver that is disabled no longer, or no more."""
    alarms = tables.alarms
    if receiver.alarm is None:
        return
    row = connection.execute(sa.select(alarms).where(alarms.c.id == receiver.alarm)).mappings().first()
    if row is None or not row["active"]:
        return
    standing = change_of(row)
    state = AlarmState.NORMAL if standing.acknowledged else AlarmState.RETURNED_UNACKNOWLEDGED
    version = standing.version + 1
    cleared = replace(standing, event="cleared", state=state, active=False, time=now, version=version, comment="")
    put_alarm(connection, "", cleared)
