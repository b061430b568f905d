"""The worker's clock: silence is known while it lasts, and a replay through the loop finds what operators did."""

import threading
import time
from dataclasses import replace

from conftest import make_frames, make_rig, make_run
from creak.alarm_records import Action, ActionKind, AlarmRules, BaselineRules
from creak.monitor import Monitor
from creak.records import AlarmChange, Counts, Estimate, RunEnd, RunStatus
from creak.sinks.recorder import Recorder
from creak.sources.recording import Recording
from creak.worker import Worker, drive
from recorded import exact

RIG = make_rig(2, samples=128, lines=range(2, 40))
RUN = replace(make_run(RIG, window=2, start=10**18), alarms=AlarmRules(silence_s=0.6, stale_realisations=1000))


class Kept:
    """Sink that keeps alarm changes."""

    def __init__(self):
        self.changes = []

    def open(self, run):
        pass

    def take(self, record):
        if isinstance(record, AlarmChange):
            self.changes.append(record)

    def tick(self, now):
        pass

    def close(self, end):
        pass


class FallsSilent:
    """A rig that sends some frames and then nothing, without an end."""

    def __init__(self, live):
        self.run = RUN
        self.live = live
        self._stop = threading.Event()

    def frames(self):
        yield from make_frames(RUN, 1)
        self._stop.wait(20)

    def close(self):
        self._stop.set()


def silence_of(live, seconds):
    kept = Kept()
    worker = Worker(FallsSilent(live), [kept])
    worker.start()
    until = time.monotonic() + seconds
    while time.monotonic() < until and not kept.changes:
        time.sleep(0.02)
    worker.stop()
    assert worker.error is None
    return kept.changes


def test_a_live_rig_that_falls_silent_is_known_while_it_is_silent():
    """Kills an alarm that waits for the next frame of a rig that is dead; its time is when it was due."""
    (change,) = silence_of(True, 10.0)
    assert (change.condition, change.event) == ("silence", "raised")
    assert change.time == RUN.start + round(6 * RIG.period_ns) + 600_000_000


def test_a_source_that_may_be_held_back_is_not_silent_while_it_waits():
    assert silence_of(False, 1.5) == []


def test_the_loop_replays_what_operators_did(tmp_path):
    """Kills a `creak replay` whose alarms are unacknowledged although somebody acknowledged them."""
    monitor, recorder, live = Monitor(RUN), Recorder(tmp_path / "run.mcap"), []
    recorder.open(RUN)

    def note(outcomes):
        for outcome in outcomes:
            recorder.take(outcome)
            if isinstance(outcome, AlarmChange):
                live.append(outcome)

    for frame in make_frames(RUN, 10, cubic=2):
        note(monitor.take(frame))
        for change in [c for c in live if c.event == "raised" and c.version == 1]:
            if change.id not in {c.id for c in live if c.event == "acknowledged"}:
                note(monitor.act(Action(change.id, ActionKind.ACKNOWLEDGE, "ada", "seen")))
    recorder.close(RunEnd(monitor.time, RunStatus.COMPLETED, Counts()))
    kept = Kept()
    again, _ = drive(Recording(tmp_path / "run.mcap"), [kept])
    assert [repr(c) for c in kept.changes] == [repr(c) for c in live]
    assert again.alarms["2"] == "acknowledged"


class Frames:
    """Frames of a run that is over."""

    live = False

    def __init__(self, run, frames):
        self.run = run
        self._frames = frames

    def frames(self):
        yield from self._frames

    def close(self):
        pass


class Everything(Kept):
    """Sink that keeps estimates too."""

    def take(self, record):
        if isinstance(record, AlarmChange | Estimate):
            self.changes.append(record)


def test_the_recording_of_a_run_after_a_restart_replays_to_the_same(tmp_path):
    """Kills a replay that begins with an empty window, no alarms and no baseline where the run did not."""
    rules = BaselineRules(realisations=8)
    first = replace(RUN, baseline=rules)
    second = replace(first, id="after", start=first.start + 10**12)
    before = Monitor(first)
    for frame in make_frames(first, 12, cubic=9):
        before.take(frame)
    live, recorder = Everything(), Recorder(tmp_path / "after.mcap")
    source = Frames(second, make_frames(second, 6, seed=1, cubic=3))
    worker = Worker(source, [live, recorder], memory=before.memory)
    worker.start()
    worker._thread.join(20)
    assert worker.error is None
    again = Everything()
    drive(Recording(tmp_path / "after.mcap"), [again])
    assert exact(again.changes) == exact(live.changes)
    first_window = next(e for e in live.changes if isinstance(e, Estimate))
    assert first_window.realisations == 2
    alone = Everything()
    drive(Frames(second, make_frames(second, 6, seed=1, cubic=3)), [alone])
    assert exact(alone.changes) != exact(live.changes)
