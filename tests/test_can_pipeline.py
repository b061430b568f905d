"""CAN frames to period frames: exactly or not at all."""

import numpy as np
import pytest

import can_rigs
from conftest import make_frames, make_rig, make_run
from creak.records import Fault, FaultKind, Frame
from creak.sources.can_controller import Controller, Disturbances, DisturbedWay, played, quantised
from creak.sources.can_frames import CanFrames
from creak.sources.can_pipeline import CanPipeline

N = 32


def plan(realisations=3, n=2, start=1_790_000_000_000_000_000):
    run = make_run(make_rig(n, samples=N, lines=range(2, 10)), steady=2, start=start)
    return run, make_frames(run, realisations)


def through(pipeline, batches):
    out = [item for batch in batches for item in pipeline.push(batch)]
    return out + list(pipeline.finish())


def same_frames(found, expected):
    place = [(f.realisation, f.experiment, f.period) for f in expected]
    assert [(f.realisation, f.experiment, f.period) for f in found] == place
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one.u, other.u)
        np.testing.assert_array_equal(one.y, other.y)
        assert abs(one.time - other.time) < 1000


@pytest.mark.parametrize("layout", can_rigs.LAYOUTS)
@pytest.mark.parametrize("size", [1, 7, 10_000])
def test_every_layout_gives_the_samples_that_were_sent(layout, size, tmp_path):
    """Kills a sample of another message, rate, multiplexer value or byte order that lands at a wrong place."""
    run, frames = plan()
    text, signals = can_rigs.LAYOUTS[layout]
    mapping = can_rigs.mapping(tmp_path, run, text(2), signals)
    controller = Controller(run, mapping)
    sent = CanFrames.none()
    for index, frame in enumerate(frames):
        sent = sent + controller.frames(frame, index)
    out = through(CanPipeline(run, mapping), [sent[i : i + size] for i in range(0, len(sent), size)])
    same_frames([o for o in out if isinstance(o, Frame)], [quantised(f, mapping) for f in frames])
    assert [o for o in out if isinstance(o, Fault)] == []


def test_a_counter_that_wraps_goes_on(tmp_path):
    """Kills a place that is told from a counter without its markers, and a reorder window at the wrap."""
    run, frames = plan(4)
    mapping = can_rigs.mapping(tmp_path, run, can_rigs.one_frame(2, counter_bits=8))
    controller = Controller(run, mapping, first_counter=192)
    way = DisturbedWay(Disturbances(reordered=0.2, delayed=0.1, delay=3 / 64), seed=3)
    batches = [sent for _, sent, _ in played(frames, controller, way)] + [way.rest()]
    out = through(CanPipeline(run, mapping), batches)
    same_frames([o for o in out if isinstance(o, Frame)], [quantised(f, mapping) for f in frames])
    assert way.injected["reordered"] > 10


@pytest.mark.parametrize("bits", [62, 63, 64])
@pytest.mark.parametrize("begin", ["at 0", "before its end"])
def test_a_counter_may_have_64_bits(bits, begin, tmp_path):
    """Kills sums beyond 64 bits, which end the source or place a sample anywhere."""
    run, frames = plan(4)
    mapping = can_rigs.mapping(tmp_path, run, can_rigs.one_frame(2, counter_bits=bits, crc=0))
    controller = Controller(run, mapping)
    batches = [controller.frames(frame, index) for index, frame in enumerate(frames)]
    if begin != "at 0":
        for sent in batches:
            words = sent.data[:, :8].copy().view("<u8")
            words += np.uint64((1 << bits) - 5 * N)
            words &= np.uint64((1 << bits) - 1)
            markers = sent.data[:, 7] & np.uint8(0xFF << (bits - 56) & 0xFF)  # share the last byte
            sent.data[:, :8] = words.view(np.uint8)
            sent.data[:, 7] |= markers
    out = through(CanPipeline(run, mapping), batches)
    same_frames([o for o in out if isinstance(o, Frame)], [quantised(f, mapping) for f in frames])


def test_a_lost_frame_is_named_with_its_counters_and_costs_its_period_alone(tmp_path):
    run, frames = plan()
    mapping = can_rigs.mapping(tmp_path, run, can_rigs.one_frame(2))
    controller = Controller(run, mapping)
    sent = CanFrames.none()
    for index, frame in enumerate(frames):
        sent = sent + controller.frames(frame, index)
    lost = 5 * (N // 4) + 3  # the fourth frame of the period with index 5
    out = through(CanPipeline(run, mapping), [sent[:lost] + sent[lost + 1 :]])
    same_frames(
        [o for o in out if isinstance(o, Frame)], [quantised(f, mapping) for i, f in enumerate(frames) if i != 5]
    )
    (fault,) = [o for o in out if isinstance(o, Fault)]
    assert fault.kind is FaultKind.LOST
    assert (fault.realisation, fault.experiment, fault.period) == (0, 1, 2)
    assert "samples 172 to 175 of Samples never came" in fault.message


def test_a_controller_that_begins_again_starts_a_new_realisation(tmp_path):
    """Kills a realisation glued together from before and after a restart, and one that is late ever after."""
    run, frames = plan(3)
    mapping = can_rigs.mapping(tmp_path, run, can_rigs.one_frame(2))
    before = [Controller(run, mapping).frames(f, i) for i, f in enumerate(frames[:11])]
    again = make_frames(run, 2, seed=5)
    after = [Controller(run, mapping).frames(f, i) for i, f in enumerate(again)]
    out = through(CanPipeline(run, mapping), [*before[:-1], before[-1][:3], *after])
    found = [o for o in out if isinstance(o, Frame)]
    same_frames(found[:10], [quantised(f, mapping) for f in frames[:10]])
    for one, other in zip(found[10:], again, strict=True):
        assert (one.realisation, one.experiment, one.period) == (
            other.realisation + 2,
            other.experiment,
            other.period,
        )
        np.testing.assert_array_equal(one.y, quantised(other, mapping).y)
    (fault,) = [o for o in out if isinstance(o, Fault) and o.kind is FaultKind.RESTARTED]
    assert "counter 0 after 328; its frames count from realisation 2 on" in fault.message


def test_a_wild_counter_moves_nothing(tmp_path):
    """Kills a damaged frame (no checksum guards it here) that closes realisations or takes another's place."""
    run, frames = plan(3)
    text = can_rigs.one_frame(2, crc=0)
    mapping = can_rigs.mapping(tmp_path, run, text)
    controller = Controller(run, mapping)
    batches = [controller.frames(f, i) for i, f in enumerate(frames)]
    wild = batches[4][3:4]
    wild.data[0, 4] = 200  # realisation
    wild.data[0, :4] = (1, 2, 3, 4)
    out = through(CanPipeline(run, mapping), [*batches[:4], batches[4][:3] + wild + batches[4][4:], *batches[5:]])
    same_frames(
        [o for o in out if isinstance(o, Frame)], [quantised(f, mapping) for i, f in enumerate(frames) if i != 4]
    )
    assert [o.kind for o in out if isinstance(o, Fault)] == [FaultKind.OUT_OF_PLAN, FaultKind.LOST]


def test_samples_that_the_controller_calls_invalid_are_not_numbers(tmp_path):
    """Kills a saturated or invalid sample that is averaged in: the collector refuses what is not finite."""
    run, frames = plan(1)
    mapping = can_rigs.mapping(tmp_path, run, can_rigs.one_frame(2))
    frames[2].y[1, 6] = 1e6  # beyond the signal's range
    controller = Controller(run, mapping)
    out = through(CanPipeline(run, mapping), [controller.frames(f, i) for i, f in enumerate(frames)])
    bad = [f.period for f in out if isinstance(f, Frame) and not np.isfinite(f.y).all()]
    assert bad == [2]
    assert np.flatnonzero(np.isnan(out[2].y[0])).tolist() == [4, 5, 6, 7]
