"""What every sink of records promises."""

from collections.abc import Sequence
from typing import Protocol

from creak.alarm_records import Conflict
from creak.digests import Outcome
from creak.monitor import Memory
from creak.records import Run, RunEnd
from creak.sinks.actions import Asked


class Sink(Protocol):
    """A place to which the worker hands all records of a run, in order."""

    def open(self, run: Run) -> None:
        """Begin a run with all that is known before its first frame."""
        ...

    def take(self, record: Outcome) -> None:
        """Take one record; frames carry the status that the monitor gave them."""
        ...

    def tick(self, now: float) -> None:
        """Do what is due; called several times a second.

        Parameters
        ----------
        now : float
            Monotonic time in seconds, of the worker's clock.
        """
        ...

    def close(self, end: RunEnd) -> None:
        """End the run with its exit status and counts; nothing is taken afterwards."""
        ...


class Desk(Protocol):
    """Where a worker hears what operators want, and keeps what a restart needs; no call waits for anything."""

    def asked(self) -> Sequence[Asked]:
        """Return what was asked for since the last call."""
        ...

    def answer(self, asked: Asked, conflict: Conflict | None) -> None:
        """Tell that an action was carried out, or why not; after the records that came of it."""
        ...

    def save(self, memory: Memory) -> None:
        """Keep what the monitor knows."""
        ...
