"""Laws of the window: whatever comes and goes, its sum is that of the last R blocks."""

from functools import reduce
from operator import add

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_frames, make_rig, make_run, random_spectra
from creak.detection import LineSums
from creak.judgement import Block
from creak.monitor import Monitor
from creak.records import Estimate, Scope
from creak.statistics import Sums
from creak.window import Window

RIG = make_rig(2, lines=range(2, 6))


def blocks_of(count, seed=0, about=None, noise=1e-2):
    nothing = LineSums.of(np.empty((2, 2, 0, 2), dtype=np.complex128))
    spectra = random_spectra(np.random.default_rng(seed), RIG, count, 2, noise=noise)
    blocks = [Block(Sums.of(s, 2), nothing, nothing) for s in spectra]
    return blocks if about is None else [block.about(about) for block in blocks]


def assert_same(a, b, rtol=1e-10):
    for name in ("S", "spread", "packed_between", "packed_within", "period_sums"):
        x, y = getattr(a.normal(), name), getattr(b.normal(), name)
        np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol * np.abs(y).max(), err_msg=name)


@settings(max_examples=60, deadline=None)
@given(size=st.integers(1, 6), count=st.integers(1, 15), common=st.booleans(), seed=st.integers(0, 999))
def test_the_sum_is_that_of_the_last_blocks(size, count, common, seed):
    """Kills a block that leaves too late or too early, and a sum of the older ones that skips one."""
    about = blocks_of(1, seed)[0].sums.S if common else None
    blocks = blocks_of(count, seed, about)
    window = Window(size)
    for k, block in enumerate(blocks, start=1):
        window.push(block)
        last = blocks[max(0, k - size) : k]
        assert list(window.blocks) == last
        assert_same(window.total.sums, reduce(add, last).sums)
        assert window.total.sums.realisations == min(size, k)


@pytest.mark.parametrize("at", range(1, 9))
def test_what_residuals_are_taken_about_changes_nothing(at):
    """Kills a change of reference that forgets the older or the recent blocks."""
    blocks = blocks_of(9, about=blocks_of(1)[0].sums.S)
    other = blocks_of(1, seed=5)[0].sums.S
    window = Window(4)
    for block in blocks[:at]:
        window.push(block)
    window.refer(other)
    for block in blocks[at:]:
        window.push(block.about(other))
    assert_same(window.total.sums, reduce(add, blocks[-4:]).sums)


@pytest.mark.parametrize("cut", range(1, 10))
def test_a_window_that_is_taken_up_again_goes_on_to_the_last_bit(cut):
    """Kills a window that a restart sums up in another order."""
    blocks = blocks_of(10, about=blocks_of(1)[0].sums.S)
    one = Window(4)
    for block in blocks[:cut]:
        one.push(block)
    other = Window(4, tuple(one.blocks), one.older)
    for block in blocks[cut:]:
        one.push(block)
        other.push(block)
        np.testing.assert_array_equal(one.total.sums.packed_within, other.total.sums.packed_within)
        np.testing.assert_array_equal(one.total.sums.S, other.total.sums.S)


def test_an_empty_window_has_no_sum():
    with pytest.raises(ValueError, match="empty window"):
        _ = Window(3).total


def test_the_estimates_stay_exact_when_the_structure_becomes_another():
    """Kills a reference that is kept when it no longer fits: at 120 dB that would cost the levels 1e-4."""
    rig = make_rig(2)
    run = make_run(rig, window=3)
    before, after = (make_frames(run, 12, seed=seed, noise=1e-6) for seed in (0, 1))
    each = rig.q * run.periods
    monitor, fresh = Monitor(run), Monitor(run)  # the fresh one has never seen the structure as it was

    def windows(one, frames):
        estimates = [o for frame in frames for o in one.take(frame) if isinstance(o, Estimate)]
        return [estimate for estimate in estimates if estimate.scope is Scope.WINDOW]

    got = windows(monitor, before[: 4 * each] + after[4 * each :])[-1]
    want = windows(fresh, after[9 * each :])[-1]
    for name in ("total", "noise", "classical_total", "classical_noise"):
        np.testing.assert_allclose(getattr(got.spectra, name), getattr(want.spectra, name), rtol=1e-7)
