"""Realisations told from afar: what a monitor needs of each, gathered where the frames are.

A `Gatherer` stands beside the rig and takes its frames; a :class:`creak.monitor.Monitor` elsewhere takes the
digests that it gives. Sums are a few hundredths to a third of the samples, and merge like any others.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from creak.alarm_records import Action, Clock
from creak.errors import RecordingError
from creak.judgement import Block
from creak.quality import Flaw, Watch
from creak.realisations import Collector, Realisation
from creak.records import AlarmChange, Counts, Estimate, Fault, FaultKind, Frame, FrameStatus, Run

OPENING: Final = -1
"""Index of the digest that opens a run."""

CLOSING: Final = 2**31 - 1
"""Index of the digest that closes a run."""

_NAMED = 200  # faults of one realisation that are named; all are counted
_CLOSE = {FaultKind.INCOMPLETE, FaultKind.SINGULAR}


@dataclass(frozen=True, eq=False)
class Digest:
    """What happened in a rig from the end of one realisation to the end of the next.

    Parameters
    ----------
    index : int
        Of the realisation; `OPENING` and `CLOSING` where a run begins and ends.
    previous : int
        Index of the digest before it, so that a gap is seen.
    end : int
        Recorded time up to which it reaches, ns since the Unix epoch.
    transient, steady : int
        Frames that were judged, refused ones among the steady.
    counts : mapping of str to int
        Faults by kind.
    faults : tuple of Fault
        The first few hundred of them, in order.
    block : Block or None
        Sums of the realisation; None if it was left out or is told by its frames.
    flaws : tuple of Flaw
        What is wrong with samples that entered the sums.
    frames : tuple of Frame
        In place of sums: every frame of the realisation that was not refused.
    """

    index: int
    previous: int
    end: int
    transient: int = 0
    steady: int = 0
    counts: Mapping[str, int] = field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    block: Block | None = None
    flaws: tuple[Flaw, ...] = ()
    frames: tuple[Frame, ...] = ()


Outcome = Frame | Fault | Estimate | AlarmChange | Digest
"""What a monitor or a gatherer makes of what it is given, and sinks take."""


class Gatherer:
    """Judges frames and gathers them into digests; memory does not grow with their number.

    It takes the place of a monitor in the loop at a rig, where nothing is estimated.

    Parameters
    ----------
    run : Run
    whole_frames : bool
        Digests carry frames instead of sums.
    after : int
        Index of the last digest that is known already: frames up to that realisation are passed over, late copies
        of them uncounted.
    """

    def __init__(self, run: Run, *, whole_frames: bool = False, after: int = OPENING) -> None:
        self.run = run
        self._whole_frames = whole_frames
        self._collector = Collector(run)
        self._watch = Watch(run)
        self._previous = self._after = after
        self._totals: Counter[str] = Counter()
        self._complete = self._transient = self._steady = 0
        self._end = run.start
        self._begin()

    def _begin(self) -> None:
        self._open_transient = self._open_steady = 0
        self._faults: list[Fault] = []
        self._counts: Counter[str] = Counter()
        self._frames: list[Frame] = []

    @property
    def counts(self) -> Counts:
        """What was handled so far; good frames of the open realisation are in neither sum yet."""
        each = self.run.rig.q * self.run.steady_periods
        return Counts(
            frames=self._complete * each,
            rejected_frames=self._steady - self._complete * each - self._collector.open_frames,
            transient_frames=self._transient,
            realisations=self._complete,
            experiments=self._complete * self.run.rig.q,
            faults=dict(sorted(self._totals.items())),
        )

    def take(self, item: Frame | Fault | Action | Clock) -> list[Outcome]:
        """Take what a source yields; of operators and of time passing it knows nothing.

        Returns
        -------
        list
            The judged frame or the fault first, then the faults that followed, and a digest for each realisation
            that is over with it.
        """
        if isinstance(item, Action | Clock):
            return []
        if item.realisation is not None and item.realisation <= self._after:
            self._begin()  # what came before it is told already
            return [item]
        if isinstance(item, Fault):
            found = self._collector.lose(item)
            digests = self._turn(found)
            self._note(item)
            return [item, *found, *digests]
        taken = self._collector.take(item)
        digests = self._turn(tuple(f for f in taken.faults if f.kind is FaultKind.INCOMPLETE))
        if not self._whole_frames:
            self._watch.take(taken.frame)
        self._count(taken.frame)
        for fault in taken.faults:
            if fault.kind is not FaultKind.INCOMPLETE:
                self._note(fault)
        if taken.realisation is not None:
            digests.append(self._summed(taken.realisation))
        else:
            digests += [self._close(f.realisation) for f in taken.faults if f.kind is FaultKind.SINGULAR]
        return [taken.frame, *taken.faults, *digests]

    def finish(self) -> list[Outcome]:
        """Close the run; the last digest is the one of the end."""
        found = self._collector.finish()
        return [*found, *self._turn(found), self._close(CLOSING)]

    def _turn(self, found: tuple[Fault, ...]) -> list[Digest]:
        """Digests of realisations that are over without being complete."""
        digests = []
        for fault in found:
            self._note(fault)
            digests.append(self._close(fault.realisation))
        return digests

    def _note(self, fault: Fault) -> None:
        self._totals[fault.kind.value] += 1
        self._counts[fault.kind.value] += 1
        if len(self._faults) < _NAMED or fault.kind in _CLOSE:
            self._faults.append(fault)

    def _count(self, frame: Frame) -> None:
        transient = frame.status is FrameStatus.TRANSIENT
        self._transient += transient
        self._steady += not transient
        self._open_transient += transient
        self._open_steady += not transient
        if frame.status is not FrameStatus.REJECTED:
            self._end = max(self._end, frame.time + round(self.run.rig.period_ns))
            if self._whole_frames:
                self._frames.append(frame)

    def _summed(self, realisation: Realisation) -> Digest:
        self._complete += 1
        frames = tuple(self._frames)
        flaws = () if frames else self._watch.judge(realisation)
        block = None if frames else Block.of(realisation, self.run.rig.q)
        digest = self._close(realisation.index)
        return replace(digest, end=realisation.end, block=block, flaws=flaws, frames=frames)

    def _close(self, index: int | None) -> Digest:
        assert index is not None  # every fault that closes a realisation names it
        digest = Digest(
            index=index,
            previous=self._previous,
            end=self._end,
            transient=self._open_transient,
            steady=self._open_steady,
            counts=dict(self._counts),
            faults=tuple(self._faults),
        )
        self._previous = index
        self._begin()
        return digest


def summed(run: Run, digest: Digest) -> Digest:
    """Make a digest that is told by its frames one that is told by their sums; any other is left as it is.

    Raises
    ------
    RecordingError
        If its frames are not those of a complete realisation.
    """
    if not digest.frames:
        return digest
    gatherer = Gatherer(run, after=digest.previous)
    for frame in digest.frames:
        for outcome in gatherer.take(frame):
            if isinstance(outcome, Digest):
                return replace(digest, block=outcome.block, flaws=outcome.flaws, frames=())
    raise RecordingError(f"{len(digest.frames)} frames that do not make realisation {digest.index} complete")
