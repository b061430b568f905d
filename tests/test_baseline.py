"""A node's own baseline: an unchanged machine stays silent, a changed one does not; states are kept apart."""

from dataclasses import replace

import numpy as np
import pytest

from conftest import make_rig, make_run
from creak import baseline
from creak.alarm_records import Action, ActionKind, BaselineRules, Limits, Verdict
from creak.baseline import Baseline
from creak.monitor import Monitor
from creak.records import AlarmChange, NodeLevel
from drifting import drifting_frames

RIG = make_rig(2, samples=128, lines=range(2, 42), transient=0)
RUN = replace(
    make_run(RIG, window=4, limits=Limits(total_to_noise_db=12.0, false_alarms_per_year=1.0)),
    baseline=BaselineRules(realisations=80, change_db=3.0),
)


def watch(frames, run=RUN, monitor=None):
    monitor = monitor or Monitor(run)
    return monitor, [o for f in frames for o in monitor.take(f) if isinstance(o, AlarmChange)]


def level(total, noise, name="1"):
    return NodeLevel(name, 0, 10 * np.log10(noise), 10 * np.log10(total), None, 0.0, None, None, None, 0.5)


def test_the_level_is_proportional_where_it_is_small_and_a_logarithm_where_it_is_large():
    assert baseline.level_db(level(1.0, 1.0), 1.0) == 0.0
    assert baseline.level_db(level(1.01, 1.0), 1.0) == pytest.approx(10 / np.log(10) * 0.01, rel=0.01)
    ten = baseline.level_db(level(1001.0, 1.0), 1.0) - baseline.level_db(level(101.0, 1.0), 1.0)
    assert ten == pytest.approx(10.0, abs=0.1)
    assert baseline.level_db(level(0.5, 9.0), 1.0) == -10.0  # noise that swells is finite, not minus infinity


def test_an_unchanged_machine_that_is_a_little_nonlinear_stays_silent():
    """Distortion twice the noise (7 dB) from the beginning: kills a limit that is the same for every machine."""
    monitor, changes = watch(drifting_frames(RUN, 160, lambda _m: 2.0))
    assert changes == []
    worse = next(b for b in monitor.baselines if b.node == "2")
    assert worse.complete
    assert 5.0 < worse.mean_db < 10 * np.log10(1 + 2.0**2)  # the fit takes its share of the distortion


def test_a_machine_that_changes_by_less_than_the_absolute_limit_alarms():
    monitor, changes = watch(drifting_frames(RUN, 160, lambda m: 1.0 if m < 120 else 3.0))
    worse = [c for c in changes if c.node == "2"]
    assert changes == worse
    assert {"raised"} <= {c.event for c in worse}
    assert "baseline" in worse[-1].condition
    assert worse[-1].severity == "alarm"
    assert worse[0].time <= RUN.start + 128 * 4 * RIG.period_ns
    assert monitor.alarms["1"] == "normal"


def test_more_noise_is_no_change_of_the_machine():
    """Kills a baseline of the ratio, or of the total: the sensor's noise would alarm or hide an alarm."""
    noisy = drifting_frames(RUN, 160, lambda _m: 2.0, noise=lambda m: 1e-2 if m < 120 else 1.4e-2)
    assert watch(noisy)[1] == []


def test_slow_growth_is_a_warning_long_before_it_is_an_alarm():
    """Half a decibel in ten realisations: kills a reference that follows the wear."""
    growth = drifting_frames(RUN, 400, lambda m: 1.0 * 10 ** (0.05 * max(m - 100, 0) / 20))
    changes = [c for c in watch(growth)[1] if c.node == "2"]
    assert (changes[0].event, changes[0].severity, changes[0].condition) == ("raised", "warning", "trend")
    escalated = [c for c in changes if c.event == "escalated"]
    assert escalated
    assert escalated[0].time - changes[0].time > 40 * 4 * RIG.period_ns
    assert [c.event for c in changes if c.event == "cleared"] == []


def test_every_operating_state_has_its_own_baseline_and_a_window_of_two_has_none():
    """Kills one baseline for all: half the excitation would read as health, or the double as damage."""

    def rms(m):
        return 1.0 if (m // 40) % 2 == 0 else 2.0

    frames = drifting_frames(RUN, 240, lambda m: 1.0 if rms(m) == 1.0 else 4.0, rms=rms)
    run = replace(RUN, limits=replace(RUN.limits, total_to_noise_db=30.0))
    monitor, changes = watch(frames, run)
    assert changes == []
    states = sorted((b.state_rms, b.mean_db) for b in monitor.baselines if b.node == "2")
    assert [round(s, 2) for s, _ in states] == [1.0, 2.0]
    assert states[1][1] - states[0][1] > 8.0


def test_nothing_is_learnt_while_an_alarm_stands():
    """Kills a baseline learnt from a broken machine."""
    run = replace(RUN, limits=replace(RUN.limits, total_to_noise_db=3.0))
    monitor, changes = watch(drifting_frames(run, 80, lambda _m: 3.0), run)
    assert [c.event for c in changes] == ["raised"]
    assert [(b.node, b.complete) for b in sorted(monitor.baselines, key=lambda b: b.node)] == [
        ("1", True),
        ("2", False),
    ]


def learnt(values, **more):
    state = Baseline("1", 1.0, 1.0, **more)
    for value in values:
        state = baseline._learn(RUN, state, value, 7)
    return state


def test_a_machine_that_was_changed_on_purpose_gets_a_new_baseline_and_the_old_one_holds_until_then():
    """Kills a replacement that leaves the node unwatched, or that never comes because the old alarm stands."""
    run = replace(RUN, baseline=replace(RUN.baseline, realisations=40), limits=replace(RUN.limits, p_value=1e-4))
    run = replace(run, limits=replace(run.limits, false_alarms_per_year=None))
    frames = list(drifting_frames(run, 240, lambda m: 1.0 if m < 80 else 3.0))
    monitor, changes = watch(frames[: 120 * 4], run)
    standing = changes[-1]
    assert "baseline" in standing.condition
    (told,) = monitor.act(Action(standing.id, ActionKind.RELEARN, "ada", "new bearing"))
    assert (told.event, told.by, told.state) == ("relearning", "ada", "unacknowledged")
    _, during = watch(frames[120 * 4 : 150 * 4], run, monitor)
    assert during == []
    old = next(b for b in monitor.baselines if b.node == "2")
    assert old.complete
    assert old.successor is not None
    _, after = watch(frames[150 * 4 :], run, monitor)
    assert after[-1].event == "cleared"
    new = next(b for b in monitor.baselines if b.node == "2")
    assert new.mean_db > old.mean_db + 3.0
    assert monitor.alarms["2"] == "returned_unacknowledged"


def test_what_is_being_learnt_anew_goes_on_after_a_restart():
    """Kills a successor that waits for realisations as late as the earlier run had come to."""
    run = replace(RUN, baseline=replace(RUN.baseline, realisations=40))
    frames = list(drifting_frames(run, 68, lambda _m: 1.0))
    monitor, _ = watch(frames[: 60 * 4], run)
    monitor.act(Action("", ActionKind.RELEARN, "ada", "new bearing", node="2"))
    asked = monitor.time
    watch(frames[60 * 4 :], run, monitor)
    after = replace(run, id="after", start=monitor.time)
    again, _ = watch(drifting_frames(after, 60, lambda _m: 1.0), after, Monitor(after, monitor.memory))
    new = next(b for b in again.baselines if b.node == "2")
    assert (new.complete, new.successor) == (True, None)
    assert new.since > asked


def test_windows_learnt_from_share_no_data_also_where_realisations_are_lost():
    """Kills counting by the index of realisations: with every other one lost, windows would overlap by half."""
    run = replace(RUN, baseline=replace(RUN.baseline, realisations=400))
    whole = [
        f
        for f in drifting_frames(run, 40, lambda _m: 1.0)
        if f.realisation % 2 or (f.experiment, f.period) != (0, 0)
    ]
    monitor, _ = watch(whole, run)
    assert monitor.counts.realisations == 20
    assert [b.reference.count for b in monitor.baselines] == [5, 5]


def test_what_counts_as_significant_is_the_prediction_interval(rng):
    """Of healthy windows against baselines of 8, 5 % lie above the 5 % limit: 4000 trials, 4 standard errors."""
    run = replace(RUN, limits=Limits(p_value=0.05, dead_band_db=0.0), baseline=BaselineRules(32, change_db=-100.0))
    hits = 0
    for _ in range(4000):
        values = rng.standard_normal(9)
        state = replace(learnt(values[:8]), complete=True)
        hits += baseline.judge(run, state, values[8]) is Verdict.EXCEEDS
    assert abs(hits / 4000 - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 4000)


def test_acknowledging_does_not_stop_the_trend():
    growth = drifting_frames(RUN, 400, lambda m: 1.0 * 10 ** (0.05 * max(m - 100, 0) / 20))
    monitor, changes = Monitor(RUN), []
    for frame in growth:
        for change in [o for o in monitor.take(frame) if isinstance(o, AlarmChange)]:
            changes.append(change)
            if change.event == "raised":
                changes += monitor.act(Action(change.id, ActionKind.ACKNOWLEDGE, "ada"))
    assert [c.event for c in changes][:3] == ["raised", "acknowledged", "escalated"]
