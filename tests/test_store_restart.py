"""What the API shows after a restart is what the monitor goes on with."""

from dataclasses import replace

from conftest import make_frames, make_rig
from conftest import make_run as make_real_run
from creak.alarm_records import Action, ActionKind
from creak.codec import memory_bytes
from creak.monitor import Monitor
from creak.records import AlarmChange, Scope
from creak.sinks import queries
from creak.sinks.store import StoreSink, open_store
from store_records import START, opened


def states(store):
    with store.read() as connection:
        row = queries.current_run(connection, "beam")
        return [node["alarm"] for node in queries.nodes(connection, row, Scope.WINDOW)]


def test_an_alarm_that_stands_is_shown_after_a_restart_and_not_where_nothing_is_remembered(tmp_path):
    """Kills a page that says 'normal' until the next change of an alarm that an operator has acknowledged."""
    store = open_store(f"sqlite:///{tmp_path / 'creak.db'}")
    run = make_real_run(make_rig(name="beam"), start=START, run_id="first")
    monitor, sink = Monitor(run), opened(store, run)
    for frame in make_frames(run, 10, cubic=3, noise=1e-3):
        for outcome in monitor.take(frame):
            sink.take(outcome)
            if isinstance(outcome, AlarmChange) and outcome.event == "raised" and outcome.class_ == "process":
                for change in monitor.act(Action(outcome.id, ActionKind.ACKNOWLEDGE, "ada")):
                    sink.take(change)
    assert states(store) == ["normal", "normal", "acknowledged"]
    later = replace(run, id="second", start=monitor.time, before=memory_bytes(monitor.memory))
    StoreSink(store).open(later)
    assert states(store) == ["normal", "normal", "acknowledged"]
    StoreSink(store).open(replace(run, id="third", start=monitor.time))
    assert states(store) == ["normal", "normal", "normal"]
    with store.read() as connection:
        assert len(queries.alarms(connection, queries.AlarmFilter(), None, 10).items) == 1
    store.close()
