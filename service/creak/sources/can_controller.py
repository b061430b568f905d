"""The other end of the bus: a controller that sends a rig's samples as frames, and what can happen to them."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from creak.records import Frame, Run
from creak.sources.can_frames import EXTENDED, CanFrames, checksum
from creak.sources.can_mapping import CanMapping, MappedPart
from creak.sources.dbc import MAX_BYTES, Message

_MARKERS = ("realisation", "experiment", "period")


class Controller:
    """Encodes period frames as CAN frames, message by message as the mapping says.

    Parameters
    ----------
    run : Run
    mapping : CanMapping
    first_counter : int
        Counter of the run's first sample: whole periods, or whole realisations if there are no markers.

    Raises
    ------
    ValueError
        If a period is no whole number of frames.
    """

    def __init__(self, run: Run, mapping: CanMapping, first_counter: int = 0) -> None:
        self._run = run
        self._mapping = mapping
        self._first = first_counter
        bringing = [part for part in mapping.parts if part.channels]
        least = min(part.samples for part in bringing)
        holders = {part.counted_by.message.name: part.counted_by.message for part in mapping.parts}
        leading = mapping.parts[mapping.leading].message
        holders[leading.name] = leading
        for part in bringing:
            holders.pop(part.message.name, None)
        self._sent: list[tuple[Message, int, MappedPart | None]] = [(m, least, None) for m in holders.values()]
        self._sent += [(part.message, part.samples, part) for part in bringing]
        for part in bringing:
            if run.rig.period_samples % part.samples:
                raise ValueError(
                    f"a period of {run.rig.period_samples} samples is no whole number of frames of {part.samples}"
                )

    def frames(self, frame: Frame, index: int) -> CanFrames:
        """Encode one period.

        Parameters
        ----------
        frame : Frame
        index : int
            How many periods the controller has played before: the counter goes on from there.

        Returns
        -------
        CanFrames
            In the order in which they leave; a frame leaves when its last sample has been taken.
        """
        pieces = [self._messages(message, samples, part, frame, index) for message, samples, part in self._sent]
        whole = pieces[0]
        for more in pieces[1:]:
            whole = whole + more
        # SYNC and marker messages stand first among those that leave together.
        return whole[np.argsort(whole.times, kind="stable")]

    def _messages(
        self, message: Message, samples: int, part: MappedPart | None, frame: Frame, index: int
    ) -> CanFrames:
        """All frames of one message in one period."""
        rig = self._run.rig
        at = np.arange(0, rig.period_samples, samples)
        data = np.zeros((len(at), MAX_BYTES), dtype=np.uint8)
        payload = data[:, : message.length]
        if part is not None:
            self._write_samples(payload, part, frame)
        counted = next((p.counted_by for p in self._mapping.parts if p.counted_by.message is message), None)
        if counted is not None:
            counts = self._first + index * rig.period_samples + at + counted.offset
            counts = counts % counted.wraps // counted.factor
            counted.signal.put_bits(payload, counts.astype(np.uint64))
        if message is self._mapping.parts[self._mapping.leading].message:
            for name, signal in zip(_MARKERS, self._mapping.markers, strict=False):
                value = getattr(frame, name) % signal.range
                signal.put_bits(payload, np.full(len(at), value, dtype=np.uint64))
        self._write_checksum(payload, message)
        identifier = message.identifier | (EXTENDED if message.extended else 0)
        return CanFrames(
            np.full(len(at), identifier, np.uint32),
            frame.time + np.rint((at + samples - 1) * (1e9 / rig.sample_rate)).astype(np.int64),
            np.full(len(at), message.length, np.uint8),
            data,
        )

    def _write_samples(self, payload: NDArray[np.uint8], part: MappedPart, frame: Frame) -> None:
        values = np.concatenate((frame.u, frame.y))
        clipped = np.zeros(len(payload), dtype=np.bool_)
        for condition in part.conditions:
            condition.signal.put_bits(payload, np.full(len(payload), condition.values[0], dtype=np.uint64))
        for channel, signals in zip(part.channels, part.signals, strict=True):
            for sample, signal in enumerate(signals):
                clipped |= signal.put(payload, values[channel, sample :: part.samples])
        for signal in part.valid:
            signal.put_bits(payload, (~clipped).astype(np.uint64))

    def _write_checksum(self, payload: NDArray[np.uint8], message: Message) -> None:
        signal = self._mapping.checksums.get(message.name)
        if signal is not None:
            sums = [checksum(row.tobytes(), signal.length) for row in payload]
            signal.put_bits(payload, np.asarray(sums, dtype=np.uint64))


KINDS: Final = ("lost", "doubled", "delayed", "reordered", "corrupted")


@dataclass(frozen=True)
class Disturbances:
    """What happens to frames on their way.

    Parameters
    ----------
    lost, doubled, delayed, reordered, corrupted : float
        Probability for a frame.
    delay : float
        Seconds that a delayed frame is late.
    jitter : float
        Standard deviation of the delay of all frames, s.
    drift_ppm : float
        By how much the controller's clock is slow, parts per million.
    """

    lost: float = 0.0
    doubled: float = 0.0
    delayed: float = 0.0
    reordered: float = 0.0
    corrupted: float = 0.0
    delay: float = 0.02
    jitter: float = 0.0
    drift_ppm: float = 0.0


class DisturbedWay:
    """Applies disturbances to a stream of frames and keeps a record of what it did.

    Parameters
    ----------
    disturbances : Disturbances
    seed : int
    """

    def __init__(self, disturbances: Disturbances, seed: int = 0) -> None:
        self._what = disturbances
        self._rng = np.random.default_rng(seed)
        self._late = CanFrames.none()
        self._begin: int | None = None
        self.injected = dict.fromkeys(KINDS, 0)

    def send(self, frames: CanFrames) -> tuple[CanFrames, NDArray[np.uint8]]:
        """Disturb a batch.

        Returns
        -------
        CanFrames
            What leaves, in order of time; what is late comes with a later batch.
        array of uint8, (frames given,)
            What was done to every frame given: 0 nothing, else 1 + index into `KINDS`.
        """
        what, rng, count = self._what, self._rng, len(frames)
        shares = np.cumsum([getattr(what, kind) for kind in KINDS])
        done = np.searchsorted(shares, rng.random(count), side="right") + 1
        done[done > len(KINDS)] = 0
        times = frames.times
        if what.drift_ppm:
            self._begin = int(times[0]) if self._begin is None and count else self._begin
            begin = self._begin or 0
            times = begin + np.rint((times - begin) * (1 + what.drift_ppm * 1e-6)).astype(np.int64)
        if what.jitter:
            times = times + np.abs(np.rint(rng.standard_normal(count) * what.jitter * 1e9)).astype(np.int64)
        times = times + np.where(done == 3, round(what.delay * 1e9), 0)
        if count > 1:  # behind the next frame
            times = times + np.where(done == 4, round(1.5 * float(np.median(np.diff(frames.times)))), 0)
        data = frames.data.copy()
        for row in np.flatnonzero(done == 5):
            for bit in rng.choice(8 * int(frames.lengths[row]), size=int(rng.integers(1, 4)), replace=False):
                data[row, bit // 8] ^= np.uint8(1 << (bit % 8))
        for code, kind in enumerate(KINDS, start=1):
            self.injected[kind] += int(np.count_nonzero(done == code))
        moved = CanFrames(frames.identifiers, times, frames.lengths, data)
        copies = np.repeat(np.arange(count), np.where(done == 1, 0, np.where(done == 2, 2, 1)))
        waiting = self._late + moved[copies]
        order = np.argsort(waiting.times, kind="stable")
        waiting = waiting[order]
        until = int(np.searchsorted(waiting.times, frames.times[-1], side="right")) if count else 0
        if not (what.jitter or what.drift_ppm or what.delayed or what.reordered):
            until = len(waiting)
        self._late = waiting[until:]
        return waiting[:until], done.astype(np.uint8)

    def rest(self) -> CanFrames:
        """What is still under way."""
        late, self._late = self._late, CanFrames.none()
        return late


def quantised(frame: Frame, mapping: CanMapping) -> Frame:
    """The period as it arrives: with the resolution that the DBC gives every channel."""
    values = np.concatenate((frame.u, frame.y))
    for part in mapping.parts:
        for channel, signals in zip(part.channels, part.signals, strict=True):
            for sample, signal in enumerate(signals):
                chosen = values[channel, sample :: part.samples]
                data = np.zeros((len(chosen), MAX_BYTES), dtype=np.uint8)
                signal.put(data, chosen)
                values[channel, sample :: part.samples] = signal.values(data)
    q = len(frame.u)
    return Frame(frame.realisation, frame.experiment, frame.period, frame.time, values[:q], values[q:])


def played(
    frames: Iterable[Frame], controller: Controller, way: DisturbedWay
) -> Iterator[tuple[Frame, CanFrames, NDArray[np.uint8]]]:
    """Every period with the frames that leave in its time and what was done to its own."""
    for index, frame in enumerate(frames):
        sent, done = way.send(controller.frames(frame, index))
        yield frame, sent, done
