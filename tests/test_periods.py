"""Samples with counters to period frames."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_rig, make_run
from creak.periods import PeriodCutter
from creak.records import Fault, FaultKind, Frame

SIZE = 16


def numbered(run, counter, length):
    """Samples that carry their own counter, so that a misplaced one is seen."""
    row = np.arange(counter, counter + length, dtype=float)
    return np.tile(row, (run.rig.q, 1)), np.tile(row, (run.rig.n, 1)) + 0.5


@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_any_blocks_with_gaps_and_repeats_give_exactly_the_whole_periods(data):
    """Kills a period that is cut by arrival, glued over a gap, or lost without a word."""
    run = make_run(make_rig(2, samples=SIZE, lines=(2, 3)), steady=2)
    total = 12 * SIZE
    cutter, out, counter, gone = PeriodCutter(run), [], 0, set()
    while counter < total:
        length = data.draw(st.integers(1, 3 * SIZE))
        event = data.draw(st.sampled_from(["send", "send", "send", "gap", "repeat"]))
        if event == "gap":
            gone |= set(range(counter, min(counter + length, total)))
            counter += length
            continue
        begin = max(0, counter - length // 2) if event == "repeat" else counter
        gone -= set(range(max(begin, cutter.next_counter), counter))
        out += cutter.push(begin, *numbered(run, begin, length))
        counter = max(counter, begin + length)
    frames = [o for o in out if isinstance(o, Frame)]
    closed = cutter.next_counter // SIZE
    damaged = {i // SIZE for i in gone}
    place = {
        (i // run.periods // run.rig.q, i // run.periods % run.rig.q, i % run.periods): i for i in range(closed)
    }
    assert [place[f.realisation, f.experiment, f.period] for f in frames] == [
        i for i in range(closed) if i not in damaged
    ]
    for frame in frames:
        first = place[frame.realisation, frame.experiment, frame.period] * SIZE
        np.testing.assert_array_equal(frame.u[0], np.arange(first, first + SIZE))
        np.testing.assert_array_equal(frame.y[1], np.arange(first, first + SIZE) + 0.5)
        assert frame.time == cutter.time_of(first)
    lost = [
        place.get((o.realisation, o.experiment, o.period))
        for o in out
        if isinstance(o, Fault) and o.kind is FaultKind.LOST
    ]
    named = [i for i in lost if i is not None]
    assert len(named) == len(set(named))  # a period is named once
    assert set(named) == {i for i in damaged if i < closed and _gap_was_seen(i, gone, cutter.next_counter)}


def _gap_was_seen(period, gone, next_counter):
    """A gap is known only when a later sample has come."""
    return min(i for i in gone if i // SIZE == period) < next_counter
