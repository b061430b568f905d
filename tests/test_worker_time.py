"""The worker's clock: silence is known while it lasts, and a replay through the loop finds what operators did."""

import threading
import time
from dataclasses import replace

from conftest import make_frames, make_rig, make_run
from creak.alarm_records import Action, ActionKind, AlarmRules
from creak.monitor import Monitor
from creak.records import AlarmChange, Counts, RunEnd, RunStatus
from creak.sinks.recorder import Recorder
from creak.sources.recording import Recording
from creak.worker import Worker, drive

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
