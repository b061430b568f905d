"""Which files and realisations a recording or an alarm stands for, as far as the store knows."""

import json
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa

from creak.codec import parse_time
from creak.records import Scope
from creak.sinks import tables

_MOST = 12
"""Realisations of an alarm that are looked at: more would make the answer later, not better."""


@dataclass(frozen=True)
class Material:
    """What can be computed with.

    Parameters
    ----------
    rig : str
    files : tuple of str
        Parts of one recording, in their order.
    first, last : int or None
        Realisations that count, ends included; None for no limit.
    """

    rig: str
    files: tuple[str, ...]
    first: int | None = None
    last: int | None = None


def of_recording(connection: sa.Connection, identifier: str) -> Material | None:
    """Return what a recording holds; None if there is none of this id."""
    table = tables.recordings
    row = connection.execute(sa.select(table).where(table.c.id == identifier)).mappings().first()
    return None if row is None else Material(row["rig"], (row["path"],))


def of_alarm(connection: sa.Connection, identifier: str) -> Material | None:
    """Return the realisations in which an alarm stood, and the parts of the recording that hold them.

    An alarm is raised when K windows have exceeded the limits, and each of them ends with a realisation that was
    bad; so the K realisations before it belong to it, and those before them may not.

    Returns
    -------
    Material or None
        None if there is no such alarm; without files if its run was not recorded.
    """
    alarms, runs = tables.alarms, tables.runs
    query = (
        sa.select(alarms.c.rig, alarms.c.run, alarms.c.since, runs.c.limits, runs.c.window)
        .join(runs, runs.c.id == alarms.c.run)
        .where(alarms.c.id == identifier)
    )
    row = connection.execute(query).mappings().first()
    if row is None:
        return None
    run, exceeding = row["run"], int(row["limits"]["exceeding"])
    raised = _realisation(connection, run, row["since"])
    if raised is None:
        return Material(row["rig"], _parts(connection, run, None, None))
    first = max(0, raised - exceeding + 1)
    last = first + _MOST - 1
    cleared = _cleared(connection, identifier)
    ended = None if cleared is None else _realisation(connection, run, cleared)
    if ended is not None:  # K windows of R realisations each were good by then
        last = min(last, max(raised, ended - exceeding - int(row["window"]) + 1))
    files = _parts(connection, run, _end(connection, run, first - 1), _end(connection, run, last))
    return Material(row["rig"], files, first, last)


def healthy_before(connection: sa.Connection, identifier: str) -> Material | None:
    """Return the realisations before those whose windows raised an alarm: the rig as it was.

    Returns
    -------
    Material or None
        None if the alarm was raised too early, or its run was not recorded.
    """
    alarms, runs = tables.alarms, tables.runs
    query = (
        sa.select(alarms.c.rig, alarms.c.run, alarms.c.since, runs.c.limits, runs.c.window)
        .join(runs, runs.c.id == alarms.c.run)
        .where(alarms.c.id == identifier)
    )
    row = connection.execute(query).mappings().first()
    raised = None if row is None else _realisation(connection, row["run"], row["since"])
    if row is None or raised is None:
        return None
    # The first window that exceeded the limits ended K - 1 realisations before, and held R.
    last = raised - int(row["limits"]["exceeding"]) - int(row["window"]) + 1
    if last < 0:
        return None
    first = max(0, last - _MOST + 1)
    files = _parts(
        connection, row["run"], _end(connection, row["run"], first - 1), _end(connection, row["run"], last)
    )
    return Material(row["rig"], files, first, last) if files else None


def _cleared(connection: sa.Connection, alarm: str) -> int | None:
    """Return the recorded time at which an alarm was cleared."""
    journal = tables.journal
    query = sa.select(journal.c.payload).where(journal.c.alarm == alarm).order_by(journal.c.seq)
    changes: list[dict[str, Any]] = [json.loads(payload) for payload in connection.execute(query).scalars()]
    times = [change["time"] for change in changes if change["event"] == "cleared"]
    return parse_time(times[0]) if times else None


def _realisation(connection: sa.Connection, run: str, time: int) -> int | None:
    """Return the realisation that was complete at a recorded time."""
    estimates = tables.estimates
    query = sa.select(sa.func.max(estimates.c.realisation)).where(
        estimates.c.run == run, estimates.c.scope == Scope.WINDOW.value, estimates.c.time <= time
    )
    return connection.execute(query).scalar()


def _end(connection: sa.Connection, run: str, realisation: int) -> int | None:
    """Return the recorded time at which a realisation was complete; None before that."""
    estimates = tables.estimates
    query = sa.select(estimates.c.time).where(
        estimates.c.run == run, estimates.c.scope == Scope.WINDOW.value, estimates.c.realisation == realisation
    )
    return connection.execute(query.limit(1)).scalar()


def _parts(connection: sa.Connection, run: str, since: int | None, until: int | None) -> tuple[str, ...]:
    """Return the parts of a run's recording that touch a stretch of recorded time."""
    table = tables.recordings
    query = sa.select(table.c.path).where(table.c.run == run)
    if since is not None:
        query = query.where(sa.or_(table.c.end.is_(None), table.c.end > since))
    if until is not None:
        query = query.where(table.c.start < until)
    return tuple(connection.execute(query.order_by(table.c.seq)).scalars())
