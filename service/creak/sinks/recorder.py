"""Records into MCAP files, in chunks that outlive the process, in parts that each replay by themselves."""

import contextlib
import os
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, cast

from mcap.writer import CompressionType, IndexType, Writer

from creak import codec
from creak.config.rig import rig_toml
from creak.digests import Digest, Outcome
from creak.errors import StorageError
from creak.records import (
    AlarmChange,
    Counts,
    Estimate,
    Fault,
    FaultKind,
    Frame,
    FrameStatus,
    NodeLevel,
    Run,
    RunEnd,
    RunStatus,
    Scope,
)
from creak.sinks.wholewrites import WholeWrites

_CHUNK_BYTES = 1 << 20

# Doubles of a vibration hardly compress. On a period of six channels of 16384 samples, noise or multisine, zstd
# takes 4 % off the size and doubles the work: 3.2 ms of processor time instead of 1.6 to record it, 1.3 ms instead
# of 0.6 to read it.
_COMPRESSION = CompressionType.NONE

_LONGEST_RESUME_SECONDS = 600.0

# All but that of attachments: there are none, and an index of nothing is an error by the specification.
_INDEXES = IndexType.CHUNK | IndexType.MESSAGE | IndexType.METADATA


class Recorder:
    """Sink that writes everything which crosses the monitor into a recording.

    Chunks reach the operating system within `flush_seconds` (if it is ticked at least every half of that) and at
    each completed realisation and alarm change, the disk at each completed realisation. Beyond `max_bytes` or
    `max_seconds` the recording goes on in a new part at the next realisation, so that every part holds whole
    realisations; each opens with the run and its part number and ends with an end record of its own.

    Parameters
    ----------
    target : Path
        A directory, in which the file is named after rig and run and never replaces another; else the file itself,
        which is overwritten. Where a limit is given the parts are NAME-0001.mcap, NAME-0002.mcap and so on.
    max_bytes : int or None
        Size after which a part ends.
    max_seconds : float or None
        Recorded time after which a part ends; recorded, so that a part covers the same stretch of a rig's life
        however fast it is simulated or replayed.
    flush_seconds : float
        Longest time that a record stays in memory.
    resume_seconds : float
        How long after a failure the recording is tried again at first; each further time takes twice as long.

    Attributes
    ----------
    paths : list of Path
        Files written so far, in order.
    cut : set of Path
        Those of them that a failure ended.
    failure : StorageError or None
        Why recording stopped before its end.

    Notes
    -----
    Every method that writes raises StorageError once the disk is full or fails. The file then ends with its last
    whole record and can be read, and every further record is refused with the same error. Where parts have numbers
    the recording goes on in a new one, at the first realisation for which there is room again.
    """

    def __init__(
        self,
        target: Path,
        *,
        max_bytes: int | None = None,
        max_seconds: float | None = None,
        flush_seconds: float = 1.0,
        resume_seconds: float = 10.0,
    ) -> None:
        self.paths: list[Path] = []
        self.cut: set[Path] = set()
        self.failure: StorageError | None = None
        self._target = target
        self._max_bytes = max_bytes
        self._max_seconds = max_seconds
        self._flush_seconds = flush_seconds
        self._run: Run | None = None
        self._part: _Part | None = None
        self._newest = -1  # realisation, of the frames that counted
        self._flushed_at = float("-inf")
        self._now = 0.0  # of the last tick
        self._number = 1
        self._resume_seconds = self._pause = resume_seconds  # the latter doubles with every failure
        self._resume_at = float("inf")

    @property
    def path(self) -> Path | None:
        """File that is being written, or was written last."""
        return self.paths[-1] if self.paths else None

    def open(self, run: Run) -> None:
        """Begin the recording: its first part with the run in it is on the disk when this returns."""
        self._run = run
        self._begin(run, 1)

    def take(self, record: Outcome) -> None:
        """Record one thing, in a new part if it is the first of a realisation and a limit is passed."""
        if isinstance(record, Digest):  # of a realisation that is recorded: somebody may ask for it again
            part = self._writable()
            with self._storing():
                part.end_realisation(record.block is not None or bool(record.frames))
            return
        realisation = _begun_by(record)
        if realisation > self._newest:
            if self.failure is not None:
                self._resume()
            elif self._newest >= 0 and self._is_full(record.time):
                self._rotate()
            self._newest = realisation
        part = self._writable()
        with self._storing():
            part.write(record)
            if isinstance(record, Estimate) and record.scope is Scope.RUN:
                part.flush()
                part.sync()
            elif isinstance(record, AlarmChange):
                part.flush()

    def tick(self, now: float) -> None:
        """Flush what has waited for half of the time that it may, so that the rest is left to the next tick."""
        part, self._now = self._part, now
        if part is not None and part.pending and now - self._flushed_at >= self._flush_seconds / 2:
            with self._storing():
                part.flush()
            self._flushed_at = now

    def close(self, end: RunEnd) -> None:
        """Write the end of the run and close the file; nothing remains to be done if recording has failed."""
        if self._part is not None:
            self._finish(self._part, codec.Closing(end))

    def _writable(self) -> "_Part":
        if self.failure is not None:
            raise self.failure
        if self._part is None:
            raise RuntimeError("a recorder takes records between open and close")
        return self._part

    def _is_full(self, time: int) -> bool:
        part = self._writable()
        too_big = self._max_bytes is not None and part.size >= self._max_bytes
        return too_big or (self._max_seconds is not None and time - part.begin >= self._max_seconds * 1e9)

    def _rotate(self) -> None:
        part = self._writable()
        end = RunEnd(part.end, RunStatus.COMPLETED, part.counts(), "the run goes on in the next part")
        self._finish(part, codec.Closing(end, continues=True))
        self._number += 1
        self._begin(part.opening.run, self._number)
        self._pause = self._resume_seconds  # a whole part: the disk is in order

    def _resume(self) -> None:
        """Begin a new part after a failure, if it is time; one that cannot be written leaves nothing behind."""
        if self._run is None or not self._numbered or self._now < self._resume_at:
            return
        written, self.failure = len(self.paths), None
        try:
            self._begin(self._run, self._number + 1)
        except StorageError:
            for path in self.paths[written:]:
                path.unlink(missing_ok=True)
                self.cut.discard(path)
            del self.paths[written:]
            raise
        self._number += 1

    @property
    def _numbered(self) -> bool:
        return self._max_bytes is not None or self._max_seconds is not None

    def _begin(self, run: Run, number: int) -> None:
        named = self._target.is_dir()
        path = self._target / f"{recording_name(run.rig.name, run.id)}.mcap" if named else self._target
        if self._numbered:
            path = path.with_name(f"{path.stem}-{number:04d}{path.suffix}")
        with self._storing(path):
            file = WholeWrites(path, os.O_EXCL if named else os.O_TRUNC)
            self.paths.append(path)
            self._part = _Part(file, codec.Opening(run, number))
            self._part.open()

    def _finish(self, part: "_Part", closing: codec.Closing) -> None:
        with self._storing():
            part.close(closing)
            self._part = None

    @contextlib.contextmanager
    def _storing(self, opened: Path | None = None) -> Iterator[None]:
        """Turn what the system says about the file into a StorageError, and end the recording with it."""
        try:
            yield
        except OSError as error:
            if self._part is not None:
                self._part.abandon()
                self._part = None
            if self.path is not None:
                self.cut.add(self.path)
            happened = "cannot be written" if opened else "recording stopped; what is in it until then can be read"
            self.failure = StorageError(f"{opened or self.path}: {happened}: {error.strerror}")
            self._resume_at = self._now + self._pause
            self._pause = min(2 * self._pause, _LONGEST_RESUME_SECONDS)
            raise self.failure from error


class _Part:
    """One file of a recording."""

    def __init__(self, file: "WholeWrites", opening: codec.Opening) -> None:
        self.opening = opening
        self.pending = False
        self.begin = self.end = opening.run.start
        self._file = file
        self._waiting = 0  # bytes of messages that the file does not hold yet
        self._frames: Counter[FrameStatus] = Counter()
        self._faults: Counter[str] = Counter()
        self._realisations = 0
        self._channels: dict[str, int] = {}
        self._writer = Writer(
            cast("IO[Any]", file), chunk_size=_CHUNK_BYTES, compression=_COMPRESSION, index_types=_INDEXES
        )

    @property
    def size(self) -> int:
        """Bytes, those that are not flushed included."""
        return self._file.tell() + self._waiting

    def open(self) -> None:
        run = self.opening.run
        self._writer.start(codec.PROFILE, f"creak {run.software}".strip())
        self._writer.add_metadata("creak", self._metadata())
        topics = codec.topics(run.rig)
        schemas = {
            message: self._writer.register_schema(codec.full_name(message), codec.ENCODING, codec.DESCRIPTOR_SET)
            for message in dict.fromkeys((*codec.TOPICS.values(), codec.TREND))
        }
        for topic, message in topics.items():
            self._channels[topic] = self._writer.register_channel(topic, codec.ENCODING, schemas[message])
        for message, schema in codec.view_schemas().items():
            schemas[message] = self._writer.register_schema(message, codec.ENCODING, schema)
        for topic, message in codec.view_topics(run.rig).items():
            self._channels[topic] = self._writer.register_channel(topic, codec.ENCODING, schemas[message])
        self._add("/run", run.start, codec.encode(self.opening))
        self._view(self.opening, run.start)
        self.flush()
        self.sync()
        self._file.sync_name()

    def write(self, record: Frame | Fault | Estimate | AlarmChange) -> None:
        self._note(record)
        self._add(_TOPIC[type(record)], record.time, codec.encode(record))
        if isinstance(record, Estimate) and record.scope is Scope.WINDOW:
            for level in record.nodes:
                self._trend(level, record.time)
        self._view(record, record.time)

    def end_realisation(self, complete: bool) -> None:
        self._realisations += complete
        self.flush()
        self.sync()

    def flush(self) -> None:
        """Finish the chunk and hand it to the operating system."""
        self._writer.flush()  # type: ignore[no-untyped-call]
        self.pending, self._waiting = False, 0

    def sync(self) -> None:
        """Have the disk hold what was flushed."""
        self._file.sync()

    def close(self, closing: codec.Closing) -> None:
        self._add("/end", closing.end.time, codec.encode(closing))
        self._view(closing, closing.end.time)
        self.flush()
        end = closing.end
        told = {"status": end.status.value, "frames": str(end.counts.frames), "message": end.message}
        self._writer.add_metadata("creak", self._metadata() | told | codec.closing_text(closing))
        self._writer.finish()  # type: ignore[no-untyped-call]
        self.sync()
        self._file.close()

    def abandon(self) -> None:
        """Close the file as it stands."""
        self._file.close()

    def counts(self) -> Counts:
        """Count what the part holds: frames as they were judged, and realisations that gave an estimate."""
        return Counts(
            frames=self._frames[FrameStatus.ACCEPTED],
            rejected_frames=self._frames[FrameStatus.REJECTED],
            transient_frames=self._frames[FrameStatus.TRANSIENT],
            realisations=self._realisations,
            experiments=self._realisations * self.opening.run.rig.q,
            faults=dict(self._faults),
        )

    def _note(self, record: Frame | Fault | Estimate | AlarmChange) -> None:
        if isinstance(record, Frame):
            if record.status is not FrameStatus.REJECTED:  # a refused frame may tell any time
                if not (self._frames[FrameStatus.ACCEPTED] or self._frames[FrameStatus.TRANSIENT]):
                    self.begin = record.time
                self.end = max(self.end, record.time)
            self._frames[record.status] += 1
        elif isinstance(record, Fault):
            self._faults[record.kind.value] += 1
        elif isinstance(record, Estimate) and record.scope is Scope.RUN:
            self._realisations += 1
            self.end = max(self.end, record.time)

    def _trend(self, level: NodeLevel, time: int) -> None:
        topic = codec.level_topic(level.name)
        if topic in self._channels:
            self._add(topic, time, codec.encode(level))

    def _view(self, record: codec.Viewed, time: int) -> None:
        for topic, data in codec.views(record, self.opening.run.rig):
            self._add(topic, time, data)

    def _add(self, topic: str, time: int, data: bytes) -> None:
        stamp = max(time, 0)  # MCAP knows no time before the epoch; the record itself keeps its own
        before = self._file.tell()
        self._writer.add_message(self._channels[topic], stamp, data, stamp)
        self.pending = self._file.tell() == before  # else the message filled its chunk, which is written
        self._waiting = self._waiting + len(data) if self.pending else 0

    def _metadata(self) -> dict[str, str]:
        run = self.opening.run
        excitation = run.excitation
        return {
            "format": str(codec.FORMAT),
            "software": run.software,
            "run": run.id,
            "part": str(self.opening.part),
            "rig": run.rig.name,
            "rig.toml": rig_toml(run.rig),
            "start": codec.time_json(run.start),
            "source": run.source,
            "excitation": excitation.kind,
            "rms": "" if excitation.rms is None else repr(excitation.rms),
            "seed": "" if excitation.seed is None else str(excitation.seed),
        } | codec.opening_text(self.opening)


_TOPIC: dict[type, str] = {Frame: "/frames", Fault: "/faults", Estimate: "/estimates", AlarmChange: "/alarms"}


def _begun_by(record: Frame | Fault | Estimate | AlarmChange) -> int:
    """Realisation that a record may be the first of; -1 for what opens none.

    A refused frame may carry any index, so it opens none.
    """
    if isinstance(record, Frame) and record.status is not FrameStatus.REJECTED:
        return record.realisation
    if isinstance(record, Fault) and record.kind is FaultKind.LOST and record.realisation is not None:
        return record.realisation
    return -1


def recording_name(rig: str, run: str) -> str:
    """Name of the file of a run's recording, without part number and suffix."""
    name = run if run.startswith(rig) else f"{rig}-{run}"
    return re.sub(r"[^\w.-]+", "_", name, flags=re.ASCII).lstrip(".") or "recording"
