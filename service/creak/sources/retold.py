"""Digests made again from a recording: what was never sent, or has to be sent once more."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from creak.digests import CLOSING, OPENING, Digest, Gatherer
from creak.records import Counts, Fault, FaultKind, Run, RunEnd, RunStatus
from creak.sources.recording import Recording

BEFORE_ALL = OPENING - 1
"""In place of the index of a digest that is known: none is."""


def retold(
    paths: Sequence[Path], after: int, *, whole_frames: bool, ended: bool
) -> Iterator[tuple[Run, Digest, RunEnd | None]]:
    """Yield the digests of a recorded run that follow a known one.

    Parameters
    ----------
    paths : sequence of Path
        Parts of the run's recording.
    after : int
        Index of the known digest.
    whole_frames : bool
        Digests carry frames instead of sums.
    ended : bool
        The run is over, so what is open in it will stay open; False while it is being recorded.

    Raises
    ------
    RecordingError
        If the recording cannot be read.
    """
    recording = Recording(*paths)
    run = recording.run
    if after < OPENING:
        yield run, Digest(OPENING, OPENING, run.start), None
    gatherer = Gatherer(run, whole_frames=whole_frames, after=max(after, OPENING))
    for item in recording.frames():
        if not ended and isinstance(item, Fault) and item.kind is FaultKind.DAMAGED:
            return  # a chunk that is being written at this moment: behind it the file may have grown meanwhile
        for outcome in gatherer.take(item):
            if isinstance(outcome, Digest):
                yield run, outcome, None
    if not ended:
        return
    for outcome in gatherer.finish():
        if isinstance(outcome, Digest):
            counted = recording.end or RunEnd(
                outcome.end, RunStatus.INTERRUPTED, Counts(), "its worker ended without closing it"
            )
            yield run, outcome, counted if outcome.index == CLOSING else None
