"""When a node alarms."""

import pytest

from conftest import make_frames, make_rig, make_run
from creak import alarms
from creak.monitor import Monitor
from creak.records import AlarmChange, AlarmState, Limits, NodeLevel

RUN = make_run(
    make_rig(1), limits=Limits(total_to_noise_db=3, p_value=1e-3, dead_band_db=1, windows=3, exceeding=2)
)


def level(ratio, p=1e-9):
    return NodeLevel("1", 0, -40, None, None, ratio, -40, None, ratio, p)


def run_through(windows, run=RUN):
    alarm, log = alarms.NodeAlarm(alarms.Alarm(run.rig.name, "1")), []
    for time, (ratio, p) in enumerate(windows):
        alarm, changes = alarms.step(run, alarm, level(ratio, p), time)
        log += changes
    return alarm, log


def events(windows, run=RUN):
    return [(c.time, c.event) for c in run_through(windows, run)[1]]


HIGH, LOW, BAND, LOUD_NOISE = (6.0, 1e-9), (0.1, 0.5), (2.5, 1e-9), (6.0, 0.2)


@pytest.mark.parametrize(
    ("windows", "expected"),
    [
        ([HIGH], []),  # K = 2: one window is not enough
        ([HIGH, LOW, LOW, HIGH], []),  # two of four, but not of three
        ([HIGH, LOW, HIGH], [(2, "raised")]),
        ([HIGH, HIGH, HIGH], [(1, "raised")]),  # raised once
        ([LOUD_NOISE] * 4, []),  # clearance without significance
        ([(2.9, 1e-9)] * 4, []),  # significance without clearance
        ([HIGH, HIGH, BAND, BAND, BAND], [(1, "raised")]),  # inside the dead band it stands
        ([HIGH, HIGH, LOW, LOW], [(1, "raised"), (3, "cleared")]),
        ([HIGH, HIGH, LOW, LOW, HIGH, HIGH], [(1, "raised"), (3, "cleared"), (5, "raised")]),
        ([HIGH, HIGH, (None, None), HIGH], [(1, "raised")]),  # a window without an estimate says nothing
    ],
)
def test_k_of_n_with_dead_band(windows, expected):
    assert events(windows) == expected


def test_an_occurrence_keeps_its_id_and_a_replay_gives_the_same():
    """Kills an id drawn at random, and one that changes when the alarm clears."""
    windows = [HIGH, HIGH, LOW, LOW, HIGH, HIGH]
    first, again = run_through(windows)[1], run_through(windows)[1]
    assert first == again
    assert len({c.id for c in first}) == 1
    assert [c.state for c in first] == [
        AlarmState.UNACKNOWLEDGED,
        AlarmState.RETURNED_UNACKNOWLEDGED,
        AlarmState.UNACKNOWLEDGED,
    ]
    assert [c.active for c in first] == [True, False, True]
    assert {c.since for c in first} == {1}


def test_with_k_below_half_of_n_the_newest_window_decides():
    """Kills a machine that raises and clears in turn because both counts are reached."""
    run = make_run(make_rig(1), limits=Limits(windows=4, exceeding=1))
    assert events([HIGH, LOW, LOW, HIGH], run) == [(0, "raised"), (1, "cleared"), (3, "raised")]


def test_a_spring_that_appears_raises_its_own_node_only_at_recorded_times():
    """The path from frames to alarm: kills a network that spreads distortion to the neighbours."""
    rig = make_rig(3, samples=128, lines=range(2, 40))
    run = make_run(rig, steady=3, window=2, start=10**18)
    monitor = Monitor(run)
    frames = make_frames(run, realisations=8, cubic=4)
    changes = [o for f in frames for o in monitor.take(f) if isinstance(o, AlarmChange)]
    assert [(c.node, c.event) for c in changes] == [("3", "raised")]
    end_of_6 = max(f.time for f in frames if f.realisation == 5) + round(rig.period_ns)
    assert changes[0].time == end_of_6
    assert monitor.alarms == {"1": "normal", "2": "normal", "3": "unacknowledged"}
