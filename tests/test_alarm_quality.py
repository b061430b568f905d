"""Alarms about the data: raised by poor data, at recorded times, and never in the way of a process alarm."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import make_frames, make_rig, make_run
from creak.alarm_records import Action, ActionKind, AlarmRules, Clock, Conflict
from creak.codec import memory_bytes, memory_of
from creak.errors import InputError
from creak.monitor import Monitor
from creak.records import AlarmChange, Fault, FaultKind, Frame

START = 10**18
RIG = make_rig(2, samples=128, lines=range(2, 40))
PERIOD = round(RIG.period_ns)  # 2 s
RUN = make_run(RIG, steady=2, window=2, start=START)
LONG = 6 * PERIOD  # a realisation: two experiments of three periods


def changes_of(monitor, items):
    return [o for item in items for o in monitor.take(item) if isinstance(o, AlarmChange)]


def told(changes):
    return [(c.class_, c.condition, c.node, c.event) for c in changes]


def late(frames, index, gap):
    """The same frames, those from an index on later by a gap."""
    return [replace(f, time=f.time + (gap if i >= index else 0)) for i, f in enumerate(frames)]


def test_good_data_raise_nothing():
    """Kills a start-up, a window that fills or noise that counts as poor data."""
    assert changes_of(Monitor(RUN), make_frames(RUN, 12)) == []


def test_silence_is_raised_when_it_is_due_and_ends_with_the_next_frame():
    frames = late(make_frames(RUN, 6), 12, 100 * 10**9)
    changes = [c for c in changes_of(Monitor(RUN), frames) if c.condition == "silence"]
    end = START + 12 * PERIOD
    assert [(c.event, c.time) for c in changes] == [
        ("raised", end + 10 * PERIOD),
        ("cleared", end + 100 * 10**9),
    ]
    assert changes[0].node == ""
    assert np.isnan(changes[0].level_db)


@pytest.mark.parametrize("grain", [None, 1, 7])
def test_how_often_the_clock_is_read_changes_nothing(grain):
    """Kills a silence that is raised when somebody looks: a replay would have it at another time."""
    frames = late(make_frames(RUN, 6), 12, 100 * 10**9)
    items = list(frames)
    if grain is not None:
        end = START + 12 * PERIOD
        items[12:12] = [Clock(end + s * 10**9) for s in range(1, 100, grain)]
    assert changes_of(Monitor(RUN), items) == changes_of(Monitor(RUN), frames)


def test_lost_frames_are_an_alarm_when_realisation_after_realisation_falls_out():
    frames = [f for f in make_frames(RUN, 9) if not (f.realisation in {2, 3, 5, 6} and f.period == 2)]
    changes = changes_of(Monitor(RUN), frames)
    lost = [c for c in changes if c.condition == "lost_frames"]
    assert [c.event for c in lost] == ["raised", "cleared"]
    assert lost[0].time <= START + 4 * LONG


def test_an_estimate_that_nothing_renews_is_stale():
    frames = [f for f in make_frames(RUN, 12) if not (3 <= f.realisation < 9 and f.period == 2)]
    stale = [c for c in changes_of(Monitor(RUN), frames) if c.condition == "stale_estimate"]
    assert [(c.event, c.time) for c in stale] == [
        ("raised", START + 3 * LONG + 4 * LONG),
        ("cleared", START + 10 * LONG),
    ]


def test_too_few_realisations_for_a_test():
    run = replace(RUN, window=1)
    assert ("quality", "too_few_realisations", "", "raised") in told(changes_of(Monitor(run), make_frames(run, 3)))


def test_a_clipped_sensor_is_named_and_only_that():
    frames = make_frames(RUN, 6)
    limit = 0.25 * max(np.abs(f.y[1]).max() for f in frames)
    for f in frames:
        if 2 <= f.realisation < 4:
            np.clip(f.y[1], -limit, limit, out=f.y[1])
    found = [c for c in changes_of(Monitor(RUN), frames) if c.condition == "clipped_sensor"]
    assert [(c.node, c.event) for c in found] == [("2", "raised"), ("2", "cleared")]
    assert found[1].time == START + 5 * LONG


def test_a_sensor_that_does_not_move_is_the_same_alarm_and_a_coarse_converter_is_none():
    """Kills a second detector beside the one that names faults."""
    frames = make_frames(RUN, 4)
    for f in frames:
        np.round(f.y[0] * 20, out=f.y[0])
        if f.realisation == 2:
            f.y[1] = 0.25
    monitor = Monitor(RUN)
    found = [c for c in changes_of(monitor, frames) if c.condition == "clipped_sensor"]
    assert [(c.node, c.event, c.time) for c in found] == [
        ("2", "raised", START + 3 * LONG),
        ("2", "cleared", START + 4 * LONG),
    ]
    assert monitor.counts.faults == {"stuck": 1}


def test_a_transient_that_still_settles_is_an_alarm_of_the_nodes_that_have_it():
    """Two of three realisations raise it. Kills one that suffices, and a node that has another's alarm."""
    frames = make_frames(RUN, 9, noise=1e-2)
    t = np.arange(128) / 128
    for f in frames:
        if f.realisation in {1, 4, 5}:
            since = f.period + t
            f.y[1] += np.exp(-since) * np.sin(2 * np.pi * 11.3 * since + f.experiment)
    monitor = Monitor(RUN)
    found = [c for c in changes_of(monitor, frames) if c.class_ == "quality"]
    assert [(c.condition, c.node, c.event, c.time) for c in found] == [
        ("transient_not_settled", "2", "raised", START + 6 * LONG),
        ("transient_not_settled", "2", "cleared", START + 8 * LONG),
    ]
    assert monitor.counts.faults == {"transient": 3}


def test_poor_data_neither_hide_nor_acknowledge_a_process_alarm():
    """Kills one state shared by both classes."""
    frames = make_frames(RUN, 12, cubic=3)
    clean = [c for c in changes_of(Monitor(RUN), frames) if c.class_ == "process"]
    poor = late(frames, 60, 200 * 10**9)
    monitor = Monitor(RUN)
    changes = changes_of(monitor, poor)
    assert {"silence", "stale_estimate"} <= {c.condition for c in changes}
    process = [c for c in changes if c.class_ == "process"]
    assert [(c.id, c.event, c.state) for c in process] == [(c.id, c.event, c.state) for c in clean]
    assert monitor.alarms["2"] == "unacknowledged"


# -- operators and restarts, through the monitor


def test_an_operator_acts_at_the_recorded_time_and_on_the_occurrence_only():
    monitor = Monitor(RUN)
    raised = next(c for c in changes_of(monitor, make_frames(RUN, 8, cubic=2)) if c.class_ == "process")
    (change,) = monitor.act(Action(raised.id, ActionKind.ACKNOWLEDGE, "ada", "seen"))
    assert (change.id, change.time, change.by) == (raised.id, START + 8 * LONG, "ada")
    assert monitor.act(Action(raised.id, ActionKind.ACKNOWLEDGE, "bob")) == ()
    other = monitor.act(Action("of another time", ActionKind.ACKNOWLEDGE, "ada"))
    assert isinstance(other, Conflict)


def test_a_frame_of_a_wrong_time_does_not_move_the_clock():
    """Kills a monitor whose shelvings all end because one frame claims to come from the year 2262."""
    monitor = Monitor(RUN)
    frames = make_frames(RUN, 2)
    changes_of(monitor, frames)
    before = monitor.time
    monitor.take(Frame(10**6, 99, 0, 2**62, frames[0].u, frames[0].y))
    monitor.take(Fault(FaultKind.LOST, before, "gone"))
    assert monitor.time == before


@pytest.mark.parametrize("cut", [1, 10, 23, 24, 25, 30])
def test_a_monitor_that_was_restarted_goes_on_as_if_it_had_not_been(cut):
    """Delays that run, occurrences, shelving, baselines and the window survive the bytes of a restart."""
    rules = AlarmRules(on_delay_s=15.0, realarm_s=40.0)
    run = replace(RUN, alarms=rules, baseline=replace(RUN.baseline, realisations=8))
    frames = make_frames(run, 36, cubic=22)
    per = len(frames) // 36

    def operate(monitor, done):
        for change in [c for c in done if c.event == "raised"]:
            kind = ActionKind.SHELVE if change.condition.startswith("level") else ActionKind.ACKNOWLEDGE
            done += monitor.act(Action(change.id, kind, "ada", until=monitor.time + 2 * LONG))
        return done

    def live(monitor, first, last):
        done = []
        for m in range(first, last):
            done += operate(monitor, changes_of(monitor, frames[m * per : (m + 1) * per]))
        return done

    expected = live(Monitor(run), 0, 36)
    first = Monitor(run)
    before = live(first, 0, cut)
    second = Monitor(run, memory_of(memory_bytes(first.memory)))
    assert second.baselines == first.baselines
    assert before + live(second, cut, 36) == expected
    assert {"raised", "shelved", "shelving_expired"} <= {c.event for c in expected}


def test_memory_that_is_none_is_refused():
    for data in (b"", b"PK\x03\x04", memory_bytes(Monitor(RUN).memory)[:-40]):
        with pytest.raises(InputError, match="state"):
            memory_of(data)
