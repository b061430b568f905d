"""The store: what goes in comes out, whole or not at all, whoever reads, writes or dies meanwhile."""

import os
import re
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sqlalchemy as sa
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_rig
from creak.codec import alarm_json, element_json, node_json, spectrum_json
from creak.errors import StorageError
from creak.findings import DetectionLevel
from creak.monitor import Monitor
from creak.records import AlarmState, Counts, Fault, FaultKind, Frame, Node, NodeLevel, RunEnd, RunStatus, Scope
from creak.sinks import queries, tables
from creak.sinks.database import open_store
from creak.sinks.store import RecordingEntry, put_recording
from creak.sinks.tally import Tally
from store_records import (
    GROUND,
    SECOND,
    START,
    feed,
    make_alarm,
    make_estimate,
    make_fault,
    make_frame,
    make_run,
    opened,
)


def count(store, table):
    with store.read() as connection:
        return connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one()


def fail_on(store, statement):
    """Make a statement fail as a full disk would; gives the function that ends it."""

    def failing(connection, cursor, text, *_):
        if statement in text:
            raise engine.dialect.loaded_dbapi.OperationalError("database or disk is full")

    engine = store._engine
    sa.event.listen(engine, "before_cursor_execute", failing)
    return lambda: sa.event.remove(engine, "before_cursor_execute", failing)


# --- what goes in comes out ------------------------------------------------------------------------------------

names = st.text(st.characters(exclude_categories=["C"]), min_size=1, max_size=8)
figures = st.none() | st.floats(width=64)


@st.composite
def estimates(draw):
    rig = make_rig(n=draw(st.integers(1, 4)), lines=range(2, 2 + draw(st.integers(1, 5))))
    labels = draw(st.lists(names, min_size=rig.n, max_size=rig.n, unique=True))
    rig = replace(rig, nodes=tuple(Node(name, "m", "N") for name in labels))
    run = make_run(rig=rig)
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    estimate = make_estimate(run, draw(st.integers(0, 50)), draw(st.sampled_from(Scope)), rng=rng)
    levels = tuple(NodeLevel(name, draw(st.floats()), *[draw(figures) for _ in range(8)]) for name in labels)
    return run, replace(estimate, nodes=levels, elements=draw(st.sampled_from([(), (GROUND,)])))


@settings(max_examples=40, deadline=None)
@given(estimates())
def test_estimate_comes_out_as_it_went_in(tmp_path_factory, made):
    """Kills a mixed-up column, node order or byte order, and NaN or infinity that breaks JSON or a constraint."""
    run, estimate = made
    store = open_store(f"sqlite:///{tmp_path_factory.mktemp('law')}/creak.db")
    opened(store, run).take(estimate)
    with store.read() as connection:
        row = queries.current_run(connection, run.rig.name)
        nodes = queries.nodes(connection, row, estimate.scope)
        assert [node["name"] for node in nodes] == [node.name for node in run.rig.nodes]
        for node, level in zip(nodes, estimate.nodes, strict=True):
            assert node_json(level, AlarmState.NORMAL).items() <= node.items()
            spectrum = queries.spectrum(connection, row, level.name, estimate.scope)
            assert spectrum_json(estimate, level.name).items() <= spectrum.items()
        found = queries.elements(connection, row, estimate.scope)["items"]
        assert found == [element_json(element) for element in estimate.elements]
    store.close()


def test_what_the_data_say_of_themselves_is_told(store):
    """Kills detection lines, remarks and flaws that stand in a replay only; a flaw that later faults push out."""
    run = make_run()
    levels = tuple(DetectionLevel(name, -70.0, -90.0, None, -120.0) for name in "213")
    sink = opened(store, run)
    sink.take(Fault(FaultKind.STUCK, 1, "realisation 0: response 2 does not move", 0))
    for late in range(30):
        sink.take(Fault(FaultKind.LOST, 2 + late, "gone"))
    sink.take(replace(make_estimate(run, 0), detection=levels, remarks=("an edge is missing",)))
    with store.read() as connection:
        row = queries.current_run(connection, run.rig.name)
        shown = [node["detection"] for node in queries.nodes(connection, row, Scope.WINDOW)]
        assert shown == [{"excited_db": -70.0, "odd_db": -90.0, "even_db": None, "noise_db": -120.0}] * 3
        assert queries.elements(connection, row, Scope.WINDOW)["remarks"] == ["an edge is missing"]
        (flaw,) = queries.rig(connection, run.rig.name)["quality"]
    assert flaw == {"kind": "stuck", "message": "realisation 0: response 2 does not move", "findings": 1}


def test_spectra_of_before_there_were_p_values_are_still_read(store):
    """Kills rows that are counted off by today's fields: one quantity would appear under another's name."""
    run = make_run()
    estimate = make_estimate(run, 0, rng=np.random.default_rng(1))
    opened(store, run).take(estimate)
    with store.write() as connection:
        table = tables.spectra
        for row in connection.execute(sa.select(table)).mappings().all():
            old = row["samples"][: 8 * len(row["samples"]) // 11]  # the eight quantities there were
            connection.execute(sa.update(table).where(table.c.node == row["node"]).values(samples=old))
    without = replace(estimate.spectra, p_value=None, q_value=None, classical_p_value=None)
    expected = spectrum_json(replace(estimate, spectra=without), "2")
    with store.read() as connection:
        found = queries.spectrum(connection, queries.current_run(connection, run.rig.name), "2", estimate.scope)
    assert expected.items() <= found.items()
    assert set(found["p_value"]) == {None}


def test_counts_while_running_are_those_of_the_monitor(rng):
    """Kills live counts that jump when the run ends: lost, doubled, late, bad and incomplete frames included."""
    run = make_run(rig=make_rig(n=2))
    monitor, tally = Monitor(run), Tally()
    rig = run.rig
    frames = [
        Frame(m, c, p, START + m * SECOND, *rng.standard_normal((2, 2, rig.period_samples)))
        for m in range(30)
        for c in range(rig.q)
        for p in range(run.periods)
    ]
    for frame in frames:
        chance = rng.random()
        if chance < 0.02:
            continue
        items = [frame]
        if chance < 0.04:
            items.append(frame)
        elif chance < 0.06:
            items = [replace(frame, y=np.full_like(frame.y, np.nan))]
        elif chance < 0.08:
            items = [replace(frame, realisation=max(frame.realisation - 3, 0))]
        elif chance < 0.10:
            items = [replace(frame, experiment=99)]
        for item in items:
            for outcome in monitor.take(item):
                tally.take(outcome)
            assert tally.counts == monitor.counts
    for outcome in monitor.finish():
        tally.take(outcome)
    assert tally.counts == monitor.counts
    assert tally.counts.realisations
    assert {"doubled", "not-finite", "late", "out-of-plan", "incomplete"} <= set(tally.counts.faults)


def test_alarm_is_its_newest_change_and_keeps_its_journal(store):
    run = make_run()
    sink = opened(store, run)
    raised = make_alarm(run)
    cleared = make_alarm(run, event="cleared")
    for change in (raised, cleared):
        sink.take(change)
    with store.read() as connection:
        found = queries.alarm(connection, raised.id)
        nodes = queries.nodes(connection, queries.current_run(connection, "beam"), Scope.WINDOW)
        (listed,) = queries.alarms(connection, queries.AlarmFilter(), None, 10).items
    assert found == {**alarm_json(cleared), "changes": [alarm_json(raised), alarm_json(cleared)]}
    assert listed == alarm_json(cleared)
    assert [node["alarm"] for node in nodes] == ["normal", "normal", "returned_unacknowledged"]


def test_recording_is_updated_in_place(store):
    entry = RecordingEntry("r1", "beam", "run-1", "var/r1.mcap", START, None, "writing", 100)
    put_recording(store, entry)
    put_recording(store, replace(entry, end=START + SECOND, status="complete", size=200))
    with store.read() as connection:
        (found,) = queries.recordings(connection, "beam", None, 10).items
    assert (found["status"], found["size"], found["end"]) == ("complete", 200, "2026-05-01T08:00:01.000000Z")


# --- restart ---------------------------------------------------------------------------------------------------


def test_restart_keeps_history_and_replaces_what_is_current(url):
    """Kills a new run that shows the levels of the one before, and a killed worker's run that stays 'running'."""
    first, second = make_run("run-1"), make_run("run-2")
    store = open_store(url)
    sink = opened(store, first)
    feed(sink, first, 3, ratio=12.0)
    sink.take(make_alarm(first))
    store.close()  # as a kill would leave it

    store = open_store(url)
    sink = opened(store, second)
    with store.read() as connection:
        row = queries.current_run(connection, "beam")
        assert (row["id"], row["status"], row["frames"]) == ("run-2", "running", 0)
        assert all(node["signal_db"] is None for node in queries.nodes(connection, row, Scope.WINDOW))
        assert queries.nodes(connection, row, Scope.WINDOW)[2]["alarm"] == "normal"
        assert queries.spectrum(connection, row, "3", Scope.WINDOW) is None
        old = connection.execute(sa.select(tables.runs.c.status).where(tables.runs.c.id == "run-1")).scalar_one()
        assert old == "interrupted"
        assert len(queries.alarms(connection, queries.AlarmFilter(), None, 10).items) == 1
    feed(sink, second, 2)
    sink.close(RunEnd(START + 9 * SECOND, RunStatus.COMPLETED, Counts(frames=12, realisations=2)))
    with store.read() as connection:
        wanted = queries.HistoryFilter("beam", node="3")
        rows = queries.history(connection, wanted, None, 100, oldest=True).items
        rig = queries.rig(connection, "beam")
    assert [(row["run"], row["realisation"]) for row in rows] == [
        *(("run-1", m) for m in range(3)),
        *(("run-2", m) for m in range(2)),
    ]
    assert (rig["status"], rig["frames"], rig["end"]) == ("completed", 12, "2026-05-01T08:00:09.000000Z")
    store.close()


def test_a_run_told_twice_stands_once(store):
    """Kills doubled history and alarms when a recording is played into the store again."""
    run = make_run()
    for _ in range(2):
        sink = opened(store, run)
        feed(sink, run, 2)
        sink.take(make_alarm(run))
        sink.take(make_fault())
        sink.close(RunEnd(START, RunStatus.COMPLETED, Counts()))
    sizes = {
        table.name: count(store, table) for table in (tables.runs, tables.levels, tables.alarms, tables.faults)
    }
    assert sizes == {"runs": 1, "levels": 2 * 2 * run.rig.n, "alarms": 1, "faults": 1}
    with store.read() as connection:
        assert len(queries.alarm(connection, make_alarm(run).id)["changes"]) == 1


# --- together, and at the worst moment -------------------------------------------------------------------------


def test_readers_see_whole_moments_while_rigs_are_written(store):
    """Kills half-written estimates, 'database is locked', and event ids that become visible out of order."""
    rigs = [f"rig-{i}" for i in range(3)]
    failures, done = [], threading.Event()

    def write(name):
        try:
            run = make_run(f"run-{name}", name)
            sink = opened(store, run)
            for m in range(25):
                feed(sink, run, 1, first=m, ratio=float(m))
                sink.tick(float(2 * m))
        except Exception as error:  # noqa: BLE001 - reported below
            failures.append(error)

    seen = []

    def read():
        try:
            ended = False
            while not ended:
                ended = done.is_set()  # before reading: one more round then sees all
                with store.read() as connection:
                    for row in queries.current_runs(connection):
                        nodes = queries.nodes(connection, row, Scope.WINDOW)
                        assert len({(node["time"], node["signal_db"]) for node in nodes}) == 1
                        whole = queries.nodes(connection, row, Scope.RUN)
                        assert whole[0]["realisations"] == row["realisations"]  # written with the estimate
                    seen.extend(event.id for event in queries.events(connection, max(seen, default=0), 1000))
        except Exception as error:  # noqa: BLE001 - reported below
            failures.append(error)

    threads = [threading.Thread(target=write, args=(name,)) for name in rigs]
    reader = threading.Thread(target=read)
    for thread in (*threads, reader):
        thread.start()
    for thread in threads:
        thread.join()
    done.set()
    reader.join(30)
    assert not failures
    assert not reader.is_alive()
    assert seen == list(range(1, 3 * (1 + 25 * 2) + 1))


def test_nothing_is_half_written_when_a_statement_fails(store):
    """Kills an alarm without its event; and counts and faults that are lost with a failed attempt."""
    run = make_run()
    sink = opened(store, run)
    for number in range(3):
        sink.take(make_fault(number=number))
    end = fail_on(store, "INSERT INTO events")
    with pytest.raises(StorageError, match=r"creak[._]\w+: database or disk is full"):
        sink.take(make_alarm(run))
    with pytest.raises(StorageError):
        sink.tick(1.0)
    end()
    assert count(store, tables.alarms) == count(store, tables.journal) == count(store, tables.faults) == 0
    sink.tick(2.0)
    assert count(store, tables.faults) == 3
    with store.read() as connection:
        assert queries.rig(connection, "beam")["faults"] == {"lost": 3}


_WRITER = """
import sys
from creak.sinks.database import open_store
from store_records import make_alarm, make_run, opened
store = open_store(sys.argv[1])
run = make_run()
sink = opened(store, run)
for number in range(100_000):
    sink.take(make_alarm(run, number=number))
    sys.stdout.write(f"{number}\\n")
    sys.stdout.flush()
"""


@pytest.mark.parametrize("lines", [1, 7, 40])
def test_killed_writer_loses_nothing_it_reported(url, lines):
    """Kills an alarm that was reported as stored but was not, or that is stored without its event."""
    paths = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    command = [sys.executable, "-c", _WRITER, url]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as writer:
        for _ in range(lines):
            last = int(writer.stdout.readline())
        writer.send_signal(signal.SIGKILL)
        reported = [last, *map(int, re.findall(r"(\d+)\n", writer.stdout.read()))]
    store = open_store(url)
    with store.read() as connection:
        stored = connection.execute(sa.select(tables.alarms.c.id).order_by(tables.alarms.c.seq)).scalars().all()
        told = [event.payload for event in queries.events(connection, 0, 10**6) if event.kind == "alarm"]
    store.close()
    assert max(reported) < len(stored) == len(told) == len(set(stored))


# --- what comes by the thousand --------------------------------------------------------------------------------


def test_storm_of_faults_is_counted_whole_and_kept_in_part(store):
    """Kills memory and rows that grow with faults; the counts must not."""
    run = make_run()
    sink = opened(store, run)
    for second in range(3):
        for number in range(20_000):
            sink.take(make_fault(FaultKind.LATE, number))
        sink.tick(float(second + 1))
    with store.read() as connection:
        rig = queries.rig(connection, "beam")
    assert rig["faults"] == {"late": 60_000}
    assert rig["recent_faults"][0]["message"] == "period 19999 never came"
    assert count(store, tables.faults) == 600


def test_status_is_written_once_a_second_at_most(store):
    """Kills a transaction a frame."""
    run = make_run()
    sink = opened(store, run)
    written = []
    sa.event.listen(store._engine, "commit", lambda connection: written.append(1))
    for i in range(1000):
        sink.take(make_frame(run, 0, period=i))
        sink.tick(i / 100)
    assert 9 <= len(written) <= 11


def test_events_are_pruned_from_the_old_end(store):
    run = make_run()
    sink = opened(store, run, keep_events=100)
    for number in range(600):
        sink.take(make_alarm(run, number=number))
    with store.read() as connection:
        oldest, newest = queries.event_range(connection)
        ids = [event.id for event in queries.events(connection, 0, 1000)]
    assert newest == 601
    assert ids == list(range(oldest, newest + 1))
    assert 100 <= len(ids) <= 356
