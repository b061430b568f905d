"""Figures of the service itself, as the store has them: plain functions on a reading connection."""

from dataclasses import dataclass

import sqlalchemy as sa

from creak.sinks import operator_tables, tables
from creak.sinks.outbox import PENDING


@dataclass(frozen=True)
class ReceiverState:
    """How a receiver of webhooks fares.

    Parameters
    ----------
    id : str
    enabled : bool
    failing_since : int or None
        First failure since the last success, ns since the Unix epoch.
    waiting : int
        Messages that it has not got yet.
    """

    id: str
    enabled: bool
    failing_since: int | None
    waiting: int


def active_alarms(connection: sa.Connection) -> dict[tuple[str, str, str, bool], int]:
    """Count the alarms that stand, by rig, class, severity and whether they are acknowledged."""
    alarms = tables.alarms
    keys = (alarms.c.rig, alarms.c.class_, alarms.c.severity, alarms.c.acknowledged)
    current = sa.or_(
        alarms.c.run == "", alarms.c.run.in_(sa.select(tables.rigs.c.run))
    )  # or of the service itself
    rows = connection.execute(
        sa.select(*keys, sa.func.count()).where(alarms.c.active, current).group_by(*keys).order_by(*keys)
    )
    return {
        (rig, class_, severity, bool(acknowledged)): count for rig, class_, severity, acknowledged, count in rows
    }


def receivers(connection: sa.Connection) -> list[ReceiverState]:
    """Return the state of every receiver, in the order in which they were added."""
    hooks, outbox = operator_tables.webhooks, operator_tables.outbox
    waiting = (
        sa.select(sa.func.count())
        .where(outbox.c.webhook == hooks.c.id, outbox.c.status == PENDING)
        .scalar_subquery()
    )
    query = sa.select(hooks.c.id, hooks.c.enabled, hooks.c.failing_since_at, waiting).order_by(hooks.c.seq)
    return [ReceiverState(*row) for row in connection.execute(query)]


def recorded_bytes(connection: sa.Connection) -> dict[str, int]:
    """Return the size of all recordings of every rig."""
    table = tables.recordings
    query = sa.select(table.c.rig, sa.func.sum(table.c.size)).group_by(table.c.rig).order_by(table.c.rig)
    return {rig: int(size) for rig, size in connection.execute(query)}


def jobs(connection: sa.Connection) -> dict[tuple[str, str], int]:
    """Count the jobs by kind and status."""
    keys = tables.jobs.c.kind, tables.jobs.c.status
    rows = connection.execute(sa.select(*keys, sa.func.count()).group_by(*keys).order_by(*keys))
    return {(kind, status): count for kind, status, count in rows}
