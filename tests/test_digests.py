"""Digests: what a monitor makes of them is what it makes of the frames, wherever they are cut and carried."""

import json
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_frames, make_rig, make_run
from creak.codec import packed, unpacked
from creak.digests import CLOSING, OPENING, Digest, Gatherer, summed
from creak.errors import RecordingError
from creak.monitor import Checkpoint, Memory, Monitor
from creak.records import AlarmChange, Estimate, Fault, FaultKind, Frame, Scope

RUN = make_run(make_rig(3, lines=range(2, 8)), steady=2, window=3)
REPORTED = Fault(FaultKind.CORRUPTED, 5, "a checksum is wrong")


def digests_of(run, items, **options):
    gatherer = Gatherer(run, **options)
    told = [each for item in items for each in gatherer.take(item)] + gatherer.finish()
    return [each for each in told if isinstance(each, Digest)], gatherer


def disturbed(seed):
    """Frames with a spring from realisation 4 on; some are lost, doubled or not finite."""
    dice = random.Random(seed)
    items = []
    for good in make_frames(RUN, 10, seed=seed, noise=1e-3, cubic=4):
        frame, fate = good, dice.random()
        if fate < 0.02:
            items.append(
                Fault(FaultKind.LOST, frame.time, "gone", frame.realisation, frame.experiment, frame.period)
            )
            continue
        if fate < 0.03:
            frame = replace(frame, y=np.full_like(frame.y, np.nan))
        items += [frame] * (2 if fate > 0.98 else 1)
        if 0.5 < fate < 0.52:
            items.append(REPORTED)
    return items


def essence(outcomes):
    """Estimates to the last bit, changes of process alarms, faults by kind."""
    estimates = [(o.scope, o.realisation, o.time, o.nodes) for o in outcomes if isinstance(o, Estimate)]
    changes = [o for o in outcomes if isinstance(o, AlarmChange) and o.class_ == "process"]
    return estimates, changes, sorted(o.kind for o in outcomes if isinstance(o, Fault))


def sums(digest):
    """What must be the same each time it is told; copies of older frames that came late are counted once only."""
    return digest.index, digest.previous, digest.block and packed(digest.block), digest.flaws


def live(items):
    monitor = Monitor(RUN)
    outcomes = [o for item in items for o in monitor.take(item)] + monitor.finish()
    return monitor, [o for o in outcomes if not isinstance(o, Frame)]


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000), whole_frames=st.booleans())
def test_a_monitor_far_away_says_what_one_at_the_rig_says(seed, whole_frames):
    """Through bytes, and with a new monitor from a checkpoint after every digest: a takeover is not seen."""
    items = disturbed(seed)
    near, expected = live(items)
    told, gatherer = digests_of(RUN, items, whole_frames=whole_frames)
    far, outcomes = Monitor(RUN), []
    for digest in told:
        carried = summed(RUN, unpacked(Digest, packed(digest)))
        outcomes += far.take_digest(carried)
        far = Monitor.resumed(RUN, unpacked(Checkpoint, packed(far.checkpoint)))
    assert essence(outcomes) == essence(expected)
    assert essence(expected)[1] or near.counts.realisations < 8  # the spring raises alarms
    assert far.counts == near.counts
    assert far.alarms == near.alarms
    flaws = sum(k in {"clipped", "stuck", "transient"} for k in near.counts.faults)
    assert flaws or gatherer.counts == near.counts
    assert gatherer.counts.realisations == sum(d.block is not None or bool(d.frames) for d in told)


@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 10_000), data=st.data())
def test_digests_made_again_from_a_recording_are_those_that_were_sent(seed, data):
    """From any of them on, to the last bit of the sums: so a run that was killed is told to its end."""
    items = disturbed(seed)
    told, _ = digests_of(RUN, items)
    assert [d.previous for d in told] == [OPENING, *(d.index for d in told[:-1])]
    assert told[-1].index == CLOSING
    known = data.draw(st.integers(0, len(told) - 2))
    again, _ = digests_of(RUN, items, after=told[known].index)
    assert [sums(d) for d in again] == [sums(d) for d in told[known + 1 :]]


def test_a_storm_of_faults_is_counted_and_does_not_fill_the_memory():
    frames = make_frames(RUN, 2)
    items = [frames[0], *[REPORTED] * 5000, *frames[1:]]
    told, _ = digests_of(RUN, items)
    assert told[0].counts == {"corrupted": 5000}
    assert len(told[0].faults) < 1000


def test_what_says_how_far_the_rig_was_heard_ends_its_silence():
    """Kills an alarm that stands although frames come, and one that is raised because digests are seldom."""
    monitor = Monitor(RUN)
    told, _ = digests_of(RUN, make_frames(RUN, 2))
    monitor.take_digest(told[0])
    late = told[0].end + 3_600_000_000_000
    assert [c.condition for c in monitor.take(Fault(FaultKind.SILENT, late, "nothing")) if hasattr(c, "condition")]
    assert [c.event for c in monitor.hear(late + 1) if c.condition == "silence"] == ["cleared"]
    fresh = Monitor(RUN)
    fresh.take_digest(told[0])
    assert not any(
        isinstance(o, AlarmChange) for o in fresh.take_digest(replace(told[1], end=told[0].end + 10**9))
    )


@pytest.mark.parametrize(
    "array",
    [
        ["zeros", "<f8", [10**15], 0, [0]],
        ["zeros", "<f8", [2**70], 0, [0]],
        ["ordered", "<f8", [2**70], 0, [0]],
        ["ordered", 8, [1], 0, [0]],
        ["enum", "Verdict", []],
        ["record", "Digest", []],
    ],
)
def test_bytes_that_ask_for_what_cannot_be_are_refused(array):
    """Kills a letter that ends the analyser: more memory than there is, a number that is none of the machine's."""
    text = json.dumps({"format": 3, "memory": array}).encode()
    with pytest.raises(RecordingError, match="cannot be read"):
        unpacked(Memory, len(text).to_bytes(8, "little") + text)


def test_bytes_of_another_kind_are_refused():
    digest = digests_of(RUN, make_frames(RUN, 1))[0][0]
    with pytest.raises(RecordingError, match="no Memory"):
        unpacked(Memory, packed(digest))
    assert Scope.RUN in {o.scope for o in Monitor(RUN).take_digest(digest) if isinstance(o, Estimate)}
