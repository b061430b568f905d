"""Which realisations and files an alarm stands for: those in which it stood, and no healthy ones."""

import pytest

from creak.records import Limits
from creak.sinks.database import open_store
from creak.sinks.diagnosable import healthy_before, of_alarm, of_recording
from creak.sinks.store import RecordingEntry, put_recording
from store_records import SECOND, START, feed, make_alarm, make_run, opened


@pytest.fixture
def store(tmp_path):
    store = open_store(f"sqlite:///{tmp_path}/creak.db")
    yield store
    store.close()


def filled(store, realisations, parts=4, every=10):
    """A run of which every ten realisations (a second each) lie in a part; the last one is being written."""
    run = make_run(window=2, limits=Limits(windows=3, exceeding=2))
    sink = opened(store, run)
    feed(sink, run, realisations)
    for number in range(parts):
        start, end = (START + number * every * SECOND, START + (number + 1) * every * SECOND)
        last = number == parts - 1
        entry = RecordingEntry(
            f"p{number}", "beam", run.id, f"{number}.mcap", start, None if last else end, "x", 1
        )
        put_recording(store, entry)
    return sink, run


def material(store, alarm):
    with store.read() as connection:
        return of_alarm(connection, alarm.id)


def test_an_alarm_stands_for_the_windows_that_raised_it_and_what_follows(store):
    """Kills a diagnosis that mixes the healthy past with the fault, and one of days of data."""
    sink, run = filled(store, 40)
    alarm = make_alarm(run, since=START + 19 * SECOND)  # at the end of realisation 18
    sink.take(alarm)
    found = material(store, alarm)
    assert (found.rig, found.first, found.last) == ("beam", 17, 28)
    assert found.files == ("1.mcap", "2.mcap")


def test_an_alarm_that_was_cleared_ends_before_the_good_windows(store):
    sink, run = filled(store, 40)
    sink.take(make_alarm(run, since=START + 19 * SECOND))
    cleared = make_alarm(run, since=START + 19 * SECOND, event="cleared", time=START + 26 * SECOND)
    sink.take(cleared)
    found = material(store, cleared)
    # Cleared at the end of realisation 25 by two good windows of two: 23 to 25 were good.
    assert (found.first, found.last, found.files) == (17, 22, ("1.mcap", "2.mcap"))


def test_an_alarm_at_once_in_the_newest_part(store):
    sink, run = filled(store, 32)
    alarm = make_alarm(run, since=START + 32 * SECOND)
    sink.take(alarm)
    found = material(store, alarm)
    assert (found.first, found.last, found.files) == (30, 41, ("3.mcap",))


def test_the_rig_as_it_was_ends_before_the_first_window_that_exceeded(store):
    """Kills a reference that holds some of the fault, and one of days of data."""
    sink, run = filled(store, 40)
    alarm = make_alarm(run, since=START + 19 * SECOND)  # at the end of realisation 18
    sink.take(alarm)
    with store.read() as connection:
        found = healthy_before(connection, alarm.id)
    # Windows of two that ended with 17 and 18 exceeded: 16 is in the first of them, so 15 is the last that is not.
    assert (found.rig, found.first, found.last) == ("beam", 4, 15)
    assert found.files == ("0.mcap", "1.mcap")


def test_an_alarm_at_once_leaves_nothing_healthy(store):
    sink, run = filled(store, 40)
    alarm = make_alarm(run, since=START + 2 * SECOND)
    sink.take(alarm)
    with store.read() as connection:
        assert healthy_before(connection, alarm.id) is None


def test_an_alarm_of_a_run_that_was_not_recorded_has_no_files(store):
    sink, run = filled(store, 5, parts=0)
    alarm = make_alarm(run, since=START + 4 * SECOND)
    sink.take(alarm)
    assert material(store, alarm).files == ()


def test_what_is_not_there(store):
    filled(store, 1)
    with store.read() as connection:
        assert of_alarm(connection, "nosuch") is None
        assert of_recording(connection, "nosuch") is None
        assert of_recording(connection, "p0").files == ("0.mcap",)
