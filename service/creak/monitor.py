"""The whole path from period frames to alarms as one pure companion: the same for live data and for a replay.

The caller owns the loop: it hands over what a source yields and gets back what sinks are to take.
"""

from collections import Counter, deque
from collections.abc import Mapping
from functools import reduce
from operator import add

from creak import alarms, quality
from creak.network import estimate
from creak.realisations import Collector, Realisation
from creak.records import AlarmChange, AlarmState, Counts, Estimate, Fault, Frame, FrameStatus, Run, Scope
from creak.statistics import Sums

Outcome = Frame | Fault | Estimate | AlarmChange


class Monitor:
    """Judges frames, keeps the sums, estimates levels and steps alarms; memory does not grow with frames.

    Parameters
    ----------
    run : Run
        Fixes the rig, the window of R realisations and the limits.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self._collector = Collector(run)
        self._blocks: deque[Sums] = deque(maxlen=run.window)
        rig = run.rig
        self._whole = Sums.zero(run.steady_periods, len(rig.lines), rig.n, rig.q)
        self._alarms = {node.name: alarms.NodeAlarm() for node in rig.nodes}
        self._quality = quality.QualityAlarm()
        self._faults: Counter[str] = Counter()
        self._transient = 0
        self._steady = 0  # good and bad alike

    @property
    def counts(self) -> Counts:
        """What was handled so far; good frames of the open realisation are in neither sum yet."""
        complete = self._whole.realisations
        frames = self._whole.experiments * self.run.steady_periods
        return Counts(
            frames=frames,
            rejected_frames=self._steady - frames - self._collector.open_frames,
            transient_frames=self._transient,
            realisations=complete,
            experiments=self._whole.experiments,
            faults=dict(sorted(self._faults.items())),
        )

    @property
    def alarms(self) -> Mapping[str, AlarmState]:
        """State of every node's alarm."""
        return {name: alarm.state for name, alarm in self._alarms.items()}

    def take(self, item: Frame | Fault) -> list[Outcome]:
        """Take a frame, or note what a source says was lost.

        Returns
        -------
        list
            The judged frame (or the fault) first, then what followed from it: faults, and at the completion of a
            realisation the estimates of window and run and the alarm changes.
        """
        if isinstance(item, Fault):
            noted = self._note(item, *self._collector.lose(item))
            self._quality, raised = quality.step_on_fault(self.run, self._quality, item)
            return [*noted, *raised]
        collected = self._collector.take(item)
        if collected.frame.status is FrameStatus.TRANSIENT:
            self._transient += 1
        else:
            self._steady += 1
        outcomes: list[Outcome] = [collected.frame, *self._note(*collected.faults)]
        end = item.time + round(self.run.rig.period_ns)
        self._quality, cleared = quality.step_on_frame(self.run, self._quality, end)
        outcomes += cleared
        if collected.realisation is not None:
            outcomes += self._complete(collected.realisation)
        return outcomes

    def finish(self) -> list[Outcome]:
        """Close the run: names a realisation that was left incomplete."""
        return self._note(*self._collector.finish())

    def _note(self, *faults: Fault) -> list[Outcome]:
        for fault in faults:
            self._faults[fault.kind.value] += 1
        return list(faults)

    def _complete(self, realisation: Realisation) -> list[Outcome]:
        rig = self.run.rig
        block = Sums.of(realisation.spectra, rig.q)
        self._blocks.append(block)
        self._whole = self._whole + block
        window = estimate(rig, reduce(add, self._blocks), Scope.WINDOW, realisation.end, realisation.index)
        whole = estimate(rig, self._whole, Scope.RUN, realisation.end, realisation.index)
        outcomes: list[Outcome] = [window, whole]
        for level in window.nodes:
            self._alarms[level.name], changes = alarms.step(
                self.run, self._alarms[level.name], level, realisation.end
            )
            outcomes += changes
        return outcomes
