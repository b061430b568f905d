"""What a fleet must have stored, worked out from the workers' recordings alone, and what it has."""

import json
from collections import Counter

import sqlalchemy as sa

from creak.cli.sources import named_rigs, plan_of
from creak.codec import alarm_json
from creak.config.service import load_service
from creak.digests import CLOSING, Digest, summed
from creak.monitor import Monitor
from creak.records import AlarmChange, Estimate
from creak.sinks import fleet, tables
from creak.sinks.journal import Journal
from creak.sources.retold import BEFORE_ALL, retold


def expected(folder, rig):
    """Estimates by (run, scope, realisation), process alarm changes in order, complete realisations by run."""
    settings = load_service(folder / "analyse.toml")
    rigs = named_rigs(settings, "analyse.toml")
    plan = next(plan_of(t, r) for t, r in zip(settings.rigs, rigs, strict=True) if r.name == rig)
    journal = _journal(folder, rig)
    estimates, changes, complete, memory = {}, [], {}, None
    for run in journal.runs:
        monitor = None
        for opening, digest, _ in retold(journal.parts(run), BEFORE_ALL, whole_frames=False, ended=True):
            assert isinstance(digest, Digest)
            if monitor is None:
                monitor = Monitor(plan.applied(opening), memory)
            for outcome in monitor.take_digest(summed(monitor.run, digest)):
                if isinstance(outcome, Estimate):
                    key = opening.id, outcome.scope.value, outcome.realisation
                    estimates[key] = [level.total_to_noise_db for level in outcome.nodes]
                elif isinstance(outcome, AlarmChange) and outcome.class_ == "process":
                    changes.append(alarm_json(outcome))
        memory = monitor.memory
        complete[monitor.run.id] = monitor.counts.realisations
    return estimates, changes, complete


def stored(engine, rig):
    """The same from the store, and how often anything stands in it more than once."""
    with engine.begin() as connection:
        levels = tables.levels
        rows = connection.execute(
            sa.select(levels.c.run, levels.c.scope, levels.c.realisation, levels.c.total_to_noise_db)
            .where(levels.c.rig == rig)
            .order_by(levels.c.id)
        ).all()
        known = connection.execute(
            sa.select(tables.estimates.c.run, tables.estimates.c.scope, tables.estimates.c.realisation)
            .join(tables.runs, tables.runs.c.id == tables.estimates.c.run)
            .where(tables.runs.c.rig == rig)
        ).all()
        payloads = connection.execute(sa.select(tables.journal.c.payload).order_by(tables.journal.c.seq)).scalars()
        journal = [json.loads(payload) for payload in payloads]
        runs = sa.select(tables.runs.c.id, tables.runs.c.realisations).where(tables.runs.c.rig == rig)
        complete = {row.id: row.realisations for row in connection.execute(runs)}
    estimates = {}
    for run, scope, realisation, ratio in rows:
        estimates.setdefault((run, scope, realisation), []).append(ratio)
    mine = [change for change in journal if change["rig"] == rig]
    twice = sum(n - 1 for n in Counter(map(tuple, known)).values())
    alarms_twice = sum(n - 1 for n in Counter((c["id"], c["version"]) for c in mine).values())
    return estimates, [c for c in mine if c["class"] == "process"], complete, twice, alarms_twice


def progress(engine):
    """Place, owner and complete realisations of every rig."""
    with engine.begin() as connection:
        if not sa.inspect(connection).has_table("fleet"):
            return {}
        table = fleet.fleet
        columns = table.c.rig, table.c.owner, table.c.begun, table.c.realisation, table.c.blocks
        return {row.rig: row for row in connection.execute(sa.select(*columns))}


def closed(engine, folder, rigs):
    """True if the last run of every rig has been told to its end; an earlier one may end long before it."""
    rows = progress(engine)
    last = {rig: _journal(folder, rig).runs[-1].begun for rig in rigs}
    return all(rig in rows and (rows[rig].begun, rows[rig].realisation) == (last[rig], CLOSING) for rig in rigs)


def _journal(folder, rig):
    return Journal(folder / f"data-{rig}" / f"{rig}.sent.json")
