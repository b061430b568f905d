"""Where counted samples belong: wrapping counters, markers, restarts, wild values; no bus, no clock."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_rig, make_run
from creak.counters import Counting, Placed, Resumed, Tracker, Waiting

N = 16
RUN = make_run(make_rig(2, samples=N, lines=(2, 3)), steady=2)  # 2 experiments of 3 periods a realisation
LENGTH = 96


def said_by(places, wraps, first=0):
    """Counter and markers that a controller gives samples."""
    places = np.asarray(places)
    m, rest = np.divmod(places, LENGTH)
    c, rest = np.divmod(rest, 3 * N)
    return (places + first) % wraps, np.stack([m % 8, c, rest // N], axis=1)


def follow(tracker, counts, markers, times, size):
    """Place rows in chunks, waiting rows again with the next; the believed places by row, and what was said."""
    places, said, held = np.full(len(counts), -1), [], 0
    for end in [*range(size, len(counts), size), len(counts)]:
        base = held
        held = end
        for step in tracker.place(counts[base:end], markers[base:end], times[base:end]):
            if isinstance(step, Placed):
                rows = np.arange(step.begin, step.end)[step.believed]
                places[base + rows] = step.first[step.believed]
            elif isinstance(step, Resumed):
                said.append(step.message)
            elif isinstance(step, Waiting):
                held = base + step.row
    return places, said


@settings(max_examples=60, deadline=None)
@given(
    wraps=st.sampled_from([N, 3 * N, 2**16]),
    size=st.integers(1, 40),
    begin=st.integers(0, 3 * LENGTH),
    wild=st.sets(st.integers(10, 200), max_size=5),
    data=st.data(),
)
def test_any_counter_any_begin_any_wild_frame(wraps, size, begin, wild, data):
    """Kills a place that depends on how frames were batched, on a wrap, or on a frame that nobody confirms."""
    true = begin + np.arange(240)
    counts, markers = said_by(true, wraps)
    for row in wild:
        counts[row] = data.draw(st.integers(0, wraps - 1))
        markers[row] = data.draw(st.tuples(st.integers(0, 7), st.integers(0, 15), st.integers(0, 15)))
    times = np.rint(np.arange(240) * 1e9 / 64).astype(np.int64) + 10**18
    places, said = follow(Tracker(RUN, Counting(wraps, (8, 16, 16))), counts, markers, times, size)
    kept = np.ones(240, dtype=bool)
    kept[list(wild)] = False
    offset = (begin // LENGTH // 8) * 8 * LENGTH  # the marker of realisations has 8 values
    np.testing.assert_array_equal(places[kept], true[kept] - offset)
    assert said == []


def test_a_restart_goes_on_with_a_new_realisation_and_long_silence_too():
    """Kills a realisation that is joined over a restart, or over a silence in which the markers came round."""
    tracker = Tracker(RUN, Counting(2**16, (8, 16, 16)))
    first, again, late = np.arange(200), np.arange(60), 60 + np.arange(60)
    told = [said_by(places, 2**16) for places in (first, again, late)]
    counts, markers = (np.concatenate([t[i] for t in told]) for i in (0, 1))
    times = np.arange(320, dtype=np.int64) * round(1e9 / 64) + 10**18
    times[260:] += 10**9 * 3600
    places, said = follow(tracker, counts, markers, times, 50)
    np.testing.assert_array_equal(places[:200], first)
    np.testing.assert_array_equal(places[200:260], 3 * LENGTH + again)
    np.testing.assert_array_equal(places[260:], 4 * LENGTH + late)
    assert [line.split(":")[0] for line in said] == [
        "the controller began again",
        "after 3600.0 s the place could not be told",
    ]


def test_what_a_counter_must_be():
    assert "too short" in Counting(N - 1).problem(RUN)
    assert "name markers" in Counting(2**16).problem(RUN)
    assert "no whole number of periods" in Counting(100, (8, 2, 3)).problem(RUN)
    assert "too few for 2" in Counting(N, (8, 1, 3)).problem(RUN)
    assert Counting(LENGTH * 10).problem(RUN) == ""
    assert Counting(2**32).problem(RUN) == ""  # 64 Hz: it outlives any run
