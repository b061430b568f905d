"""Frames to realisations: nothing wrong gets in, nothing is lost without being named."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_frames, make_rig, make_run
from creak.monitor import Monitor
from creak.records import Estimate, Fault, FaultKind, Frame, FrameStatus, Scope


def take_all(run, items):
    monitor = Monitor(run)
    outcomes = [o for item in items for o in monitor.take(item)]
    return monitor, outcomes + monitor.finish()


def run_estimates(outcomes):
    return [o for o in outcomes if isinstance(o, Estimate) and o.scope is Scope.RUN]


def same_estimate(a, b):
    assert a.nodes == b.nodes
    for name in ("signal", "noise", "total", "classical_noise", "classical_total"):
        np.testing.assert_array_equal(getattr(a.spectra, name), getattr(b.spectra, name))


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_order_inside_a_realisation_does_not_change_a_bit(data):
    """Kills an accumulator that sums frames as they arrive."""
    run = make_run(make_rig(2, samples=32, lines=range(2, 6)), steady=2)
    frames = make_frames(run, realisations=3, seed=data.draw(st.integers(0, 99)))
    shuffled = []
    for m in range(3):
        shuffled += data.draw(st.permutations([f for f in frames if f.realisation == m]))
    _, straight = take_all(run, frames)
    monitor, mixed = take_all(run, shuffled)
    same_estimate(run_estimates(straight)[-1], run_estimates(mixed)[-1])
    assert monitor.counts.frames == 3 * 2 * 2
    assert monitor.counts.rejected_frames == 0


FAULTS = ("lose", "double", "nan", "shape", "late", "unplanned", "none")


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_faulty_frames_never_enter_an_estimate_and_are_always_counted(data):
    """Kills a NaN that is averaged in, a doubled frame that counts twice, a rejected frame that nobody names.

    Whatever is done to the frames of some realisations, the estimate is that of the untouched ones alone.
    """
    run = make_run(make_rig(2, samples=32, lines=range(2, 6)), steady=2)
    frames = make_frames(run, realisations=5, seed=data.draw(st.integers(0, 99)))
    touched = data.draw(st.sets(st.integers(0, 4), min_size=1, max_size=3))
    stream, expected = [], Counter()
    spoilt, bad, whole = set(), set(), Counter()
    for frame in frames:
        whole[frame.realisation] += frame.period > 0  # taken back below where the frame does not arrive whole
        if frame.realisation not in touched or frame.period == 0 or not data.draw(st.booleans()):
            stream.append(frame)
            continue
        kind = data.draw(st.sampled_from(FAULTS))
        y = frame.y.copy()
        if kind == "lose":
            spoilt.add(frame.realisation)
        elif kind == "double":
            stream += [frame, frame]
            complete = whole[frame.realisation] == run.rig.q * run.steady_periods and frame.realisation not in bad
            expected[FaultKind.LATE if complete else FaultKind.DOUBLED] += 1
            continue
        elif kind == "nan":
            y[0, 3] = data.draw(st.sampled_from([np.nan, np.inf]))
            stream.append(_with(frame, y=y))
            expected[FaultKind.NOT_FINITE] += 1
            spoilt.add(frame.realisation)
        elif kind == "shape":
            stream.append(_with(frame, y=y[:, :-1]))
            expected[FaultKind.WRONG_SHAPE] += 1
            spoilt.add(frame.realisation)
        elif kind == "late":
            stream += [_with(frame, realisation=frame.realisation - 1)] if frame.realisation else []
            expected[FaultKind.LATE] += 1 if frame.realisation else 0
            spoilt.add(frame.realisation)
        elif kind == "unplanned":
            stream.append(_with(frame, period=17))
            expected[FaultKind.OUT_OF_PLAN] += 1
            spoilt.add(frame.realisation)
        else:
            stream.append(frame)
            continue
        whole[frame.realisation] -= 1
        bad |= {frame.realisation} if kind in ("nan", "shape") else set()
    monitor, outcomes = take_all(run, stream)
    good = [f for f in frames if f.realisation not in spoilt]
    clean, clean_outcomes = take_all(run, good)
    assert monitor.counts.frames == clean.counts.frames
    if run_estimates(clean_outcomes):
        same_estimate(run_estimates(outcomes)[-1], run_estimates(clean_outcomes)[-1])
    judged = [o for o in outcomes if isinstance(o, Frame)]
    assert len(judged) == len(stream)  # every frame leaves, accepted or not
    assert all(o.reason for o in judged if o.status is FrameStatus.REJECTED)
    counted = monitor.counts
    assert counted.frames + counted.rejected_frames + counted.transient_frames == len(stream)
    found = Counter(o.kind for o in outcomes if isinstance(o, Fault))
    assert {k: found[k] for k in expected} == dict(expected)
    for m in spoilt:
        if any(f.realisation == m for f in stream):
            assert any(
                o.kind is FaultKind.INCOMPLETE and o.realisation == m for o in outcomes if isinstance(o, Fault)
            )


def _with(frame, **changes):
    from dataclasses import replace

    return replace(frame, **changes)


def test_a_frame_that_is_sent_again_does_not_heal_its_experiment():
    """Kills a realisation that counts although one of its frames was refused."""
    run = make_run(make_rig(1, samples=32, lines=range(2, 6)), steady=2)
    frames = make_frames(run, realisations=2)
    bad = _with(frames[1], y=np.full_like(frames[1].y, np.nan))
    monitor, _ = take_all(run, [frames[0], bad, *frames[1:]])
    assert monitor.counts.realisations == 1
    assert monitor.counts.frames == 2
    assert monitor.counts.rejected_frames == 3  # the bad one, and the two good ones that went with it


def test_a_singular_input_matrix_is_refused_and_named():
    """Kills an estimate of rounding errors when an input is silent."""
    run = make_run(make_rig(2, samples=32, lines=range(2, 6)), steady=2)
    frames = make_frames(run, realisations=3)
    dead = [_with(f, u=np.vstack((f.u[:1], np.zeros((1, 32))))) if f.realisation == 1 else f for f in frames]
    monitor, outcomes = take_all(run, dead)
    faults = [o for o in outcomes if isinstance(o, Fault)]
    assert [f.kind for f in faults] == [FaultKind.SINGULAR]
    assert "line 2" in faults[0].message
    assert (monitor.counts.realisations, monitor.counts.rejected_frames) == (2, 4)


def test_a_loss_that_the_source_names_leaves_its_experiment_out():
    run = make_run(make_rig(1, samples=32, lines=range(2, 6)), steady=2)
    frames = make_frames(run, realisations=3)
    lost = frames[4]
    fault = Fault(FaultKind.LOST, lost.time, "lost", lost.realisation, lost.experiment, lost.period)
    monitor, outcomes = take_all(run, [*frames[:4], fault, *frames[5:]])
    assert monitor.counts.realisations == 2
    assert monitor.counts.faults == {"incomplete": 1, "lost": 1}
    assert run_estimates(outcomes)[-1].realisations == 2


@pytest.mark.slow
def test_memory_does_not_grow_with_frames():
    """Kills a list that keeps frames, spectra or windows: 10,000 frames, and not one array more at the end."""
    import gc
    import tracemalloc

    rig = make_rig(2, samples=64, lines=range(2, 12), transient=1)
    run = make_run(rig, steady=4)
    block = make_frames(run, realisations=1)
    monitor = Monitor(run)
    per_realisation = len(block)
    levels = []
    tracemalloc.start()
    for m in range(10_000 // per_realisation):
        for frame in block:
            monitor.take(_with(frame, realisation=m))
        if m in (20, 10_000 // per_realisation - 1):
            gc.collect()
            levels.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    # One kept frame of every realisation would be over 2 MB; what is left is the interpreter's own housekeeping.
    assert levels[1] - levels[0] < 50_000
    assert monitor.counts.realisations == 10_000 // per_realisation
