"""What the store keeps, brings up to date, and does when there is no more room."""

import itertools
import threading
from pathlib import Path

import pytest
import sqlalchemy as sa

from creak.alarm_records import Action, ActionKind, AlarmRules
from creak.alarms import of_change
from creak.errors import StorageError
from creak.records import Counts, RunEnd, RunStatus, Scope
from creak.sinks import actions, operator_tables, queries, tables
from creak.sinks.catalogue import CataloguedRecorder
from creak.sinks.database import open_store
from creak.sinks.recorder import Recorder
from creak.sinks.retention import DAY, SECOND, Thinning, keep_budget, thin_history
from creak.sinks.store import RecordingEntry, put_recording
from store_places import PLACES, place
from store_records import START, feed, make_alarm, make_frame, make_run, opened

RUN = make_run()


@pytest.fixture(params=PLACES)
def url(request, tmp_path):
    with place(request.param, tmp_path) as found:
        yield found


@pytest.fixture
def store(url):
    made = open_store(url)
    yield made
    made.close()


def times(store, scope=Scope.WINDOW):
    with store.read() as connection:
        page = queries.history(connection, queries.HistoryFilter("beam", scope, node="3"), None, 1000, oldest=True)
    return [item["realisation"] for item in page.items]


def test_history_is_thinned_by_age_and_what_is_current_stays(store):
    """Kills a rule that takes the newest rows, mixes nodes or scopes, or leaves rows that belong to nothing."""
    feed(opened(store, RUN), RUN, 60)  # a second each
    rules = (Thinning(10 * SECOND, 5 * SECOND), Thinning(30 * SECOND, 0))
    with store.write() as connection:
        assert thin_history(connection, rules) > 0
    left = times(store)
    assert left == times(store, Scope.RUN)
    assert left[-11:] == list(range(49, 60))
    old = left[:-11]
    assert old == sorted(old)
    assert 4 <= len(old) <= 6
    assert min(old) >= 29
    assert {b - a for a, b in itertools.pairwise(old[1:])} <= {1, 2, 3, 4, 5}
    with store.write() as connection:
        assert thin_history(connection, rules) == 0
        assert (
            queries.nodes(connection, queries.current_run(connection, "beam"), Scope.WINDOW)[2]["p_value"] == 0.5
        )
        estimates = connection.execute(sa.select(sa.func.count()).select_from(tables.estimates)).scalar_one()
    assert estimates == 2 * len(left)


def test_usual_rules_keep_a_week(store):
    feed(opened(store, RUN), RUN, 5)
    with store.write() as connection:
        assert thin_history(connection) == 0
    assert DAY == 86_400 * SECOND


def test_budget_takes_the_oldest_recordings_and_never_the_one_that_is_written(store, tmp_path):
    paths = []
    for number in range(5):
        path = tmp_path / f"part-{number}.mcap"
        path.write_bytes(b"x" * 100)
        status = "writing" if number in {1, 4} else "complete"
        put_recording(store, RecordingEntry(f"r{number}", "beam", "run-1", str(path), START, None, status, 100))
        paths.append(path)
    assert keep_budget(store, 500) == []
    assert keep_budget(store, 350) == [paths[0], paths[2]]
    assert [path.exists() for path in paths] == [False, True, False, True, True]
    assert keep_budget(store, 0) == [paths[3]]
    with store.read() as connection:
        assert [r["id"] for r in queries.recordings(connection, None, None, 10).items] == ["r4", "r1"]


def test_budget_takes_parts_of_a_recording_that_goes_on(store, tmp_path):
    """Kills a recorder that stumbles over a part of its own that is gone, or lists it anew."""
    opened(store, RUN)
    recorder = CataloguedRecorder(Recorder(tmp_path, max_bytes=1), store)  # a part each realisation
    recorder.open(RUN)
    for m in range(4):
        feed(recorder, RUN, 1, first=m)
        keep_budget(store, 0)
    recorder.close(RunEnd(START, RunStatus.COMPLETED, Counts()))
    with store.read() as connection:
        left = queries.recordings(connection, None, None, 10).items
    assert [(item["id"], item["status"]) for item in left] == [("beam-run-1-0004", "complete")]
    assert [path.stem for path in tmp_path.glob("*.mcap")] == ["beam-run-1-0004"]


def test_full_disk_stops_the_recording_with_an_alarm_that_can_be_acknowledged(store, tmp_path, monkeypatch):
    """Kills a full disk that nobody is told of."""
    sink = opened(store, RUN)
    recorder = CataloguedRecorder(Recorder(tmp_path), store)
    recorder.open(RUN)
    failing = StorageError("beam.mcap: recording stopped: No space left on device")
    monkeypatch.setattr(Recorder, "take", lambda *_: (_ for _ in ()).throw(failing))
    for number in range(3):
        with pytest.raises(StorageError):
            recorder.take(make_frame(RUN, number))
    feed(sink, RUN, 2)  # the store goes on
    with store.write() as connection:
        (alarm,) = queries.alarms(connection, queries.AlarmFilter(), None, 10).items
        assert (alarm["class"], alarm["rig"], alarm["node"], alarm["condition"]) == (
            "quality",
            "beam",
            "",
            "storage",
        )
        assert "No space left" in alarm["comment"]
        action = Action(alarm["id"], ActionKind.ACKNOWLEDGE, "operator")
        assert actions.carry_out(connection, action, AlarmRules(), START) is None
        assert queries.alarm_change(connection, alarm["id"]).acknowledged
    recorder.close(RunEnd(START, RunStatus.COMPLETED, Counts()))


# --- versions ----------------------------------------------------------------------------------------------------


def make_version_3(url):
    """A database as version 3 made it, with a run, an alarm and an action."""
    store = open_store(url)
    sink = opened(store, RUN)
    feed(sink, RUN, 2)
    sink.take(make_alarm(RUN))
    with store.write() as connection:
        actions.ask(connection, "beam", Action(make_alarm(RUN).id, ActionKind.ACKNOWLEDGE, "operator"))
        connection.exec_driver_sql("ALTER TABLE alarms DROP COLUMN never_raised")
        connection.exec_driver_sql("ALTER TABLE actions DROP COLUMN node")
        connection.execute(sa.update(tables.schema).values(version=3))
    store.close()


def make_version_1(url):
    """A database as version 1 made it, with a run and an alarm."""
    store = open_store(url)
    sink = opened(store, RUN)
    feed(sink, RUN, 2)
    sink.take(make_alarm(RUN))
    with store.write() as connection:
        for table in reversed([*operator_tables.ADDED, tables.jobs]):
            connection.exec_driver_sql(f"DROP TABLE {table.name}")
        connection.exec_driver_sql("ALTER TABLE alarms DROP COLUMN more")
        connection.exec_driver_sql("ALTER TABLE alarms DROP COLUMN never_raised")
        connection.exec_driver_sql("ALTER TABLE runs DROP COLUMN rules")
        connection.exec_driver_sql("ALTER TABLE estimates DROP COLUMN more")
        connection.execute(sa.update(tables.schema).values(version=1))
    store.close()


def columns(store):
    with store.read() as connection:
        found = sa.inspect(connection)
        return {name: {c["name"] for c in found.get_columns(name)} for name in found.get_table_names()}


def test_older_database_is_brought_up_with_all_that_is_in_it(url, tmp_path):
    """Kills a step that forgets a table or a column, and rows of version 1 that cannot be read any more."""
    make_version_1(url)
    stores, failures = [], []

    def attempt():
        try:
            stores.append(open_store(url))
        except Exception as error:  # noqa: BLE001 - reported below
            failures.append(error)

    threads = [threading.Thread(target=attempt) for _ in range(4)]  # API and workers begin at once
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    store = stores[0]
    with store.read() as connection:
        assert connection.execute(sa.select(tables.schema.c.version)).scalars().all() == [tables.SCHEMA_VERSION]
        alarm = queries.alarm(connection, make_alarm(RUN).id)
        assert (alarm["state"], alarm["version"], len(alarm["changes"])) == ("unacknowledged", 0, 1)
        assert of_change(queries.alarm_change(connection, alarm["id"])).facts.active
        assert queries.alarm_rules(queries.current_run(connection, "beam")) == AlarmRules()
        assert (
            queries.nodes(connection, queries.current_run(connection, "beam"), Scope.RUN)[0]["detection"] is None
        )
    assert times(store) == [0, 1]
    fresh = open_store(f"sqlite:///{tmp_path}/fresh.db")
    assert columns(store) == columns(fresh)
    for each in (*stores, fresh):
        each.close()


def test_database_of_version_3_is_brought_up_with_its_alarms_and_actions(url, tmp_path):
    make_version_3(url)
    store, fresh = open_store(url), open_store(f"sqlite:///{tmp_path}/fresh.db")
    assert columns(store) == columns(fresh)
    with store.read() as connection:
        (alarm,) = queries.alarms(connection, queries.AlarmFilter(), None, 10).items
        (asked,) = actions.waiting(connection, "beam", 0)
        assert not queries.alarm_change(connection, alarm["id"]).never_raised
    assert (asked.action.alarm, asked.action.node) == (alarm["id"], "")
    store.close()
    fresh.close()


def test_step_that_fails_leaves_the_older_database_as_it_was(url, monkeypatch):
    make_version_1(url)
    from creak.sinks import migrations

    def failing(connection):
        migrations_step(connection)
        raise sa.exc.OperationalError("ALTER", {}, Exception("disk full"))

    migrations_step = migrations.STEPS[2]
    monkeypatch.setattr(migrations, "STEPS", {2: failing})
    with pytest.raises(StorageError, match="disk full"):
        open_store(url)
    monkeypatch.undo()
    store = open_store(url)
    assert times(store) == [0, 1]
    store.close()


def test_place_of_a_recording_that_is_gone_counts_nothing(store):
    put_recording(store, RecordingEntry("r", "beam", "run-1", str(Path("/nosuch/x")), START, None, "complete", 9))
    assert keep_budget(store, 0) == []
