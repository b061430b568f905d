"""Placed samples of several messages in, whole period frames out; says what was lost, came twice or too late.

A period is delivered once every message has filled it, however the frames were reordered or delayed meanwhile.
It is given up when frames of the next period have come for longer than the patience: then it is lost, named with
the counters that are missing, and no part of it is used.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from creak.records import Fault, FaultKind, Frame, Real, Run

Whole = NDArray[np.int64]
_NAMED = 64  # lost periods that are named one by one after a gap


@dataclass(frozen=True)
class Part:
    """What one message brings.

    Parameters
    ----------
    name : str
        Of the message.
    channels : tuple of int
        Inputs 0 to q - 1, then responses.
    samples : int
        Consecutive samples in a frame.
    """

    name: str
    channels: tuple[int, ...]
    samples: int


@dataclass
class _Open:
    """A period that is being filled."""

    values: Real  # (q + n, N)
    filled: NDArray[np.bool_]  # (parts, N)
    missing: int
    time: float = np.inf  # recorded time of the first sample, by the frame that was delayed least
    spoilt: str = ""


class Assembler:
    """Fills periods with placed samples.

    Parameters
    ----------
    run : Run
    parts : sequence of Part
        Together they bring every channel once.
    patience : int
        Samples of the next period that may come before an incomplete one is given up; less than N.
    counter_of : callable
        Counter that the controller gave a sample, for the messages of faults.
    """

    def __init__(
        self, run: Run, parts: Sequence[Part], patience: int, counter_of: Callable[[int], int] = int
    ) -> None:
        self._run = run
        self._size = run.rig.period_samples
        self._parts = parts
        self._patience = patience
        self._counter_of = counter_of
        self._open: dict[int, _Open] = {}
        self._next: int | None = None  # index of the period that is to be delivered next
        self._delivered = -1  # the last one that was delivered whole
        self._frontier = 0

    def push(self, part: int, first: Whole, values: Real, times: Whole) -> list[Fault]:
        """Take frames of one message.

        Parameters
        ----------
        part : int
            Index of the message's part.
        first : array, (frames,)
            Place of every frame's first sample in the run.
        values : array, (channels, frames, samples)
        times : array, (frames,)
            When they came, ns since the Unix epoch.

        Returns
        -------
        list of Fault
            ``doubled`` and ``late`` for what could not be used.
        """
        faults: list[Fault] = []
        if len(first) == 0:
            return faults
        samples = self._parts[part].samples
        places = (first[:, None] + np.arange(samples)).ravel()
        flat = values.reshape(len(values), -1)
        # A frame leaves when its last sample has been taken.
        begun = np.repeat(times - (samples - 1) * 1e9 / self._run.rig.sample_rate - first * self._tick, samples)
        if np.any(np.diff(places) <= 0):
            faults += self._repeated_at_once(part, places, flat)
            places, kept = np.unique(places, return_index=True)
            flat, begun = flat[:, kept], begun[kept]
        if self._next is None:
            self._next = int(places[0]) // self._size
        self._frontier = max(self._frontier, int(places[-1]) + 1)
        for index in range(int(places[0]) // self._size, int(places[-1]) // self._size + 1):
            low, high = np.searchsorted(places, (index * self._size, (index + 1) * self._size))
            if low < high:
                faults += self._fill(index, part, places[low:high], flat[:, low:high], begun[low:high])
        return faults

    def advance(self) -> Iterator[Frame | Fault]:
        """Yield the periods that have become whole, and faults for those that are given up."""
        while self._next is not None:
            current = self._open.get(self._next)
            whole = current is not None and not current.missing
            if not whole and self._frontier < (self._next + 1) * self._size + self._patience:
                return
            if current is None and not self._open:
                ahead = self._frontier // self._size
            else:
                ahead = min(self._open)
            if current is None and ahead - self._next > _NAMED:
                yield self._lost_many(ahead)
                self._next = ahead
                continue
            yield self._close(self._next)
            self._next += 1

    def stop(self) -> Iterator[Frame | Fault]:
        """Give up what is open: the run ends, or another epoch begins."""
        for index in sorted(self._open):
            yield self._close(index)
        self._open.clear()
        self._next = None

    @property
    def _tick(self) -> float:
        return 1e9 / self._run.rig.sample_rate

    def _fill(self, index: int, part: int, places: Whole, flat: Real, begun: Real) -> list[Fault]:
        assert self._next is not None
        if index < self._next:
            kind = FaultKind.DOUBLED if index <= self._delivered else FaultKind.LATE
            text = "came again after their period was whole" if kind is FaultKind.DOUBLED else "came too late"
            return [self._unused(kind, part, places, text)]
        slot = self._open.get(index)
        if slot is None:
            rig = self._run.rig
            slot = self._open[index] = _Open(
                np.empty((rig.q + rig.n, self._size)),
                np.zeros((len(self._parts), self._size), dtype=np.bool_),
                len(self._parts) * self._size,
            )
        at = places - index * self._size
        filled = slot.filled[part]
        faults = []
        rows = np.asarray(self._parts[part].channels, dtype=np.intp)
        again = filled[at]
        if again.any():
            same = np.array_equal(slot.values[rows[:, None], at[again]], flat[:, again], equal_nan=True)
            text = "came a second time; the first ones count"
            if not same:
                text = "came a second time with other values, so their period is lost"
                slot.spoilt = f"samples of {self._parts[part].name} came twice with different values"
            faults.append(self._unused(FaultKind.DOUBLED, part, places[again], text))
            at, flat, begun = at[~again], flat[:, ~again], begun[~again]
        if len(at):
            if at[-1] - at[0] + 1 == len(at):  # without a hole, which is the rule: slices are faster
                span = slice(int(at[0]), int(at[-1]) + 1)
                for row, values in zip(rows, flat, strict=True):
                    slot.values[row, span] = values
                filled[span] = True
            else:
                slot.values[rows[:, None], at] = flat
                filled[at] = True
            slot.missing -= len(at)
            slot.time = min(slot.time, float(begun.min()) + index * self._size * self._tick)
        return faults

    def _repeated_at_once(self, part: int, places: Whole, flat: Real) -> list[Fault]:
        """Name samples that stand twice in one push; different values spoil their period."""
        order = np.argsort(places, kind="stable")
        again = np.flatnonzero(np.diff(places[order]) == 0)
        if not len(again):
            return []
        twice = places[order][again]
        faults = [self._unused(FaultKind.DOUBLED, part, twice, "came a second time; the first ones count")]
        same = np.all(
            (flat[:, order[again]] == flat[:, order[again + 1]]) | np.isnan(flat[:, order[again]]), axis=0
        )
        for index in np.unique(twice[~same] // self._size).tolist():
            empty = np.empty(0, dtype=np.int64)
            if self._next is None:
                self._next = index
            if index >= self._next:
                self._fill(index, part, empty, flat[:, :0], empty.astype(np.float64))
                self._open[index].spoilt = f"samples of {self._parts[part].name} came twice with different values"
        return faults

    def _unused(self, kind: FaultKind, part: int, places: Whole, text: str) -> Fault:
        low, high = int(places.min()), int(places.max())
        return Fault(
            kind,
            self._time_of(low),
            f"samples {self._counter_of(low)} to {self._counter_of(high)} of {self._parts[part].name} {text}",
        )

    def _close(self, index: int) -> Frame | Fault:
        """Deliver a period that is whole, or name what it lacks."""
        slot = self._open.pop(index, None)
        place, m, c, p = self._place(index)
        if slot is not None and not slot.missing and not slot.spoilt:
            self._delivered = index
            q = self._run.rig.q
            return Frame(m, c, p, round(slot.time), slot.values[:q], slot.values[q:])
        if slot is None:
            low, high = index * self._size, (index + 1) * self._size - 1
            why = f"samples {self._counter_of(low)} to {self._counter_of(high)} never came"
        elif slot.spoilt:
            why = slot.spoilt
        else:
            why = "; ".join(
                f"samples {self._ranges(index, ~slot.filled[k])} of {part.name} never came"
                for k, part in enumerate(self._parts)
                if not slot.filled[k].all()
            )
        time = self._time_of(index * self._size) if slot is None or slot.time == np.inf else round(slot.time)
        return Fault(FaultKind.LOST, time, f"{why}; {place} is lost", m, c, p)

    def _lost_many(self, ahead: int) -> Fault:
        assert self._next is not None
        first, last = self._place(self._next)[0], self._place(ahead - 1)[0]
        return Fault(
            FaultKind.LOST,
            self._time_of(self._next * self._size),
            f"{ahead - self._next} periods never came, from {first} to {last}",
        )

    def _ranges(self, index: int, missing: NDArray[np.bool_], most: int = 4) -> str:
        """Counters that are missing, as ranges."""
        edges = np.flatnonzero(np.diff(np.concatenate(([False], missing, [False])))).reshape(-1, 2)
        base = index * self._size
        named = [
            f"{self._counter_of(base + a)} to {self._counter_of(base + b - 1)}" for a, b in edges[:most].tolist()
        ]
        more = f" and {len(edges) - most} more stretches" if len(edges) > most else ""
        return ", ".join(named) + more

    def _time_of(self, place: int) -> int:
        """Recorded time of a sample, by the period that is open, else by the run's clock."""
        slot = self._open.get(place // self._size)
        if slot is not None and slot.time != np.inf:
            return round(slot.time + (place % self._size) * self._tick)
        if self._open:
            index, other = next(iter(self._open.items()))
            if other.time != np.inf:
                return round(other.time + (place - index * self._size) * self._tick)
        return self._run.start

    def _place(self, index: int) -> tuple[str, int, int, int]:
        experiment, period = divmod(index, self._run.periods)
        realisation, experiment = divmod(experiment, self._run.rig.q)
        text = f"period {period} of experiment {experiment} of realisation {realisation}"
        return text, realisation, experiment, period
