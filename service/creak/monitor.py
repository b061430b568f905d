"""The whole path from period frames to alarms as one pure companion: the same for live data and for a replay.

The caller owns the loop: it hands over what a source yields and gets back what sinks are to take.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from creak import alarms, baseline
from creak.alarm_records import Action, ActionKind, Clock, Conflict, Verdict
from creak.alarms import quality
from creak.baseline import Baseline
from creak.digests import Digest, Outcome
from creak.judgement import Block, Last, judged
from creak.quality import Flaw, Watch
from creak.realisations import Collector, Realisation
from creak.records import (
    AlarmChange,
    AlarmState,
    Complex,
    Counts,
    Fault,
    FaultKind,
    Frame,
    FrameStatus,
    NodeLevel,
    Run,
    Scope,
)
from creak.window import Window


@dataclass(frozen=True, eq=False)
class Memory:
    """What a monitor has to know after a restart.

    Parameters
    ----------
    run : str
        Id of the run that it comes from.
    time : int
        Recorded time up to which it reaches, ns since the Unix epoch.
    nodes : tuple of NodeAlarm
        In the order of the rig.
    quality : Quality
    baselines : tuple of Baseline
    blocks : tuple of Block
        Of the realisations in the window, oldest first.
    older : int
        How many of them the window sums as older ones.
    """

    run: str
    time: int
    nodes: tuple[alarms.NodeAlarm, ...]
    quality: quality.Quality
    baselines: tuple[Baseline, ...]
    blocks: tuple[Block, ...]
    older: int = 0


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a monitor has to know to go on in the middle of a run that is told by digests.

    Parameters
    ----------
    memory : Memory
    whole : Block or None
        Sums of all complete realisations of the run.
    transient, steady : int
        Frames that were judged.
    faults : mapping of str to int
        By kind.
    """

    memory: Memory
    whole: Block | None
    transient: int
    steady: int
    faults: Mapping[str, int]


class Monitor:
    """Judges frames, keeps the sums, estimates levels and steps alarms; memory does not grow with frames.

    Parameters
    ----------
    run : Run
        Fixes the rig, the window of R realisations and the limits.
    memory : Memory or None
        What an earlier monitor of the same rig knew; None to begin afresh. What does not fit the rig any more
        (alarms of a node that is gone, sums of other lines) is left behind.
    """

    def __init__(self, run: Run, memory: Memory | None = None) -> None:
        self.run = run
        self._collector = Collector(run)
        self._watch = Watch(run)
        self._window = Window(run.window)
        self._about: Complex | None = None
        self._whole: Block | None = None
        rig = run.rig
        self._alarms = {node.name: alarms.NodeAlarm(alarms.Alarm(rig.name, node.name)) for node in rig.nodes}
        self._quality = quality.Quality()
        self._baselines: tuple[Baseline, ...] = ()
        self._time = run.start
        self._faults: Counter[str] = Counter()
        self._transient = 0
        self._steady = 0  # good and bad alike
        if memory is not None:
            self._remember(memory)

    @property
    def time(self) -> int:
        """Recorded time that it has come to, ns since the Unix epoch."""
        return self._time

    @property
    def memory(self) -> Memory:
        """All that a monitor after this one has to know, the open realisation aside."""
        return Memory(
            run=self.run.id,
            time=self._time,
            nodes=tuple(self._alarms.values()),
            quality=self._quality,
            baselines=self._baselines,
            blocks=tuple(self._window.blocks),
            older=self._window.older,
        )

    @property
    def checkpoint(self) -> Checkpoint:
        """All that a monitor needs to go on with the next digest of the same run."""
        return Checkpoint(self.memory, self._whole, self._transient, self._steady, dict(self._faults))

    @classmethod
    def resumed(cls, run: Run, checkpoint: Checkpoint) -> "Monitor":
        """Make the monitor of a checkpoint, which goes on as the one would that left it."""
        memory = checkpoint.memory
        monitor = cls(run, memory)
        monitor._quality, monitor._baselines, monitor._time = memory.quality, memory.baselines, memory.time
        monitor._whole = checkpoint.whole
        monitor._transient, monitor._steady = checkpoint.transient, checkpoint.steady
        monitor._faults = Counter(checkpoint.faults)
        return monitor

    @property
    def baselines(self) -> tuple[Baseline, ...]:
        """What is known of every node and operating state."""
        return self._baselines

    @property
    def counts(self) -> Counts:
        """What was handled so far; good frames of the open realisation are in neither sum yet."""
        complete = 0 if self._whole is None else self._whole.sums.realisations
        frames = complete * self.run.rig.q * self.run.steady_periods
        return Counts(
            frames=frames,
            rejected_frames=self._steady - frames - self._collector.open_frames,
            transient_frames=self._transient,
            realisations=complete,
            experiments=complete * self.run.rig.q,
            faults=dict(sorted(self._faults.items())),
        )

    @property
    def alarms(self) -> Mapping[str, AlarmState]:
        """State of every node's alarm."""
        return {name: alarm.state for name, alarm in self._alarms.items()}

    def take(self, item: Frame | Fault | Action | Clock) -> list[Outcome]:
        """Take a frame, note what a source says was lost, do what an operator asked for, or let time go by.

        Returns
        -------
        list
            The judged frame (or the fault) first, then what followed from it: faults, alarm changes that fell due,
            and at the completion of a realisation the estimates of window and run and the alarm changes.
        """
        if isinstance(item, Clock):
            return self._advance(item.time)
        if isinstance(item, Action):
            done = self.act(item)
            return [] if isinstance(done, Conflict) else list(done)
        if isinstance(item, Fault):
            faults = self._collector.lose(item)
            outcomes = self._note(item, *faults)
            if item.kind in quality.STOPPING:
                self._quality, changes = quality.stopped(self._quality, self.run, max(item.time, self._time))
                outcomes += changes
            return [*outcomes, *self._left_out(faults)]
        collected = self._collector.take(item)
        if collected.frame.status is FrameStatus.TRANSIENT:
            self._transient += 1
        else:
            self._steady += 1
        self._watch.take(collected.frame)
        outcomes = [collected.frame, *self._note(*collected.faults)]
        if not any(fault.kind in _TIMELESS for fault in collected.faults):
            self._quality, changes = quality.frame(self._quality, self.run, collected.frame)
            outcomes += [*changes, *self._advance(item.time + round(self.run.rig.period_ns))]
        outcomes += self._left_out(collected.faults)
        if collected.realisation is not None:
            outcomes += self._complete(collected.realisation)
        return outcomes

    def take_digest(self, digest: Digest) -> list[Outcome]:
        """Take a realisation that was gathered elsewhere, told by its sums.

        Faults that say that nothing comes any more are counted only: whether the rig is silent is known from the
        times up to which it was heard (:meth:`hear`), which come as they happen.

        Returns
        -------
        list
            Faults, estimates and alarm changes, as `take` gives them for the frames.
        """
        self._transient += digest.transient
        self._steady += digest.steady
        self._faults.update(digest.counts)
        outcomes: list[Outcome] = list(digest.faults)
        if digest.transient or digest.steady:
            outcomes += self.hear(digest.end)
        outcomes += self._left_out(digest.faults)
        if digest.block is not None:
            outcomes += self._judge(digest, digest.block, digest.flaws)
        return outcomes

    def hear(self, until: int) -> list[Outcome]:
        """Take note that frames have come without a break until a recorded time, ns since the Unix epoch."""
        since = max(self.run.start, until - round(self.run.rig.period_ns))
        self._quality, changes = quality.heard(self._quality, self.run, since, until)
        return [*changes, *self._advance(until)]

    def stop(self) -> list[Outcome]:
        """Take note that nothing comes any more, as whoever listens to the rig says."""
        self._quality, changes = quality.stopped(self._quality, self.run, self._time)
        return list(changes)

    def act(self, action: Action) -> tuple[AlarmChange, ...] | Conflict:
        """Do what an operator asks for, at the recorded time that the monitor has come to.

        Returns
        -------
        tuple of AlarmChange, or Conflict
            Empty if it is so already. A conflict changes nothing.
        """
        rules, run = self.run.alarms, self.run.id
        for name, node in self._alarms.items():
            if name == action.node or (not action.node and node.alarm.id == action.alarm):
                if action.kind is ActionKind.RELEARN and all(known.node != name for known in self._baselines):
                    return Conflict("not_allowed", f"node {name!r} has no baseline that could be replaced")
                done = alarms.act(node.alarm, action, self._time, rules, run)
                if isinstance(done, Conflict):
                    return done
                self._alarms[name] = replace(node, alarm=done[0])
                if action.kind is ActionKind.RELEARN:
                    self._baselines = tuple(
                        baseline.relearn(known) if known.node == name else known for known in self._baselines
                    )
                return done[1]
        if action.node:
            return Conflict("stale", f"the rig has no node {action.node!r} now")
        for key, alarm in self._quality.alarms.items():
            if alarm.id == action.alarm:
                if action.kind is ActionKind.RELEARN:
                    return Conflict("not_allowed", "an alarm about data has no baseline")
                done = alarms.act(alarm, action, self._time, rules, run)
                if isinstance(done, Conflict):
                    return done
                self._quality = replace(self._quality, alarms={**self._quality.alarms, key: done[0]})
                return done[1]
        return Conflict("stale", "the rig has no such alarm now: the occurrence has ended")

    def finish(self) -> list[Outcome]:
        """Close the run: names a realisation that was left incomplete."""
        return self._note(*self._collector.finish())

    def _note(self, *faults: Fault) -> list[Outcome]:
        for fault in faults:
            self._faults[fault.kind.value] += 1
        return list(faults)

    def _advance(self, time: int) -> list[Outcome]:
        """Let happen what falls due until a recorded time."""
        self._time = max(self._time, time)
        rules, run = self.run.alarms, self.run.id
        self._quality, overdue = quality.clock(self._quality, self.run, time)
        changes = list(overdue)
        for name, node in self._alarms.items():
            alarm, due = alarms.advance(node.alarm, time, rules, run)
            if alarm is not node.alarm:
                self._alarms[name] = replace(node, alarm=alarm)
                changes += due
        for key, old in self._quality.alarms.items():
            alarm, due = alarms.advance(old, time, rules, run)
            if alarm is not old:
                self._quality = replace(self._quality, alarms={**self._quality.alarms, key: alarm})
                changes += due
        return [*sorted(changes, key=lambda change: change.time)]

    def _left_out(self, faults: Iterable[Fault]) -> list[Outcome]:
        """Tell the quality alarms of realisations that are over without being complete."""
        outcomes: list[Outcome] = []
        for fault in faults:
            if fault.kind in quality.SPOILING:
                time = max(fault.time, self.run.start)
                self._quality, changes = quality.closed(self._quality, self.run, time, len(self._window), None)
                outcomes += changes
        return outcomes

    def _complete(self, realisation: Realisation) -> list[Outcome]:
        return self._judge(realisation, Block.of(realisation, self.run.rig.q), self._watch.judge(realisation))

    def _judge(self, realisation: Last, block: Block, flaws: tuple[Flaw, ...]) -> list[Outcome]:
        rig = self.run.rig
        told = self._note(*(flaw.fault for flaw in flaws))
        block = self._referred(block)
        self._window.push(block)
        self._whole = block if self._whole is None else self._whole + block
        window = judged(rig, self._window.total, Scope.WINDOW, realisation)
        whole = judged(rig, self._whole, Scope.RUN, realisation)
        self._time = max(self._time, realisation.end)
        poor = {(flaw.fault.kind, node) for flaw in flaws for node in flaw.nodes}
        self._quality, changes = quality.closed(self._quality, self.run, realisation.end, len(self._window), poor)
        outcomes: list[Outcome] = [*told, window, whole, *changes]
        rms = self._operating_state()
        for level in window.nodes:
            verdicts = {} if rms is None else self._compare(level, rms, realisation)
            self._alarms[level.name], changes = alarms.step(
                self.run, self._alarms[level.name], level, realisation.end, verdicts
            )
            outcomes += changes
        return outcomes

    def _referred(self, block: Block) -> Block:
        """Take a block about the matrix that the others are taken about; a new one if it no longer fits."""
        if self._about is not None:
            block = block.about(self._about)
        if self._about is None or (self._window.turns and block.sums.excess() > _EXCESS):
            self._about = block.sums.S
            self._window.refer(self._about)
            self._whole = None if self._whole is None else self._whole.about(self._about)
            block = block.about(self._about)
        return block

    def _operating_state(self) -> float | None:
        """RMS of the excitation if baselines are wanted and the window is full and of one state."""
        rules = self.run.baseline
        if not rules.realisations or len(self._window) < self.run.window:
            return None
        each = [baseline.input_rms(block.sums) for block in self._window.blocks]
        if not baseline.same_state(min(each), max(each), rules.state_tolerance_db):
            return None
        return sum(each) / len(each)

    def _compare(self, level: NodeLevel, rms: float, realisation: Last) -> dict[str, Verdict]:
        """Compare a node with its baseline for the operating state, and learn."""
        rules = self.run.baseline
        known = baseline.find(self._baselines, level.name, rms, rules.state_tolerance_db)
        before = known or baseline.begin(level, rms)
        if before is None:
            return {}
        node = self._alarms[level.name]
        assert self._whole is not None
        count = self._whole.sums.realisations - 1
        after, verdicts = baseline.step(self.run, before, level, count, realisation.end, node.healthy)
        self._baselines = (*(b for b in self._baselines if b is not known), after)
        return verdicts

    def _remember(self, memory: Memory) -> None:
        run = self.run
        for node in memory.nodes:
            if node.alarm.node in self._alarms and node.alarm.rig == run.rig.name:
                self._alarms[node.alarm.node] = node
        known = {"", *self._alarms}
        kept = {key: alarm for key, alarm in memory.quality.alarms.items() if key[1] in known}
        # deadlines count from the new run's first frame: that nobody watched meanwhile is no fault of the rig
        self._quality = replace(memory.quality, alarms=kept, heard=None, completed=None)
        self._baselines = tuple(
            b if memory.run == run.id else baseline.carried_over(b, run.window)
            for b in memory.baselines
            if b.node in self._alarms
        )
        rig, width = self.run.rig, self.run.rig.q + self.run.rig.n
        shape = (self.run.steady_periods, len(rig.lines), width), (len(rig.lines), rig.n, rig.q)
        fitting = [b for b in memory.blocks if (b.sums.period_sums.shape, b.sums.S.shape) == shape]
        if fitting:
            self._about = fitting[-1].sums.about
            self._window = Window(run.window, fitting, memory.older if len(fitting) == len(memory.blocks) else 0)


_EXCESS = 1e4  # costs four of sixteen digits where the structure changes
_TIMELESS = {FaultKind.OUT_OF_PLAN}  # such a frame is none of the run's, so its time says nothing
