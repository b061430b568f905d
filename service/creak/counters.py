"""Where a counted sample belongs in the run: a wrapping counter and markers to a place that never wraps.

A frame says where it belongs by itself: its markers (realisation, experiment, period) and its counter give the
place of its first sample. That place is believed only if it continues what came before. What does not fit is
waited with until it is confirmed by others (the controller began again, or much was lost) or contradicted (one
damaged frame, which then counts for nothing). So neither a wild counter nor a controller that starts anew can put
a sample where it does not belong.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from creak.records import Run

Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]

FORWARD: Final = 4
"""Frames that must agree with each other before a jump forward is believed."""
BACKWARD: Final = 16
"""... and before a jump back is taken for a controller that began again, not for a heap of late frames."""
_PATIENCE: Final = 64  # frames that may wait for a confirmation
_YEAR: Final = 3.2e7  # seconds: a counter that takes longer never wraps


@dataclass(frozen=True)
class Counting:
    """How the leading counter and the markers count.

    Parameters
    ----------
    wraps : int
        Samples after which the counter is 0 again.
    ranges : tuple of int
        Values that the markers can take, in the order realisation, experiment, period; the later ones, or all,
        may be absent.
    """

    wraps: int
    ranges: tuple[int, ...] = ()

    def unit(self, run: Run) -> int:
        """Samples between two changes of the finest marker; without markers a realisation."""
        period = run.rig.period_samples
        return (run.rig.q * run.periods * period, run.periods * period, period)[max(len(self.ranges) - 1, 0)]

    def endless(self, run: Run) -> bool:
        """Whether the counter outlives any run."""
        return self.wraps / run.rig.sample_rate > _YEAR

    def problem(self, run: Run) -> str:
        """Say why places cannot be told from such a counter; empty if they can."""
        size, unit = run.rig.period_samples, self.unit(run)
        if self.wraps < size:
            return f"wraps after {self.wraps} samples, before a period of {size} ends: too short"
        if self.wraps % unit and not self.endless(run):
            what = ("realisations", "experiments", "periods")[max(len(self.ranges) - 1, 0)]
            remedy = "let it wrap at a multiple and say so with 'wraps'"
            if not self.ranges:
                remedy += ", or name markers"
            return (
                f"wraps after {self.wraps} samples, which is no whole number of {what} ({unit} samples), "
                f"so a place cannot be told from it: {remedy}"
            )
        for name, values, needed in zip(
            ("experiment", "period"), self.ranges[1:], (run.rig.q, run.periods), strict=False
        ):
            if values < needed:
                return f"goes with a marker '{name}' of {values} values, too few for {needed}"
        if self.ranges and self.ranges[0] < 4:
            return f"goes with a marker 'realisation' of {self.ranges[0]} values, should have 4 or more"
        return ""


@dataclass(frozen=True)
class Placed:
    """Consecutive frames of the leading message: where they belong.

    Parameters
    ----------
    begin, end : int
        Rows, end excluded.
    first : array, (rows,)
        Place of the first sample of each in the run.
    believed : array of bool, (rows,)
        False for those that fit nowhere.
    """

    begin: int
    end: int
    first: Whole
    believed: Flags


@dataclass(frozen=True)
class Resumed:
    """From the next row on another epoch holds: the controller began again, or nobody can tell where it was."""

    row: int
    message: str


@dataclass(frozen=True)
class Waiting:
    """The rows from here on are to be handed over again, before those that come next."""

    row: int


class Tracker:
    """Follows the leading counter.

    Parameters
    ----------
    run : Run
    counting : Counting
    samples : int
        Samples in a frame of the leading message.
    """

    def __init__(self, run: Run, counting: Counting, samples: int = 1) -> None:
        rig = run.rig
        self._rate = rig.sample_rate
        self._size = rig.period_samples
        self._realisation = rig.q * run.periods * rig.period_samples
        self._limits = (rig.q, run.periods)
        self._counting = counting
        self._unit = counting.unit(run)
        # Places that differ by this many samples cannot be told apart.
        self._span = counting.ranges[0] * self._realisation if counting.ranges else counting.wraps
        self._reach = max(self._size, 2 * BACKWARD * samples)  # apart at most, to agree
        self._rows = max(1, counting.wraps // (4 * samples))
        self.tracking = False
        self._begun = False
        self.newest = 0  # place of the newest believed frame
        self._phase = 0  # place less counter
        self._epoch = 0  # place less what markers and counter say by themselves
        self._time = 0  # of the newest believed frame, ns
        self._since = (0, 0)  # place and time at which this epoch began

    def counter(self, place: int) -> int:
        """Counter of a sample, as the controller gave it."""
        return (place - self._phase) % self._counting.wraps

    def near(self, counts: Whole, wraps: int) -> Whole:
        """Place of samples that another counter counts beside the leading one: the nearest to the newest."""
        places: Whole = self._nearest(counts, wraps)
        return places

    def place(self, counts: Whole, markers: Whole, times: Whole) -> Iterator[Placed | Resumed | Waiting]:
        """Place frames of the leading message.

        Parameters
        ----------
        counts : array, (rows,)
            Counter of the first sample of every frame.
        markers : array, (rows, any)
            Those that there are, in the order of ``Counting.ranges``.
        times : array, (rows,)
            When the frames came, ns.

        Yields
        ------
        Placed, Resumed or Waiting
            In the order of the rows; a Waiting is the last.
        """
        row, count = 0, len(counts)
        own, possible = self._own_places(counts, markers)
        while row < count:
            end = min(count, row + self._rows)
            if self.tracking and times[row] - self._time > self._ambiguous_after():
                self.tracking = False
            gaps = np.flatnonzero(np.diff(times[row:end]) > self._ambiguous_after())
            end = row + int(gaps[0]) + 1 if len(gaps) else end
            places, fits = self._candidates(counts[row:end], own[row:end], possible[row:end])
            misfits = np.flatnonzero(~fits)
            good = int(misfits[0]) if len(misfits) else end - row
            if good:
                newest = int(np.argmax(places[:good]))
                if places[newest] >= self.newest:
                    self.newest, self._time = int(places[newest]), int(times[row + newest])
                yield Placed(row, row + good, places[:good], np.ones(good, dtype=np.bool_))
                row += good
                continue
            end = min(count, row + _PATIENCE)
            _, fits = self._candidates(counts[row:end], own[row:end], possible[row:end])
            again = np.flatnonzero(fits)
            rest = row + int(again[0]) if len(again) else end
            said = self._confirm(row, rest, counts, own, possible, times)
            if said is not None:
                if said:
                    yield Resumed(row, said)
                continue
            if not len(again):
                if end == count:
                    yield Waiting(row)
                    return
                rest = row + 1  # as many as may wait do: the oldest fits nowhere
            yield Placed(row, rest, np.zeros(rest - row, np.int64), np.zeros(rest - row, np.bool_))
            row = rest

    def _own_places(self, counts: Whole, markers: Whole) -> tuple[Whole, Flags]:
        """What counter and markers say by themselves, and whether the plan has such a place."""
        possible = np.asarray(counts < self._counting.wraps)
        if not self._counting.ranges:
            return counts, possible
        number = markers[:, 0].copy()
        for values, most in zip(markers.T[1:], self._limits, strict=False):
            possible &= values < most
            number = number * most + values
        return number * self._unit + counts % self._unit, possible

    def _nearest(self, counts: Any, wraps: int) -> Any:
        apart = counts + self._phase - self.newest
        half = wraps // 2
        return self.newest + (apart + half) % wraps - half

    def _candidates(self, counts: Whole, own: Whole, possible: Flags) -> tuple[Whole, Flags]:
        """Place of every frame if the epoch goes on, and whether that fits."""
        if not self.tracking:
            return own, np.zeros(len(counts), dtype=np.bool_)
        places: Whole = self._nearest(counts, self._counting.wraps)
        fits = possible & (np.abs(places - self.newest) <= self._size)
        if self._counting.ranges:
            fits &= (places - self._epoch - own) % self._span == 0
        return places, fits

    def _confirm(
        self, row: int, rest: int, counts: Whole, own: Whole, possible: Flags, times: Whole
    ) -> str | None:
        """Believe frames that do not fit if enough of them agree; what is to be said of it, None if not."""
        rows = row + np.flatnonzero(possible[row:rest])
        for anchor in rows:
            alike = rows[
                (np.abs(own[rows] - own[anchor]) <= self._reach)
                & ((own[rows] - counts[rows] - own[anchor] + counts[anchor]) % self._counting.wraps == 0)
            ]
            agreeing = len(np.unique(own[alike]))
            if agreeing >= FORWARD:
                first = int(alike[np.argmin(own[alike])])
                said = self._resume(first, agreeing, counts, own, times)
                if said is not None:
                    return said
        return None

    def _resume(self, first: int, agreeing: int, counts: Whole, own: Whole, times: Whole) -> str | None:
        """Go on from a frame that is confirmed; what is to be said of it, or None to wait for more."""
        place = int(own[first])
        count, time = int(counts[first]), int(times[first])
        if not self._begun:
            self._begin(place, place, count, time)
            return ""
        elapsed = max(0, time - self._time)
        known = self.tracking or elapsed <= self._ambiguous_after()
        ahead = (place + self._epoch - self.newest) % self._span
        same_phase = (self.newest + ahead - count - self._phase) % self._counting.wraps == 0
        if known and same_phase and ahead <= self._speed() * elapsed * 1e-9 + 2 * self._size:
            self.tracking = True
            self._epoch = self.newest + ahead - place
            self.newest, self._time = self.newest + ahead, max(time, self._time)
            return ""
        if agreeing < BACKWARD:
            return None
        before, fresh = self.counter(self.newest), self.newest // self._realisation + 1
        self._begin(place, fresh * self._realisation + place % self._realisation, count, time)
        why = (
            "the controller began again" if known else f"after {elapsed * 1e-9:.1f} s the place could not be told"
        )
        return f"{why}: counter {count} after {before}; its frames count from realisation {fresh} on"

    def _begin(self, own: int, place: int, count: int, time: int) -> None:
        self.tracking = self._begun = True
        self._epoch, self._phase = place - own, place - count
        self.newest, self._time, self._since = place, time, (place, time)

    def _speed(self) -> float:
        """Samples a second that may have gone by: a rig may be played faster than it is."""
        begun, time = self._since
        lasted = (self._time - time) * 1e-9
        observed = (self.newest - begun) / lasted if lasted > 0 else 0.0
        return 1.25 * max(self._rate, observed)

    def _ambiguous_after(self) -> float:
        """Nanoseconds without a frame after which counter and markers may have come round."""
        return 0.5e9 * self._span / self._speed()
