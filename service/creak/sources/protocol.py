"""What every source of period frames promises."""

from collections.abc import Iterator
from typing import Protocol, runtime_checkable

from creak.alarm_records import Action, Clock
from creak.records import Fault, Frame, Run


class Source(Protocol):
    """A rig, simulated, recorded or real, that delivers period frames.

    Attributes
    ----------
    run : Run
        All that is known before the first frame.
    live : bool
        True if the source cannot wait: what the worker has no room for is then dropped and counted.
        False if it may be held back.
    """

    run: Run
    live: bool

    def frames(self) -> Iterator[Frame | Fault]:
        """Yield period frames as they come, and faults for what never came or cannot be read.

        Frames leave with the status ``accepted``; judging them is the monitor's task.
        """
        ...

    def close(self) -> None:
        """End the iteration soon, also from another thread; a second call is harmless."""
        ...


@runtime_checkable
class Replayable(Protocol):
    """A source that also knows what operators did and how far time had come while nothing was measured."""

    def replayed(self) -> Iterator[Frame | Fault | Action | Clock]:
        """Yield what `Source.frames` does, and in between what else the monitor took."""
        ...
