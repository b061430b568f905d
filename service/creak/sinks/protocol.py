"""What every sink of records promises."""

from typing import Protocol

from creak.records import AlarmChange, Estimate, Fault, Frame, Run, RunEnd


class Sink(Protocol):
    """A place to which the worker hands all records of a run, in order."""

    def open(self, run: Run) -> None:
        """Begin a run with all that is known before its first frame."""
        ...

    def take(self, record: Frame | Fault | Estimate | AlarmChange) -> None:
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
