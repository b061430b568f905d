"""A receiver that does not answer any more: it is disabled, and an alarm of class quality tells of it."""

import sqlalchemy as sa

from creak.sinks import receivers
from creak.sinks.receivers import Receiver
from creak.sinks.service_alarms import SERVICE, clear_alarm, raise_alarm

_GUIDANCE = (
    "Messages to this receiver are no longer sent. Find out why it does not take them, then POST "
    "/api/v1/webhooks/{}/enable: what waits is then delivered."
)


def disable(connection: sa.Connection, receiver: Receiver, reason: str, now: int) -> None:
    """Disable a receiver, and raise the alarm that tells of it; in the transaction of its last failure."""
    # disabled first, or the alarm would be sent to the one that it is about
    receivers.update(connection, receiver.id, enabled=False, reason=reason)
    alarm = raise_alarm(
        connection,
        SERVICE,
        receiver.id,
        "webhook",
        now,
        reason=reason,
        guidance=_GUIDANCE.format(receiver.id),
    )
    receivers.update(connection, receiver.id, alarm=alarm)


def enable(connection: sa.Connection, receiver: Receiver, now: int) -> None:
    """Take a receiver into service again, and clear its alarm."""
    receivers.update(
        connection, receiver.id, enabled=True, reason="", alarm=None, failing_since_at=None, paused_until_at=0
    )
    clear(connection, receiver, now)


def clear(connection: sa.Connection, receiver: Receiver, now: int) -> None:
    """Clear the alarm of a receiver that is disabled no longer, or no more."""
    if receiver.alarm is not None:
        clear_alarm(connection, receiver.alarm, now)
