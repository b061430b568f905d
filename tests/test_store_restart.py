"""What the API shows after a restart is what the monitor goes on with."""

from dataclasses import replace

from conftest import make_frames, make_rig
from conftest import make_run as make_real_run
from creak.alarm_records import Action, ActionKind, AlarmState
from creak.alarms import Alarm, NodeAlarm
from creak.alarms.table import Facts
from creak.codec import memory_bytes, time_json
from creak.monitor import Monitor
from creak.records import AlarmChange, Scope
from creak.sinks import queries
from creak.sinks.restart import recorded_until
from creak.sinks.service_alarms import raise_alarm
from creak.sinks.store import StoreSink
from store_records import SECOND, START, feed, make_alarm, make_frame, make_run, opened


def states(store):
    with store.read() as connection:
        row = queries.current_run(connection, "beam")
        return [node["alarm"] for node in queries.nodes(connection, row, Scope.WINDOW)]


def test_an_alarm_that_stands_is_shown_after_a_restart_and_not_where_nothing_is_remembered(store):
    """Kills a page that says 'normal' until the next change of an alarm that an operator has acknowledged."""
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
        (alarm,) = queries.alarms(connection, queries.AlarmFilter(), None, 10).items
        changes = queries.alarm(connection, alarm["id"])["changes"]
    assert [change["event"] for change in changes] == ["raised", "acknowledged", "ended"]
    assert (alarm["state"], alarm["active"], alarm["by"]) == ("normal", False, "")


def test_what_the_new_run_does_not_know_ends_journalled_and_what_nobody_saw_waits_for_its_acknowledgement(store):
    """Kills an alarm that stands for ever because whoever would clear it has gone."""
    first, rig = make_run("first"), make_rig(name="beam")
    sink = opened(store, first)
    hidden = {"state": AlarmState.SHELVED, "shelved": True, "shelved_until": START + 99 * SECOND}
    seen = {"state": AlarmState.ACKNOWLEDGED, "acknowledged": True}
    sink.take(make_alarm(first, "1", **seen))
    sink.take(make_alarm(first, "2", **hidden))
    sink.take(make_alarm(first, "3"))
    sink.take(make_alarm(first, "", number=1, class_="quality", condition="silence"))
    with store.write() as connection:
        raise_alarm(connection, "beam", "", "storage", START, reason="disk full", guidance="make room")
    opened(store, make_run("other", name="bench")).take(make_alarm(make_run("other", name="bench")))
    feed(sink, first, 3)
    alarm = replace(Alarm("beam", "3"), id="first/3/0", facts=Facts(active=True), standing="alarm")
    memory = replace(Monitor(first).memory, nodes=(NodeAlarm(alarm),))
    smaller = replace(rig, nodes=rig.nodes[1:], network=None)
    for run_id, known in (("second", rig), ("third", smaller)):
        StoreSink(store).open(make_run(run_id, rig=known, before=memory_bytes(memory)))
    with store.read() as connection:
        found = queries.alarms(connection, queries.AlarmFilter(), None, 10).items
        journals = {a["id"]: [c["event"] for c in queries.alarm(connection, a["id"])["changes"]] for a in found}
    states = {(a["rig"], a["node"], a["condition"]): (a["state"], a["active"], a["shelved"]) for a in found}
    assert states == {
        ("beam", "1", ""): ("normal", False, False),
        ("beam", "2", ""): ("returned_unacknowledged", False, False),
        ("beam", "3", ""): ("unacknowledged", True, False),
        ("beam", "", "silence"): ("returned_unacknowledged", False, False),
        ("beam", "", "storage"): ("unacknowledged", True, False),
        ("bench", "3", ""): ("unacknowledged", True, False),
    }
    assert journals["first/2/0"] == ["raised", "ended"]
    assert journals["first/3/0"] == ["raised"]
    ended = next(a for a in found if a["id"] == "first/1/0")
    assert ended["time"] == time_json(START + 3 * SECOND)  # the last that its run saw
    assert ended["comment"]


def test_recorded_time_goes_on_where_it_was_to_the_nanosecond(store):
    """Kills a sum of floats, which tell nanoseconds since 1970 to some 256 of them."""
    run = make_run()
    sink = opened(store, run)
    sink.take(replace(make_frame(run, 0), time=START + 1))
    sink.flush()
    assert recorded_until(store, "beam") == START + 1 + SECOND  # a period of the rig
