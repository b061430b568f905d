"""What a run has handled so far, counted from the records that a sink sees."""

from collections import Counter
from dataclasses import dataclass, field

from creak.digests import Outcome
from creak.records import Counts, Estimate, Fault, FaultKind, Frame, FrameStatus, Scope

_CLOSED = {FaultKind.INCOMPLETE, FaultKind.SINGULAR}


@dataclass
class Tally:
    """Running counts of a run; at its end the monitor's own, in `RunEnd`, take their place.

    A good frame counts as accepted once its realisation is complete, and as rejected once it is known that the
    realisation will not be; until then it is in neither.
    """

    frames: int = 0
    rejected: int = 0
    transient: int = 0
    realisations: int = 0
    experiments: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    _open: Counter[int] = field(default_factory=Counter)

    def take(self, record: Outcome) -> None:
        """Count a record as it comes out of the monitor."""
        match record:
            case Frame(status=FrameStatus.ACCEPTED):
                self._open[record.realisation] += 1
            case Frame(status=FrameStatus.TRANSIENT):
                self.transient += 1
            case Frame():
                self.rejected += 1
            case Fault():
                self.faults[record.kind.value] += 1
                if record.kind in _CLOSED and record.realisation is not None:
                    self.rejected += self._open.pop(record.realisation, 0)
            case Estimate(scope=Scope.RUN):
                self.realisations = record.realisations
                self.experiments = record.experiments
                self.frames += self._open.pop(record.realisation, 0)

    def restore(self, counts: Counts) -> None:
        """Go on from counts that were taken elsewhere."""
        self.frames, self.rejected, self.transient = (
            counts.frames,
            counts.rejected_frames,
            counts.transient_frames,
        )
        self.realisations, self.experiments = counts.realisations, counts.experiments
        self.faults = Counter(counts.faults)

    @property
    def counts(self) -> Counts:
        """The counts as they stand."""
        return Counts(
            frames=self.frames,
            rejected_frames=self.rejected,
            transient_frames=self.transient,
            realisations=self.realisations,
            experiments=self.experiments,
            faults=dict(self.faults),
        )
