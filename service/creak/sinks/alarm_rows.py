"""One transaction of an alarm: its row, its journal, the event that tells of it, and the messages to receivers."""

import json
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import sqlalchemy as sa

from creak.codec import alarm_json
from creak.records import AlarmChange, AlarmState
from creak.sinks import outbox, tables

KEEP_EVENTS = 10_000
"""How many events the stream can go back."""

_PRUNE_EVERY = 256
_WAITING = "creak_events_told_last"
_FIELDS = tuple(AlarmChange.__dataclass_fields__)
_COLUMNS = frozenset(tables.alarms.c.keys())


def put_alarm(connection: sa.Connection, run: str, change: AlarmChange, *, keep_events: int = KEEP_EVENTS) -> None:
    """Write a change of an alarm with all that follows from it; the caller's transaction makes it one.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Of a durable transaction.
    run : str
        Id of the run; empty for an alarm of the service itself.
    change : AlarmChange
    keep_events : int
        How many events the stream can go back.
    """
    fields = {**asdict(change), "state": change.state.value}
    row = {name: value for name, value in fields.items() if name in _COLUMNS}
    row |= {"run": run, "more": {name: value for name, value in fields.items() if name not in _COLUMNS}}
    payload = alarm_json(change)
    alarms = tables.alarms
    if not connection.execute(sa.update(alarms).where(alarms.c.id == change.id).values(row)).rowcount:
        connection.execute(sa.insert(alarms).values(row))
    connection.execute(sa.insert(tables.journal).values(alarm=change.id, run=run, payload=text(payload)))
    tell(connection, change.rig, [("alarm", payload)], keep_events)
    outbox.enqueue(connection, change.rig, change.event, change.id, payload, time.time_ns())


def change_of(row: sa.RowMapping) -> AlarmChange:
    """Return the newest change of an alarm as its row has it."""
    fields = {**{name: row[name] for name in _FIELDS if name in _COLUMNS}, **(row["more"] or {})}
    kept = {"state": AlarmState(fields["state"]), "never_raised": bool(fields["never_raised"])}
    return AlarmChange(**{**fields, **kept})


def tell(
    connection: sa.Connection, rig: str, news: Iterable[tuple[str, Mapping[str, Any]]], keep_events: int
) -> None:
    """Append to the event stream, in the same transaction as that which it tells of."""
    rows = [{"kind": kind, "rig": rig, "payload": text(payload)} for kind, payload in news]
    waiting = connection.info.get(_WAITING)
    if waiting is None:
        _append(connection, rows, keep_events)
    else:
        waiting += rows


@contextmanager
def told_last(connection: sa.Connection, keep_events: int = KEEP_EVENTS) -> Iterator[None]:
    """Append what is told within the block at its end, which is to be that of the transaction.

    The counter of events is locked from its use to the end of the transaction, and all who write wait for it.
    """
    rows: list[dict[str, str]] = []
    connection.info[_WAITING] = rows
    try:
        yield
    finally:
        del connection.info[_WAITING]
    if rows:
        _append(connection, rows, keep_events)


def _append(connection: sa.Connection, rows: Sequence[Mapping[str, str]], keep_events: int) -> None:
    counter = tables.counters
    newest = int(
        connection.execute(
            sa.update(counter)
            .where(counter.c.name == "events")
            .values(value=counter.c.value + len(rows))
            .returning(counter.c.value)
        ).scalar_one()
    )
    first = newest - len(rows) + 1
    connection.execute(sa.insert(tables.events), [{"id": first + i, **row} for i, row in enumerate(rows)])
    if first // _PRUNE_EVERY != (newest + 1) // _PRUNE_EVERY:
        connection.execute(sa.delete(tables.events).where(tables.events.c.id <= newest - keep_events))


def text(payload: Mapping[str, Any]) -> str:
    """Write a payload as compact JSON."""
    return json.dumps(payload, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
