"""Messages to receivers: written with that which they tell of, handed out in order, settled once delivered.

A message has one id for ever and one body for ever. Messages of one subject (an alarm) go to a receiver in the
order in which they were written: the next is due only when the one before is delivered or given up. A message
without subject waits for all that were written before it, and holds up all that follow.
"""

import json
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from creak.codec import time_json
from creak.sinks import receivers
from creak.sinks.operator_tables import deliveries, outbox, webhooks
from creak.sinks.receivers import Receiver

PENDING, DELIVERED, FAILED, COALESCED = "pending", "delivered", "failed", "coalesced"

_NAMESPACE = uuid.UUID("6f1d2c0e-8f0b-5a3e-9a57-6372656b0002")
_KEPT_MESSAGES = 2_000  # finished ones, a receiver
_KEPT_DELIVERIES = 2_000
_PRUNED = "00"  # ends of ids after which a receiver is tidied up: one message in 256


@dataclass(frozen=True)
class Message:
    """One message to one receiver; times are wall clock, ns."""

    seq: int
    id: str
    webhook: str
    subject: str
    type: str
    body: str
    attempts: int
    status: str
    created_at: int


@dataclass(frozen=True)
class Attempt:
    """What became of one attempt to deliver.

    Parameters
    ----------
    begun_at : int
        Wall clock, ns.
    seconds : float
        How long it took.
    status_code : int or None
        None if no answer came.
    outcome : str
        ``delivered``, ``retried`` (it will be tried again) or ``failed`` (it was given up).
    error : str
    next_at : int
        When it is due again, if it is.
    """

    begun_at: int
    seconds: float
    status_code: int | None
    outcome: str
    error: str
    next_at: int


def enqueue(
    connection: sa.Connection, rig: str, event: str, subject: str, alarm: Mapping[str, Any], now: int
) -> int:
    """Write a change of an alarm for every receiver that wants it.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Of the transaction that writes the change.
    rig, event, subject : str
        Of the change; the subject is the alarm's id.
    alarm : mapping
        As the API shows it.
    now : int
        Wall clock, ns.

    Returns
    -------
    int
        How many messages were written. A change that is told again (a run that is read once more) has the same
        ids, and is not sent again.
    """
    kind = f"alarm.{event}"
    wanting = [receiver for receiver in receivers.enabled(connection) if receiver.wants(kind, rig)]
    count = 0
    for receiver in wanting:
        told = f"{receiver.id}/{subject}/{event}/{alarm['time']}/{alarm.get('version')}"
        identifier = f"msg_{uuid.uuid5(_NAMESPACE, told).hex}"
        known = sa.select(outbox.c.seq).where(outbox.c.webhook == receiver.id, outbox.c.id == identifier)
        if connection.execute(known).first() is None:
            _insert(connection, receiver, identifier, subject, kind, str(alarm["time"]), rig, alarm, now)
            count += 1
    return count


def enqueue_test(connection: sa.Connection, receiver: Receiver, now: int) -> str:
    """Write a message that tests a receiver; return its id."""
    identifier = f"msg_{uuid.uuid4().hex}"
    data = {"webhook": receiver.id, "message": "this is a test"}
    _insert(connection, receiver, identifier, identifier, "webhook.test", time_json(now), "", data, now)
    return identifier


def _insert(
    connection: sa.Connection,
    receiver: Receiver,
    identifier: str,
    subject: str,
    kind: str,
    timestamp: str,
    rig: str,
    data: Mapping[str, Any],
    now: int,
) -> None:
    if receiver.format == "cloudevents":
        body = {
            "specversion": "1.0",
            "id": identifier,
            "source": f"/creak/rigs/{rig}" if rig else "/creak",
            "type": kind,
            "subject": subject or identifier,
            "time": timestamp,
            "datacontenttype": "application/json",
            "data": data,
        }
    else:
        body = {"type": kind, "timestamp": timestamp, "data": data}
    connection.execute(
        sa.insert(outbox).values(
            id=identifier,
            webhook=receiver.id,
            subject=subject,
            type=kind,
            body=json.dumps(body, ensure_ascii=False, allow_nan=False, separators=(",", ":")),
            created_at=now,
            status=PENDING,
            attempts=0,
            next_at=now,
        )
    )


def due_receivers(connection: sa.Connection, now: int) -> list[str]:
    """Return the ids of receivers for which a message may be due."""
    waiting = sa.exists().where(
        outbox.c.webhook == webhooks.c.id, outbox.c.status == PENDING, outbox.c.next_at <= now
    )
    query = sa.select(webhooks.c.id).where(webhooks.c.enabled, webhooks.c.paused_until_at <= now, waiting)
    return list(connection.execute(query).scalars())


def next_due(connection: sa.Connection, receiver: str, now: int) -> Message | None:
    """Return the oldest message that is due for a receiver and has nothing before it."""
    earlier = outbox.alias("earlier")
    before = sa.exists().where(
        earlier.c.webhook == outbox.c.webhook, earlier.c.status == PENDING, earlier.c.seq < outbox.c.seq
    )
    # three questions, for each of which the index has the answer; one with "or" would read the whole backlog
    blocked = sa.or_(
        before.where(earlier.c.subject == outbox.c.subject),
        before.where(earlier.c.subject == ""),
        sa.and_(outbox.c.subject == "", before),
    )
    query = (
        sa.select(outbox)
        .where(outbox.c.webhook == receiver, outbox.c.status == PENDING, outbox.c.next_at <= now, ~blocked)
        .order_by(outbox.c.seq)
        .limit(1)
    )
    row = connection.execute(query).mappings().first()
    return None if row is None else _message(row)


def backlog(connection: sa.Connection, receiver: str) -> int:
    """Return how many messages wait for a receiver."""
    query = sa.select(sa.func.count()).where(outbox.c.webhook == receiver, outbox.c.status == PENDING)
    return int(connection.execute(query).scalar_one())


def settle(connection: sa.Connection, message: Message, attempt: Attempt) -> None:
    """Write what became of an attempt."""
    status = {"delivered": DELIVERED, "failed": FAILED}.get(attempt.outcome, PENDING)
    connection.execute(
        sa.update(outbox)
        .where(outbox.c.seq == message.seq)
        .values(status=status, attempts=message.attempts + 1, next_at=attempt.next_at)
    )
    connection.execute(
        sa.insert(deliveries).values(
            webhook=message.webhook,
            message=message.id,
            type=message.type,
            attempt=message.attempts + 1,
            begun_at=attempt.begun_at,
            seconds=attempt.seconds,
            status_code=attempt.status_code,
            outcome=attempt.outcome,
            error=attempt.error,
        )
    )
    if message.id.endswith(_PRUNED):
        _prune(connection, message.webhook)


def coalesce(connection: sa.Connection, receiver: Receiver, now: int) -> str | None:
    """Put the alarms that wait for a receiver into one message; return its id, None if there is nothing to gain.

    The message tells of every alarm as it stands after its newest change, so nothing is left out but what lay
    between. All that wait are taken, so that those which follow come after it.
    """
    identifier = f"msg_{uuid.uuid4().hex}"
    merged = (
        sa.update(outbox)
        .where(outbox.c.webhook == receiver.id, outbox.c.status == PENDING, outbox.c.type.like("alarm.%"))
        .values(status=COALESCED, merged_into=identifier)
        .returning(outbox.c.seq, outbox.c.subject, outbox.c.body)
    )
    taken = sorted(connection.execute(merged).all(), key=lambda row: row.seq)
    if len(taken) < 2:
        undone = sa.update(outbox).where(outbox.c.merged_into == identifier)
        connection.execute(undone.values(status=PENDING, merged_into=None))
        return None
    newest = {subject: json.loads(body)["data"] for _, subject, body in taken}
    data = {"messages": len(taken), "alarms": list(newest.values())}
    _insert(connection, receiver, identifier, "", "alarms.coalesced", time_json(now), "", data, now)
    return identifier


def redeliver(connection: sa.Connection, receiver: str, identifier: str, now: int) -> bool:
    """Make a message due again, under its own id; False if there is none."""
    query = (
        sa.update(outbox)
        .where(outbox.c.webhook == receiver, outbox.c.id == identifier)
        .values(status=PENDING, attempts=0, next_at=now)
    )
    return bool(connection.execute(query).rowcount)


def delivery_page(connection: sa.Connection, receiver: str, after: int | None, limit: int) -> list[sa.RowMapping]:
    """Return attempts to deliver to a receiver, newest first."""
    query = sa.select(deliveries).where(deliveries.c.webhook == receiver)
    if after is not None:
        query = query.where(deliveries.c.seq < after)
    return list(connection.execute(query.order_by(deliveries.c.seq.desc()).limit(limit)).mappings())


def _prune(connection: sa.Connection, receiver: str) -> None:
    for table, kept, finished in (
        (outbox, _KEPT_MESSAGES, outbox.c.status != PENDING),
        (deliveries, _KEPT_DELIVERIES, sa.true()),
    ):
        of = (table.c.webhook == receiver, finished)
        oldest = sa.select(table.c.seq).where(*of).order_by(table.c.seq.desc()).offset(kept).limit(1)
        connection.execute(sa.delete(table).where(*of, table.c.seq <= oldest.scalar_subquery()))


def _message(row: sa.RowMapping) -> Message:
    return Message(**{name: row[name] for name in Message.__dataclass_fields__})
