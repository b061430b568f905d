"""What a run takes over from the one before it: the monitor's state, recorded time, and the alarms that stand."""

from dataclasses import replace

import sqlalchemy as sa

from creak.alarms import end, of_change
from creak.codec import memory_of
from creak.monitor import Memory
from creak.records import AlarmState, Run
from creak.sinks import kept_sums, operator_tables, tables
from creak.sinks.alarm_rows import change_of, put_alarm
from creak.sinks.database import Store


def saved_memory(store: Store, rig: str) -> Memory | None:
    """Return what a rig's monitor saved last; None if there is nothing.

    Raises
    ------
    RecordingError
        If it is none of this version's.
    """
    states = operator_tables.states
    with store.read() as connection:
        payload = connection.execute(sa.select(states.c.payload).where(states.c.rig == rig)).scalar()
        if payload is None:
            return None
        memory = memory_of(payload)
        if memory.blocks:  # up to version 5 they were in it
            return memory
        return replace(memory, blocks=kept_sums.read(connection, kept_sums.state_sums, rig).blocks)


def recorded_until(store: Store, rig: str) -> int:
    """Return the recorded time up to which frames of a rig's last run came, ns; 0 if none did."""
    runs = tables.runs
    with store.read() as connection:
        row = connection.execute(
            sa.select(runs.c.last, runs.c.period_samples, runs.c.sample_rate)
            .join(tables.rigs, tables.rigs.c.run == runs.c.id)
            .where(tables.rigs.c.name == rig)
        ).first()
    return 0 if row is None or row[0] is None else int(row[0]) + round(row[1] / row[2] * 1e9)


def take_over(connection: sa.Connection, run: Run) -> None:
    """Make the alarms that the new run's monitor remembers its own, and end all others of the rig that stand.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Of the durable transaction in which the run becomes the rig's current one.
    run : Run
    """
    known: set[str] = set()
    if run.before:
        memory, nodes = memory_of(run.before), {node.name for node in run.rig.nodes}
        known = {node.alarm.id for node in memory.nodes if node.alarm.node in nodes}
        known |= {alarm.id for alarm in memory.quality.alarms.values() if alarm.node in {"", *nodes}}
    alarms = tables.alarms
    of_rig = sa.and_(alarms.c.rig == run.rig.name, alarms.c.run.not_in(["", run.id]))  # "": the service's own
    connection.execute(sa.update(alarms).where(of_rig, alarms.c.id.in_(known)).values(run=run.id))
    over = [AlarmState.NORMAL.value, AlarmState.RETURNED_UNACKNOWLEDGED.value]
    last = sa.select(tables.runs.c.last).where(tables.runs.c.id == alarms.c.run).scalar_subquery()
    standing = sa.select(alarms, last.label("last")).where(of_rig, alarms.c.state.not_in(over))
    for row in connection.execute(standing).mappings().all():
        change = change_of(row)
        time = max(change.time, row["last"] or 0)
        _, changes = end(of_change(change), time, "its run has ended, and the next one knows nothing of it")
        for made in changes:
            put_alarm(connection, row["run"], made)
