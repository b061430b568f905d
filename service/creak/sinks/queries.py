"""What the API asks of the store: plain functions on a reading connection, answers ready for JSON.

A list is asked for in pages: ``after`` is the place at which the page before it ended, or None for the first, and
one row more than wanted tells whether another page follows. Places are positions of rows that never move, so rows
written while somebody walks through the pages are neither met twice nor push others out.
"""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import sqlalchemy as sa

from creak.alarm_records import AlarmRules
from creak.codec import alarm_json, fault_json, moment_json, node_json, spectrum_json, time_json
from creak.quality import FLAWS
from creak.records import AlarmChange, AlarmState, Estimate, Fault, FaultKind, NodeLevel, Scope, Spectra
from creak.sinks import tables
from creak.sinks.alarm_rows import change_of
from creak.sinks.store import SPECTRA, alarm_states

Json = dict[str, Any]
Row = sa.RowMapping

_LEVELS = tuple(NodeLevel.__dataclass_fields__)
_OUT_OF_SIGHT = (AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE)
_FAULT = tuple(Fault.__dataclass_fields__)


@dataclass(frozen=True)
class Slice:
    """Rows of one page, and the place where it ended if another follows."""

    items: list[Json]
    end: tuple[int | str, ...] | None


def rigs(connection: sa.Connection, after: str | None, limit: int) -> Slice:
    """Return the state of all rigs, by name."""
    query = sa.select(tables.runs).join(tables.rigs, tables.rigs.c.run == tables.runs.c.id)
    if after is not None:
        query = query.where(tables.rigs.c.name > after)
    rows = connection.execute(query.order_by(tables.rigs.c.name).limit(limit + 1)).mappings().all()
    items = [_rig(connection, row) for row in rows[:limit]]
    return Slice(items, (items[-1]["name"],) if len(rows) > limit else None)


def rig(connection: sa.Connection, name: str) -> Json | None:
    """Return all that is known of one rig, its file included; None if there is none of this name."""
    row = current_run(connection, name)
    if row is None:
        return None
    return {
        **_rig(connection, row),
        "configuration": row["configuration"],
        "excitation": row["excitation"],
        "limits": row["limits"],
        "sample_rate": row["sample_rate"],
        "period_samples": row["period_samples"],
        "steady_periods": row["steady_periods"],
        "window": row["window"],
        "lines": row["lines"],
        "recent_faults": _recent_faults(connection, row["id"]),
        "quality": _quality(connection, row),
    }


def current_run(connection: sa.Connection, name: str) -> Row | None:
    """Return the row of a rig's current run; None if there is no such rig."""
    query = sa.select(tables.runs).join(tables.rigs, tables.rigs.c.run == tables.runs.c.id)
    return connection.execute(query.where(tables.rigs.c.name == name)).mappings().first()


def current_runs(connection: sa.Connection) -> list[Row]:
    """Return the rows of the current runs of all rigs, by the name of the rig."""
    query = sa.select(tables.runs).join(tables.rigs, tables.rigs.c.run == tables.runs.c.id)
    return list(connection.execute(query.order_by(tables.rigs.c.name)).mappings())


def nodes(connection: sa.Connection, run: Row, scope: Scope) -> list[Json]:
    """Return the newest levels of every node of a run, in the order of the rig; null before there are any."""
    estimate = newest_estimate(connection, run["id"], scope)
    states = alarm_states(connection, run["id"])
    found: dict[str, Row] = {}
    if estimate is not None:
        query = sa.select(tables.levels).where(tables.levels.c.estimate == estimate["id"])
        found = {row["name"]: row for row in connection.execute(query).mappings()}
    said = {level["name"]: level for level in _more(estimate).get("detection", [])}
    about = {
        "rig": run["rig"],
        "scope": scope.value,
        "time": None if estimate is None else time_json(estimate["time"]),
        "realisations": 0 if estimate is None else estimate["realisations"],
    }
    items = []
    for node in run["nodes"]:
        name, state = node["name"], states.get(node["name"], AlarmState.NORMAL)
        level = _level(found[name]) if name in found else NodeLevel(name)
        detection = {key: value for key, value in said.get(name, {}).items() if key != "name"} or None
        units = {"input": node["input"], "output": node["output"]}
        items.append({**node_json(level, state), **about, **units, "detection": detection})
    return items


def newest_estimate(connection: sa.Connection, run: str, scope: Scope) -> Row | None:
    """Return the row of the newest estimate of a run; None before there is one."""
    estimates = tables.estimates
    query = sa.select(estimates).where(estimates.c.run == run, estimates.c.scope == scope.value)
    return connection.execute(query.order_by(estimates.c.id.desc()).limit(1)).mappings().first()


def spectrum(connection: sa.Connection, run: Row, node: str, scope: Scope) -> Json | None:
    """Return the newest spectra of a node; None before there are any."""
    spectra, estimates, levels = tables.spectra, tables.estimates, tables.levels
    query = (
        sa.select(spectra.c.samples, estimates, *(levels.c[name].label(f"level_{name}") for name in _LEVELS))
        .join(estimates, spectra.c.estimate == estimates.c.id)
        .join(levels, sa.and_(levels.c.estimate == estimates.c.id, levels.c.name == spectra.c.node))
        .where(spectra.c.rig == run["rig"], spectra.c.scope == scope.value, spectra.c.node == node)
    )
    row = connection.execute(query).mappings().first()
    if row is None:
        return None
    samples = np.frombuffer(row["samples"], "<f8").reshape(-1, run["lines"]).astype(np.float64)
    # A database of before p-values were kept has fewer rows: those are the first ones, and the rest is unknown.
    kept = zip(SPECTRA[1:], samples[1:], strict=False)
    columns = {name: values[:, np.newaxis] for name, values in kept}
    estimate = Estimate(
        scope=scope,
        time=row["time"],
        realisation=row["realisation"],
        realisations=row["realisations"],
        experiments=row["experiments"],
        periods=row["periods"],
        nodes=(NodeLevel(**{name: row[f"level_{name}"] for name in _LEVELS}),),
        spectra=Spectra(frequency=samples[0], **columns),
        located=row["located"],
    )
    about = {"rig": run["rig"], "name": node, "scope": scope.value, "time": time_json(row["time"])}
    return {**about, "realisations": row["realisations"], **spectrum_json(estimate, node)}


def elements(connection: sa.Connection, run: Row, scope: Scope) -> Json:
    """Return the elements that distort, in falling share, and whether they could be located."""
    row = newest_estimate(connection, run["id"], scope)
    return {
        "items": [] if row is None else row["elements"],
        "rig": run["rig"],
        "scope": scope.value,
        "located": row is not None and row["located"],
        "unavailable": [] if row is None else row["unavailable"],
        "remarks": _more(row).get("remarks", []),
        "time": None if row is None else time_json(row["time"]),
    }


@dataclass(frozen=True)
class HistoryFilter:
    """Which rows of the history are wanted; times are recorded ones, ``since <= time < until``."""

    rig: str
    scope: Scope = Scope.WINDOW
    node: str | None = None
    since: int | None = None
    until: int | None = None


def history(
    connection: sa.Connection, wanted: HistoryFilter, after: int | None, limit: int, *, oldest: bool
) -> Slice:
    """Return levels that nodes had, over all runs of the rig, in the order in which they were written."""
    levels = tables.levels
    query = sa.select(levels).where(levels.c.rig == wanted.rig, levels.c.scope == wanted.scope.value)
    if wanted.node is not None:
        query = query.where(levels.c.name == wanted.node)
    if wanted.since is not None:
        query = query.where(levels.c.time >= wanted.since)
    if wanted.until is not None:
        query = query.where(levels.c.time < wanted.until)
    if after is not None:
        query = query.where(levels.c.id > after if oldest else levels.c.id < after)
    order = levels.c.id.asc() if oldest else levels.c.id.desc()
    rows = connection.execute(query.order_by(order).limit(limit + 1)).mappings().all()
    return Slice([_moment(row) for row in rows[:limit]], (rows[limit - 1]["id"],) if len(rows) > limit else None)


@dataclass(frozen=True)
class AlarmFilter:
    """Which alarms are wanted; ``since`` is the earliest recorded time at which they were raised."""

    states: tuple[AlarmState, ...] = ()
    rig: str | None = None
    node: str | None = None
    since: int | None = None


def alarms(connection: sa.Connection, wanted: AlarmFilter, after: tuple[int, int] | None, limit: int) -> Slice:
    """Return alarm occurrences as they stand, the one raised last first.

    What never was an alarm is there only if states are asked for that an operator brings about.
    """
    table = tables.alarms
    query = sa.select(table)
    raised = sa.or_(table.c.never_raised.is_(None), sa.not_(table.c.never_raised))
    if wanted.states:
        query = query.where(table.c.state.in_([state.value for state in wanted.states]))
        raised = sa.or_(raised, table.c.state.in_([state.value for state in _OUT_OF_SIGHT]))
    query = query.where(raised)
    if wanted.rig is not None:
        query = query.where(table.c.rig == wanted.rig)
    if wanted.node is not None:
        query = query.where(table.c.node == wanted.node)
    if wanted.since is not None:
        query = query.where(table.c.since >= wanted.since)
    if after is not None:
        since, seq = after
        query = query.where(sa.or_(table.c.since < since, sa.and_(table.c.since == since, table.c.seq < seq)))
    query = query.order_by(table.c.since.desc(), table.c.seq.desc()).limit(limit + 1)
    rows = connection.execute(query).mappings().all()
    end = (rows[limit - 1]["since"], rows[limit - 1]["seq"]) if len(rows) > limit else None
    return Slice([alarm_json(change_of(row)) for row in rows[:limit]], end)


def alarm(connection: sa.Connection, identifier: str) -> Json | None:
    """Return one alarm with its journal, oldest change first; None if there is no such alarm."""
    row = connection.execute(sa.select(tables.alarms).where(tables.alarms.c.id == identifier)).mappings().first()
    if row is None:
        return None
    journal = tables.journal
    changes = connection.execute(
        sa.select(journal.c.payload).where(journal.c.alarm == identifier).order_by(journal.c.seq)
    ).scalars()
    return {**alarm_json(change_of(row)), "changes": [json.loads(change) for change in changes]}


def alarm_change(connection: sa.Connection, identifier: str, *, to_change: bool = False) -> AlarmChange | None:
    """Return the newest change of an alarm; None if there is no such alarm.

    With ``to_change`` nobody else changes it before the transaction ends.
    """
    query = sa.select(tables.alarms).where(tables.alarms.c.id == identifier)
    row = connection.execute(query.with_for_update() if to_change else query).mappings().first()
    return None if row is None else change_of(row)


def alarm_is_of_an_earlier_run(connection: sa.Connection, identifier: str) -> bool:
    """Tell whether an alarm was raised in a run that is not its rig's current one."""
    alarms = tables.alarms
    query = sa.select(tables.rigs.c.run, alarms.c.run).join(alarms, alarms.c.rig == tables.rigs.c.name)
    row = connection.execute(query.where(alarms.c.id == identifier)).first()
    return row is not None and row[0] != row[1]


def alarm_rules(run: Row | None) -> AlarmRules:
    """Return the rules by which the alarms of a run live; the usual ones if they are not known."""
    return AlarmRules(**((run["rules"] if run is not None else None) or {}))


def recordings(connection: sa.Connection, rig_name: str | None, after: int | None, limit: int) -> Slice:
    """Return the recordings, the one begun last first."""
    table = tables.recordings
    query = sa.select(table)
    if rig_name is not None:
        query = query.where(table.c.rig == rig_name)
    if after is not None:
        query = query.where(table.c.seq < after)
    rows = connection.execute(query.order_by(table.c.seq.desc()).limit(limit + 1)).mappings().all()
    items = [
        {
            **{name: row[name] for name in ("id", "rig", "run", "path", "status", "size")},
            "start": time_json(row["start"]),
            "end": moment_json(row["end"]),
        }
        for row in rows[:limit]
    ]
    return Slice(items, (rows[limit - 1]["seq"],) if len(rows) > limit else None)


@dataclass(frozen=True)
class Event:
    """One entry of the event stream; ``payload`` is JSON."""

    id: int
    kind: str
    payload: str


def event_range(connection: sa.Connection) -> tuple[int, int]:
    """Return the ids of the oldest event that is kept and of the newest; with none kept, the oldest lies above."""
    newest = connection.execute(
        sa.select(tables.counters.c.value).where(tables.counters.c.name == "events")
    ).scalar_one()
    oldest = connection.execute(sa.select(sa.func.min(tables.events.c.id))).scalar_one()
    return (newest + 1 if oldest is None else oldest), newest


def events(connection: sa.Connection, after: int, limit: int) -> list[Event]:
    """Return the events that follow an id, in order."""
    table = tables.events
    query = sa.select(table.c.id, table.c.kind, table.c.payload).where(table.c.id > after)
    return [Event(*row) for row in connection.execute(query.order_by(table.c.id).limit(limit))]


def _rig(connection: sa.Connection, row: Row) -> Json:
    states = alarm_states(connection, row["id"])
    return {
        "name": row["rig"],
        "run": row["id"],
        "status": row["status"],
        "message": row["message"],
        "source": row["source"],
        "software": row["software"],
        "start": time_json(row["start"]),
        "last": moment_json(row["last"]),
        "end": moment_json(row["end"]),
        "heard_at": moment_json(row["heard_at"]),
        "nodes": [node["name"] for node in row["nodes"]],
        "frames": row["frames"],
        "rejected_frames": row["rejected_frames"],
        "transient_frames": row["transient_frames"],
        "realisations": row["realisations"],
        "experiments": row["experiments"],
        "faults": row["faults"],
        "alarms": {name: state.value for name, state in states.items() if state is not AlarmState.NORMAL},
    }


def _recent_faults(connection: sa.Connection, run: str, count: int = 20) -> list[Json]:
    table = tables.faults
    query = sa.select(table).where(table.c.run == run).order_by(table.c.id.desc()).limit(count)
    return [
        fault_json(Fault(**{**{name: row[name] for name in _FAULT}, "kind": FaultKind(row["kind"])}))
        for row in connection.execute(query).mappings()
    ]


def _quality(connection: sa.Connection, run: Row) -> list[Json]:
    """Return what is wrong with frames that count all the same: the newest message and how often, by kind."""
    table = tables.faults
    items = []
    for kind in sorted(FLAWS):
        if run["faults"].get(kind.value):
            query = sa.select(table.c.message).where(table.c.run == run["id"], table.c.kind == kind.value)
            message = connection.execute(query.order_by(table.c.id.desc()).limit(1)).scalar()
            items.append({"kind": kind.value, "message": message or "", "findings": run["faults"][kind.value]})
    return items


def _more(estimate: Row | None) -> Json:
    """Return what an estimate says without a column of its own; nothing of one from before it was kept."""
    return {} if estimate is None else estimate["more"] or {}


def _moment(row: Row) -> Json:
    item = node_json(_level(row), AlarmState.NORMAL)
    del item["alarm"]  # a level is a figure of its moment, an alarm's state is not
    about = {name: row[name] for name in ("run", "scope", "realisation")}
    return {**item, **about, "time": time_json(row["time"])}


def _level(row: Row) -> NodeLevel:
    return NodeLevel(**{name: row[name] for name in _LEVELS})
