"""A store in trouble harms neither acquisition nor what is already known; operators are heard through it."""

import contextlib
import sqlite3
import time
from dataclasses import replace

import pytest
import sqlalchemy as sa

from conftest import make_frames, make_rig
from conftest import make_run as make_real_run
from creak.alarm_records import Action, ActionKind
from creak.errors import StorageError
from creak.monitor import Monitor
from creak.records import AlarmChange, Counts, RunEnd, RunStatus
from creak.sinks import actions, database, queries, tables
from creak.sinks.background import BackgroundStore
from creak.sinks.database import open_store
from creak.sinks.inbox import Inbox
from creak.sinks.restart import saved_memory
from creak.sinks.store import StoreSink
from creak.worker import Worker
from processes import wait_for
from store_records import START, feed, make_alarm, make_estimate, make_run

RUN = make_run()
END = RunEnd(START, RunStatus.COMPLETED, Counts())


@pytest.fixture
def store(tmp_path):
    made = open_store(f"sqlite:///{tmp_path}/creak.db")
    yield made
    made.close()


@contextlib.contextmanager
def locked(tmp_path):
    """Another program holds the database, as a backup does."""
    other = sqlite3.connect(tmp_path / "creak.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    try:
        yield
    finally:
        other.execute("ROLLBACK")
        other.close()


def count(store, table):
    with store.read() as connection:
        return connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one()


def test_locked_store_holds_nobody_up_and_gets_everything_afterwards(tmp_path, monkeypatch, caplog, request):
    """Kills a worker that waits for a lock, and a record that is lost because the store was busy."""
    monkeypatch.setattr(database, "_READER_WAIT_MS", 500)
    store = request.getfixturevalue("store")  # opened now
    desk = BackgroundStore(store, StoreSink(store))
    desk.open(RUN)
    with locked(tmp_path):
        begun = time.monotonic()
        for number in range(5):  # first, so that it is one of them whose write fails
            desk.take(make_alarm(RUN, number=number))
        feed(desk, RUN, 20)
        desk.tick(time.monotonic())
        desk.asked()
        assert time.monotonic() - begun < 1.0
        wait_for(lambda: "tried again until it is written" in caplog.text)
        assert count(store, tables.alarms) == 0
    desk.close(END)
    assert count(store, tables.alarms) == 5
    assert count(store, tables.estimates) == 40
    with store.read() as connection:
        assert queries.current_run(connection, "beam")["status"] == "completed"


def test_full_queue_refuses_what_can_be_missed_and_keeps_alarms(store, tmp_path):
    desk = BackgroundStore(store, StoreSink(store), queue=10, patience=0.1)
    desk.open(RUN)
    with locked(tmp_path):
        taken = 0
        with pytest.raises(StorageError, match="10 records wait already"):  # noqa: PT012 - which one is of no matter
            for number in range(12):
                desk.take(make_estimate(RUN, number))
                taken += 1
        for number in range(12):
            desk.take(make_alarm(RUN, number=number))
    wait_for(lambda: count(store, tables.alarms) == 12)
    assert count(store, tables.estimates) == taken >= 10
    desk.close(END)


def test_record_that_can_never_be_stored_does_not_block_those_behind_it(store, caplog):
    desk = BackgroundStore(store, StoreSink(store))
    desk.open(RUN)
    desk.take(make_alarm(RUN, severity=None))
    desk.take(make_alarm(RUN, number=1))
    wait_for(lambda: count(store, tables.alarms) == 1)
    assert "left out" in caplog.text
    desk.close(END)


def test_a_store_that_lags_behind_saves_the_newest_state_and_not_all_that_wait(store, tmp_path, monkeypatch):
    """Kills a queue that grows because states are written that are out of date."""
    sink = StoreSink(store)
    saved, save = [], sink.save
    monkeypatch.setattr(sink, "save", lambda memory: (saved.append(memory.time), save(memory)))
    desk = BackgroundStore(store, sink)
    desk.open(RUN)
    with locked(tmp_path):
        for number in range(50):
            desk.save(replace(Monitor(RUN).memory, time=START + number))
    wait_for(lambda: (memory := saved_memory(store, "beam")) and memory.time == START + 49)
    assert len(set(saved)) < 10
    desk.close(END)


class Source:
    """Frames of a static structure, one realisation at a time, until it is told to end."""

    live = False

    def __init__(self, run, frames):
        self.run, self._frames, self.closed = run, frames, False

    def frames(self):
        for frame in self._frames:
            if self.closed:
                return
            yield frame
        while not self.closed:
            time.sleep(0.01)

    def close(self):
        self.closed = True


def test_operator_is_heard_and_a_restart_remembers(store):
    """From an alarm of real frames to its acknowledgement, and over a restart."""
    run = make_real_run(make_rig(name="beam"), start=START, run_id="first")
    frames = make_frames(run, 10, cubic=3, noise=1e-3)
    desk = BackgroundStore(store, StoreSink(store))
    worker = Worker(Source(run, frames), [desk], desk=desk)
    worker.start()

    def alarms(connection):
        return queries.alarms(connection, queries.AlarmFilter(), None, 10).items

    def raised():
        with store.read() as connection:
            return [a for a in alarms(connection) if a["class"] == "process"]

    (alarm,) = wait_for(raised)
    with store.write() as connection:
        asked = actions.ask(connection, "beam", Action(alarm["id"], ActionKind.ACKNOWLEDGE, "operator", "seen"))
        refused = actions.ask(connection, "beam", Action("nosuch", ActionKind.ACKNOWLEDGE, "operator"))

    def outcomes():
        with store.read() as connection:
            found = [actions.outcome(connection, item)[0] for item in (asked, refused)]
        return actions.PENDING not in found and found

    assert wait_for(outcomes) == [actions.DONE, actions.STALE]
    with store.read() as connection:
        assert queries.alarm(connection, alarm["id"])["state"] == "acknowledged"
        assert actions.waiting(connection, "beam", 0) == []
    worker.stop()
    assert worker.error is None
    memory = saved_memory(store, "beam")
    second = Monitor(make_real_run(make_rig(name="beam"), start=memory.time, run_id="second"), memory)
    assert second.alarms["3"] == "acknowledged"
    again = make_frames(second.run, 6, cubic=0, noise=1e-3)
    changes = [
        c for frame in again for c in second.take(frame) if isinstance(c, AlarmChange) and c.class_ == "process"
    ]
    assert [
        c for c in changes if c.event == "raised"
    ] == []  # it stands and is acknowledged; nobody is woken again


def test_many_rigs_ask_the_store_once_for_what_operators_want(store, monkeypatch):
    """Kills a hundred rigs that ask a hundred times as often as one, and an action that another rig hears."""
    inbox, reads = Inbox(store), []
    rigs = [f"rig {k}" for k in range(100)]
    for rig in rigs:
        assert inbox.waiting(rig, 0) == []
    with store.write() as connection:
        for rig in rigs[:3] * 2:
            actions.ask(connection, rig, Action("a", ActionKind.ACKNOWLEDGE, rig))
    wait_for(lambda: inbox.waiting(rigs[0], 0))
    read = store.read
    monkeypatch.setattr(store, "read", lambda: (reads.append(1), read())[1])
    monkeypatch.setattr("creak.sinks.inbox.LOOK_SECONDS", 3600.0)
    found = {rig: inbox.waiting(rig, 0) for rig in rigs}
    assert {asked.action.by for rig in rigs for asked in found[rig] if asked.action.by != rig} == set()
    assert [len(found[rig]) for rig in rigs[:4]] == [2, 2, 2, 0]
    assert inbox.waiting(rigs[0], found[rigs[0]][0].seq) == found[rigs[0]][1:]
    assert reads == []


def test_a_rig_whose_run_has_ended_keeps_no_other_from_being_heard(store):
    """Kills an inbox that fills up with what is asked of a rig that nobody measures any more."""
    inbox, desks = Inbox(store), {}
    for name in ("ended", "beam"):
        desks[name] = BackgroundStore(store, StoreSink(store), inbox=inbox)
        desks[name].open(make_run(f"{name}-1", name))
    desks["ended"].close(END)
    with store.write() as connection:
        for _ in range(100):  # as many as are read at a time
            actions.ask(connection, "ended", Action("a", ActionKind.SHELVE, "ada"), actions.DONE)
        actions.ask(connection, "beam", Action("b", ActionKind.ACKNOWLEDGE, "ada"))
    (asked,) = wait_for(desks["beam"].asked)
    assert asked.action.alarm == "b"
    desks["beam"].close(END)
