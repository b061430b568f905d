"""A recording replayed gives the same alarm changes at the same times, operators and silences included."""

import random
from dataclasses import replace

import pytest

from conftest import make_frames, make_rig, make_run
from creak.alarm_records import Action, ActionKind, AlarmRules, Clock, Conflict
from creak.monitor import Monitor
from creak.records import AlarmChange, Counts, RunEnd, RunStatus
from creak.sinks.recorder import Recorder
from creak.sources.protocol import Replayable
from creak.sources.recording import Recording

S = 10**9
RULES = AlarmRules(on_delay_s=7.0, off_delay_s=5.0, realarm_s=30.0, silence_s=15.0)
RUN = replace(
    make_run(make_rig(2, samples=128, lines=range(2, 40)), window=2, start=1_700_000_000 * S), alarms=RULES
)


def act(monitor, luck, changes):
    """Somebody does something to an alarm that there was, at any moment; often in vain."""
    if not changes:
        return []
    kind = luck.choice(list(ActionKind))
    action = Action(luck.choice(changes).id, kind, luck.choice("ab"), "why", monitor.time + 40 * S)
    done = monitor.act(action)
    return [] if isinstance(done, Conflict) else list(done)


@pytest.mark.parametrize("seed", range(4))
def test_replay_equals_live_with_operators_gaps_and_losses(tmp_path, seed):
    """Kills an action that is not recorded, one that is done again, and a timer that reads another clock."""
    luck = random.Random(seed)
    monitor, recorder = Monitor(RUN), Recorder(tmp_path / "run.mcap")
    recorder.open(RUN)
    live, gap = [], 0

    def note(outcomes):
        for outcome in outcomes:
            recorder.take(outcome)
            if isinstance(outcome, AlarmChange):
                live.append(outcome)

    for frame in make_frames(RUN, 24, seed=seed, cubic=4):
        if luck.random() < 0.03:  # the rig pauses, and the worker's clock goes on
            pause = luck.randrange(1, 60)
            for second in range(0, pause, luck.randrange(1, 9)):
                note(monitor.take(Clock(frame.time + gap + second * S)))
                if luck.random() < 0.1:
                    note(act(monitor, luck, live))
            gap += pause * S
        if luck.random() < 0.01:
            continue  # lost
        note(monitor.take(replace(frame, time=frame.time + gap)))
        if luck.random() < 0.2:
            note(act(monitor, luck, live))
    note(monitor.take(Clock(monitor.time + 100 * S)))  # nothing comes any more
    recorder.close(RunEnd(monitor.time, RunStatus.COMPLETED, Counts()))

    recording = Recording(tmp_path / "run.mcap")
    assert isinstance(recording, Replayable)
    assert recording.run == RUN
    again = Monitor(recording.run)
    replayed = [o for item in recording.replayed() for o in again.take(item) if isinstance(o, AlarmChange)]
    assert [repr(c) for c in replayed] == [repr(c) for c in live]  # NaN is not equal to itself
    assert {"raised", "acknowledged", "shelved"} <= {c.event for c in live}
    assert again.alarms == monitor.alarms
