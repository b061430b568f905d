"""The sink that writes a run into the store, from which the API reads it.

What must not be lost (runs, estimates, alarm changes, each with the event that tells of it) is written at once,
one transaction a record, and is on disk when `StoreSink.take` returns. Counts and faults come by the thousand;
they are gathered and written about once a second.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import sqlalchemy as sa

from creak.codec import detection_json, element_json, fault_json, memory_bytes, node_json, time_json
from creak.config.rig import rig_toml
from creak.digests import Outcome
from creak.monitor import Memory
from creak.records import (
    AlarmChange,
    AlarmState,
    Counts,
    Estimate,
    Fault,
    Frame,
    Run,
    RunEnd,
    RunStatus,
    Spectra,
)
from creak.sinks import kept_sums, operator_tables, tables
from creak.sinks.alarm_rows import KEEP_EVENTS, put_alarm, tell
from creak.sinks.database import Store, Writing, open_store
from creak.sinks.restart import take_over
from creak.sinks.tally import Tally

__all__ = ["RUNNING", "RecordingEntry", "Store", "StoreSink", "open_store", "put_recording"]

RUNNING = "running"
"""Status of a run that has not ended; a run that ended has a `RunStatus`."""

SPECTRA = tuple(Spectra.__dataclass_fields__)
"""Rows of a stored spectrum: the fields of `Spectra` in order."""

BEAT_SECONDS = 5.0
"""How often a worker writes that it is alive while nothing else changes."""

_FLUSH_SECONDS = 1.0
_FAULTS_A_FLUSH = 200  # a storm of faults is counted in full, but only so many of it are kept as rows
_FAULTS_A_RUN = 5_000


@dataclass(frozen=True)
class RecordingEntry:
    """A recording as the store knows it.

    Parameters
    ----------
    id : str
        Unique.
    rig, run : str
    path : str
        Where the file lies.
    start : int
        Recorded time of its first sample, ns since the Unix epoch.
    end : int or None
        Recorded time of its end; None while it is being written.
    status : str
        ``writing``, ``complete`` or ``truncated``.
    size : int
        Bytes.
    """

    id: str
    rig: str
    run: str
    path: str
    start: int
    end: int | None
    status: str
    size: int


class StoreSink:
    """Writes one run of one rig.

    Parameters
    ----------
    store : Store, or Writing
        May be shared by the sinks of many rigs.
    keep_events : int
        How many events the stream can go back.
    clock : callable
        Wall clock, ns since the Unix epoch; tells the API whether worker and rig are alive.

    Raises
    ------
    StorageError
        From every method, if the store cannot be written. What was to be written is then not in the store, not
        even in part; counts and faults are kept and tried again at the next occasion.
    """

    def __init__(
        self, store: Writing, *, keep_events: int = KEEP_EVENTS, clock: Callable[[], int] = time.time_ns
    ) -> None:
        self._store = store
        self._keep_events = keep_events
        self._clock = clock
        self._run = ""
        self._rig = ""
        self._tally = Tally()
        self._faults: deque[Fault] = deque(maxlen=_FAULTS_A_FLUSH)
        self._last: int | None = None
        self._heard: int | None = None
        self._changed = False
        self._flushed = float("-inf")
        self._window = 1
        self._sums = kept_sums.NOTHING

    def open(self, run: Run) -> None:
        """Make a run the current one of its rig; what a run of the same id left behind is told anew."""
        self.resume(run, Counts())
        row = _run_row(run, self._clock())
        with self._store.write() as connection:
            _interrupt(connection, self._rig)
            if not connection.execute(
                sa.update(tables.runs).where(tables.runs.c.id == run.id).values(row)
            ).rowcount:
                connection.execute(sa.insert(tables.runs).values(row))
            else:
                _forget(connection, run.id)
            connection.execute(sa.delete(tables.spectra).where(tables.spectra.c.rig == self._rig))
            if not connection.execute(
                sa.update(tables.rigs).where(tables.rigs.c.name == self._rig).values(run=run.id)
            ).rowcount:
                connection.execute(sa.insert(tables.rigs).values(name=self._rig, run=run.id))
            take_over(connection, run)
            self._tell(connection, [("run", self._run_event(RUNNING, run.start))])

    def resume(self, run: Run, counts: Counts) -> None:
        """Go on with a run that is open in the store already."""
        self._run, self._rig = run.id, run.rig.name
        self._tally, self._last, self._heard = Tally(), None, None
        self._faults.clear()
        self._tally.restore(counts)
        self._window, self._sums = run.window, kept_sums.NOTHING

    def count(self, counts: Counts, reached: int, heard_at: int | None = None) -> None:
        """Take over counts of what was handled elsewhere, up to a recorded time; heard by wall clock."""
        self._tally.restore(counts)
        self._heard = heard_at or self._heard
        self._reached(reached)

    def flush(self, durable: bool = True) -> None:
        """Write counts and faults now."""
        with self._store.write(durable) as connection:
            self._flush(connection, self._tally.counts)
        self._clean()

    def take(self, record: Outcome) -> None:
        """Count a frame or a fault; write an estimate or an alarm change at once."""
        self._tally.take(record)
        match record:
            case Frame():
                self._heard = self._clock()
                self._reached(record.time)
            case Fault():
                self._faults.append(record)
                self._reached(record.time)
            case Estimate():
                self._reached(record.time)
                self._write_estimate(record)
            case AlarmChange():
                self._write_alarm(record)

    def tick(self, now: float) -> None:
        """Write counts and faults if a second has gone by, and a sign of life every few."""
        if now - self._flushed >= (_FLUSH_SECONDS if self._changed else BEAT_SECONDS):
            self._flushed = now  # also if it fails: a store in trouble is not asked at every tick
            self.flush(durable=False)

    def close(self, end: RunEnd) -> None:
        """Write how the run ended, with the counts of the monitor."""
        with self._store.write() as connection:
            self._flush(connection, end.counts)
            connection.execute(
                sa.update(tables.runs)
                .where(tables.runs.c.id == self._run)
                .values(status=end.status.value, end=end.time, message=end.message)
            )
            self._tell(connection, [("run", self._run_event(end.status.value, end.time))])
        self._clean()

    def save(self, memory: Memory) -> None:
        """Write what the rig's monitor has to know after a restart, in the place of what was there.

        Of the sums only those that the store lacks are written. It need not be on the disk at once: what must be
        is written behind it, and takes it along.
        """
        sums = kept_sums.changes(self._sums, self._window, memory.blocks)
        payload = memory_bytes(replace(memory, blocks=()))
        row = {"rig": self._rig, "run": self._run, "time": memory.time, "payload": payload}
        with self._store.write(durable=False) as connection:
            states = operator_tables.states
            if not connection.execute(sa.update(states).where(states.c.rig == self._rig).values(row)).rowcount:
                connection.execute(sa.insert(states).values(row))
            kept_sums.write(connection, kept_sums.state_sums, self._rig, sums)
        self._sums = sums.after

    def _reached(self, recorded: int) -> None:
        self._last = recorded if self._last is None else max(self._last, recorded)
        self._changed = True

    def _clean(self) -> None:
        """Forget what has been written; called after the transaction has come about."""
        self._faults.clear()
        self._changed = False

    def _flush(self, connection: sa.Connection, counts: Counts) -> None:
        """Write counts, times and the faults gathered."""
        values = {
            "beat_at": self._clock(),
            "last": self._last,
            "heard_at": self._heard,
            "frames": counts.frames,
            "rejected_frames": counts.rejected_frames,
            "transient_frames": counts.transient_frames,
            "realisations": counts.realisations,
            "experiments": counts.experiments,
            "faults": dict(counts.faults),
        }
        connection.execute(sa.update(tables.runs).where(tables.runs.c.id == self._run).values(values))
        if self._faults:
            rows = [{"run": self._run, **asdict(fault), "kind": fault.kind.value} for fault in self._faults]
            connection.execute(sa.insert(tables.faults), rows)
            _keep_newest(connection, tables.faults, self._run, _FAULTS_A_RUN)
            newest = {"rig": self._rig, "counts": dict(counts.faults), "newest": fault_json(self._faults[-1])}
            self._tell(connection, [("fault", newest)])

    def _write_estimate(self, estimate: Estimate) -> None:
        with self._store.write() as connection:
            key = connection.execute(
                sa.insert(tables.estimates).values(
                    run=self._run,
                    scope=estimate.scope.value,
                    time=estimate.time,
                    realisation=estimate.realisation,
                    realisations=estimate.realisations,
                    experiments=estimate.experiments,
                    periods=estimate.periods,
                    located=estimate.located,
                    elements=[element_json(element) for element in estimate.elements],
                    unavailable=list(estimate.unavailable),
                    more={
                        "detection": [detection_json(level) for level in estimate.detection],
                        "remarks": list(estimate.remarks),
                    },
                )
            ).inserted_primary_key
            number = int(key[0]) if key is not None else 0
            about = {
                "rig": self._rig,
                "run": self._run,
                "scope": estimate.scope.value,
                "time": estimate.time,
                "realisation": estimate.realisation,
            }
            if estimate.nodes:
                rows = [{"estimate": number, **about, **asdict(level)} for level in estimate.nodes]
                connection.execute(sa.insert(tables.levels), rows)
            self._replace_spectra(connection, number, estimate)
            self._flush(connection, self._tally.counts)
            states = alarm_states(connection, self._run)
            nodes = [node_json(node, states.get(node.name, AlarmState.NORMAL)) for node in estimate.nodes]
            self._tell(connection, [("levels", {**about, "time": time_json(estimate.time), "nodes": nodes})])
        self._clean()

    def _replace_spectra(self, connection: sa.Connection, estimate: int, newest: Estimate) -> None:
        scope = newest.scope.value
        connection.execute(
            sa.delete(tables.spectra).where(tables.spectra.c.rig == self._rig, tables.spectra.c.scope == scope)
        )
        if newest.nodes:
            rows = [
                {
                    "rig": self._rig,
                    "scope": scope,
                    "node": level.name,
                    "estimate": estimate,
                    "samples": _spectra_bytes(newest.spectra, i),
                }
                for i, level in enumerate(newest.nodes)
            ]
            connection.execute(sa.insert(tables.spectra), rows)

    def _write_alarm(self, change: AlarmChange) -> None:
        with self._store.write() as connection:
            put_alarm(connection, self._run, change, keep_events=self._keep_events)

    def _run_event(self, status: str, recorded: int) -> dict[str, Any]:
        return {"rig": self._rig, "run": self._run, "status": status, "time": time_json(recorded)}

    def _tell(self, connection: sa.Connection, news: Iterable[tuple[str, Mapping[str, Any]]]) -> None:
        tell(connection, self._rig, news, self._keep_events)


def put_recording(store: Store, entry: RecordingEntry) -> None:
    """Write a recording's entry, or what has changed of it.

    Raises
    ------
    StorageError
    """
    row = asdict(entry)
    with store.write() as connection:
        if not connection.execute(
            sa.update(tables.recordings).where(tables.recordings.c.id == entry.id).values(row)
        ).rowcount:
            connection.execute(sa.insert(tables.recordings).values(row))


def alarm_states(connection: sa.Connection, run: str) -> dict[str, AlarmState]:
    """Return the state of every node that has alarmed in a run: that of its newest process alarm."""
    alarms = tables.alarms
    rows = connection.execute(
        sa.select(alarms.c.node, alarms.c.state)
        .where(alarms.c.run == run, alarms.c.class_ == "process")
        .order_by(alarms.c.seq)
    )
    return {node: AlarmState(state) for node, state in rows}


def _run_row(run: Run, now: int) -> dict[str, Any]:
    rig = run.rig
    return {
        "id": run.id,
        "rig": rig.name,
        "configuration": rig_toml(rig),
        "sample_rate": rig.sample_rate,
        "period_samples": rig.period_samples,
        "lines": len(rig.lines),
        "nodes": [asdict(node) for node in rig.nodes],
        "steady_periods": run.steady_periods,
        "window": run.window,
        "source": run.source,
        "software": run.software,
        "excitation": asdict(run.excitation),
        "limits": asdict(run.limits),
        "rules": asdict(run.alarms),
        "start": run.start,
        "last": None,
        "end": None,
        "status": RUNNING,
        "message": "",
        "opened_at": now,
        "beat_at": now,
        "heard_at": None,
        "frames": 0,
        "rejected_frames": 0,
        "transient_frames": 0,
        "realisations": 0,
        "experiments": 0,
        "faults": {},
    }


def _interrupt(connection: sa.Connection, rig: str) -> None:
    """End the runs of a rig that a killed worker left open."""
    runs = tables.runs
    connection.execute(
        sa.update(runs)
        .where(runs.c.rig == rig, runs.c.status == RUNNING)
        .values(status=RunStatus.INTERRUPTED.value, message="its worker ended without closing it")
    )


def _forget(connection: sa.Connection, run: str) -> None:
    """Remove what an earlier telling of the same run left, which would otherwise stand there twice."""
    for table in (tables.estimates, tables.faults, tables.journal, tables.alarms):  # levels and spectra cascade
        connection.execute(sa.delete(table).where(table.c.run == run))


def _keep_newest(connection: sa.Connection, table: sa.Table, run: str, count: int) -> None:
    oldest = sa.select(table.c.id).where(table.c.run == run).order_by(table.c.id.desc()).offset(count).limit(1)
    connection.execute(sa.delete(table).where(table.c.run == run, table.c.id <= oldest.scalar_subquery()))


def _spectra_bytes(spectra: Spectra, node: int) -> bytes:
    """Pack one node's spectra, ``(len(SPECTRA), F)`` float64, little endian; NaN where there is none."""
    columns = [getattr(spectra, name) for name in SPECTRA[1:]]
    unknown = np.full(len(spectra.frequency), np.nan)
    rows = [spectra.frequency, *(unknown if column is None else column[:, node] for column in columns)]
    return np.stack(rows).astype("<f8").tobytes()
