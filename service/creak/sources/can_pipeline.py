"""CAN frames in, period frames and faults out: checked, decoded, placed, assembled. No bus, no clock."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from creak.counters import Placed, Resumed, Tracker
from creak.periods import Assembler, Part
from creak.records import Fault, FaultKind, Frame, Run
from creak.sources.can_frames import EXTENDED, CanFrames, checksums_agree
from creak.sources.can_mapping import CanMapping, MappedPart

Whole = NDArray[np.int64]

_BATCH = 4096  # frames that are decoded at once
_HELD = 8192  # frames that may wait until their place is confirmed


class CanPipeline:
    """Turns the frames of one rig into period frames, exactly or not at all.

    Parameters
    ----------
    run : Run
    mapping : CanMapping
    patience : float
        Periods that a frame may be late.
    """

    def __init__(self, run: Run, mapping: CanMapping, patience: float = 0.5) -> None:
        self._run = run
        self._mapping = mapping
        leading = mapping.parts[mapping.leading]
        self._tracker = Tracker(run, mapping.counting, leading.samples)
        # A part without channels counts and marks, but no period waits for it.
        self._assembled = [index for index, part in enumerate(mapping.parts) if part.channels]
        size = run.rig.period_samples
        self._assembler = Assembler(
            run,
            [
                Part(mapping.parts[i].message.name, mapping.parts[i].channels, mapping.parts[i].samples)
                for i in self._assembled
            ],
            min(size - 1, max(1, round(patience * size))),
            self._tracker.counter,
        )
        self._identifiers = {
            part.message.identifier | (EXTENDED if part.message.extended else 0): part.message
            for part in mapping.parts
        }
        for part in mapping.parts:
            holder = part.counted_by.message
            self._identifiers[holder.identifier | (EXTENDED if holder.extended else 0)] = holder
        self._held = CanFrames.none()
        self._synced: dict[str, int] = {}  # newest count of a SYNC message, by its name
        self.foreign = 0
        """Frames of other messages, which are none of ours."""

    def push(self, frames: CanFrames) -> Iterator[Frame | Fault]:
        """Take frames in the order in which they came and yield what follows.

        Yields
        ------
        Frame or Fault
        """
        for begin in range(0, len(frames), _BATCH):
            yield from self._batch(frames[begin : begin + _BATCH])

    def finish(self) -> Iterator[Frame | Fault]:
        """Yield faults for the periods that were left open."""
        if len(self._held):
            yield Fault(
                FaultKind.OUT_OF_PLAN,
                int(self._held.times[0]),
                f"{len(self._held)} frames at the end fit nowhere: nothing confirms their counters",
            )
        yield from self._assembler.stop()

    def _batch(self, frames: CanFrames) -> Iterator[Frame | Fault]:
        faults: list[Fault] = []
        frames = self._sound(frames, faults)
        yield from faults
        if len(self._held):
            frames = self._held + frames
            self._held = CanFrames.none()
        mapping = self._mapping
        leading = mapping.parts[mapping.leading]
        rows = self._rows(frames, leading)
        data = frames.data[rows, : leading.message.length]
        counts = leading.counted_by.samples(data) - leading.counted_by.offset
        markers = np.empty((len(rows), len(mapping.markers)), dtype=np.int64)
        for column, signal in enumerate(mapping.markers):
            markers[:, column] = signal.raw(data)
        done = 0  # frames up to here have been dealt with
        for step in self._tracker.place(counts % leading.counted_by.wraps, markers, frames.times[rows]):
            if isinstance(step, Resumed):
                yield from self._assembler.stop()
                yield Fault(FaultKind.RESTARTED, int(frames.times[rows[step.row]]), step.message)
            elif isinstance(step, Placed):
                upto = int(rows[step.end]) if step.end < len(rows) else len(frames)
                yield from self._misplaced(step, rows, counts, frames)
                good = np.arange(step.begin, step.end)[step.believed]
                yield from self._fill(frames, done, upto, (rows[good], step.first[step.believed]))
                done = upto
            else:
                done = int(rows[step.row])
                self._held = frames[done:][-_HELD:]
                return
        if len(rows) == 0 and len(frames):
            if self._tracker.tracking:
                yield from self._fill(frames, 0, len(frames), (rows, rows.astype(np.int64)))
            else:
                self._held = frames[-_HELD:]

    def _sound(self, frames: CanFrames, faults: list[Fault]) -> CanFrames:
        """Leave out frames of others, and those that are too short or have a wrong checksum."""
        keep = np.zeros(len(frames), dtype=np.bool_)
        for identifier, message in self._identifiers.items():
            rows = np.flatnonzero(frames.identifiers == identifier)
            if not len(rows):
                continue
            sound = frames.lengths[rows] >= message.length
            faults += [
                _corrupted(
                    frames.times[row],
                    f"a frame of {message.name} has {frames.lengths[row]} bytes, should have {message.length}",
                )
                for row in rows[~sound]
            ]
            signal = self._mapping.checksums.get(message.name)
            if signal is not None:
                agree = checksums_agree(signal, frames.data[rows, : message.length])
                faults += [
                    _corrupted(
                        frames.times[row],
                        f"a frame of {message.name} does not agree with its checksum {signal.name}",
                    )
                    for row in rows[sound & ~agree]
                ]
                sound &= agree
            keep[rows[sound]] = True
        known = np.isin(frames.identifiers, list(self._identifiers))
        self.foreign += int(len(frames) - known.sum())
        return frames if keep.all() else frames[keep]

    def _rows(self, frames: CanFrames, part: MappedPart) -> NDArray[np.intp]:
        """Rows of the frames that carry a part."""
        identifier = part.message.identifier | (EXTENDED if part.message.extended else 0)
        rows = np.flatnonzero(frames.identifiers == identifier)
        for condition in part.conditions:
            raw = condition.signal.raw(frames.data[rows])
            rows = rows[np.isin(raw, condition.values)]
        return rows

    def _misplaced(
        self, step: Placed, rows: NDArray[np.intp], counts: Whole, frames: CanFrames
    ) -> Iterator[Fault]:
        name = self._mapping.parts[self._mapping.leading].message.name
        for row in np.arange(step.begin, step.end)[~step.believed]:
            yield Fault(
                FaultKind.OUT_OF_PLAN,
                int(frames.times[rows[row]]),
                f"a frame of {name} with counter {counts[row]} fits nowhere: "
                f"{self._tracker.counter(self._tracker.newest)} came before, and no others confirm it",
            )

    def _fill(
        self, frames: CanFrames, begin: int, end: int, led: tuple[NDArray[np.intp], Whole]
    ) -> Iterator[Frame | Fault]:
        """Hand every part's frames of a stretch to the assembler; the leading ones are placed already."""
        stretch = frames[begin:end]
        for number, index in enumerate(self._assembled):
            part = self._mapping.parts[index]
            if index == self._mapping.leading:
                rows, first = led[0] - begin, led[1]
            else:
                rows, first = self._placed_beside(stretch, part)
            if not len(rows):
                continue
            values = self._decoded(stretch.data[rows, : part.message.length], part)
            yield from self._assembler.push(number, first, values, stretch.times[rows])
        yield from self._assembler.advance()

    def _placed_beside(self, frames: CanFrames, part: MappedPart) -> tuple[NDArray[np.intp], Whole]:
        """Rows of a part that does not lead, and the places of their first samples."""
        counted = part.counted_by
        rows = self._rows(frames, part)
        if counted.message.name == part.message.name:
            counts = counted.samples(frames.data[rows, : part.message.length])
        else:
            counts, rows = self._synchronous(frames, rows, part)
        first = self._tracker.near(counts - counted.offset, counted.wraps)
        near = np.abs(first - self._tracker.newest) <= self._run.rig.period_samples
        return rows[near], first[near]

    def _synchronous(
        self, frames: CanFrames, rows: NDArray[np.intp], part: MappedPart
    ) -> tuple[Whole, NDArray[np.intp]]:
        """Counts of the last SYNC message before each of the rows."""
        sync = part.counted_by.message
        identifier = sync.identifier | (EXTENDED if sync.extended else 0)
        at = np.flatnonzero(frames.identifiers == identifier)
        values = part.counted_by.samples(frames.data[at, : sync.length])
        before = np.searchsorted(at, rows) - 1
        known = self._synced.get(part.message.name)
        if len(at):
            self._synced[part.message.name] = int(values[-1])
        if known is None:
            rows, before = rows[before >= 0], before[before >= 0]
        values = np.concatenate((values, [0 if known is None else known]))  # the last is that before the stretch
        return values[before], rows

    def _decoded(self, data: NDArray[np.uint8], part: MappedPart) -> NDArray[np.float64]:
        """Values, ``(channels, frames, samples)``; NaN where the frame says that they are not valid."""
        values = np.empty((len(part.channels), len(data), part.samples))
        for row, signals in enumerate(part.signals):
            for sample, signal in enumerate(signals):
                values[row, :, sample] = signal.values(data)
        for signal in part.valid:
            values[:, signal.raw(data) == 0, :] = np.nan
        return values


def _corrupted(time: np.int64, message: str) -> Fault:
    return Fault(FaultKind.CORRUPTED, int(time), message)
