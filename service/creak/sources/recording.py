"""Recordings as a source: the same frames, bit for bit, as far as the file is whole."""

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import IO, cast

from mcap.records import Channel, Header, Message, Metadata, Schema

from creak import codec
from creak.alarm_records import Action, Clock
from creak.alarms import action_of
from creak.errors import RecordingError
from creak.records import AlarmChange, Estimate, Fault, FaultKind, Frame, FrameStatus, Run, RunEnd
from creak.sources.salvage import Gap, Whole, is_mcap, salvage

# What a source or the worker reports; every other fault is the monitor's finding, which a replay finds again.
_REPORTED = {
    FaultKind.LOST,
    FaultKind.DAMAGED,
    FaultKind.STORAGE,
    FaultKind.CORRUPTED,
    FaultKind.RESTARTED,
    FaultKind.SILENT,
    FaultKind.BUS_ERROR,
    FaultKind.BUS_OFF,
    FaultKind.DISCONNECTED,
}
_OF_SAMPLES = {FaultKind.DOUBLED, FaultKind.LATE, FaultKind.OUT_OF_PLAN}  # reported if they name no period

_Recorded = Frame | Fault | Estimate | AlarmChange
_RECORDED = frozenset({"Frame", "Fault", "Estimate", "AlarmChange"})
_REPLAYED = _RECORDED - {"Estimate"}


@dataclass(frozen=True)
class _Damage:
    """A stretch that is lost, as told to the monitor."""

    fault: Fault


@dataclass(frozen=True)
class _Part:
    path: Path
    number: int
    run: Run


class Recording:
    """A recording of one file or of several parts, read chunk by chunk.

    Parameters
    ----------
    *paths : Path
        Parts of one run in any order, or a directory that holds them. Some parts alone are a recording too.

    Attributes
    ----------
    run : Run
        As it was recorded.
    live : bool
        False: it can be held back.
    paths : tuple of Path
        Parts in their order.
    truncated : bool
        After an iteration: a part lacks its end record, or the end of its file.
    damage : list of str
        After an iteration: a line for each stretch that could not be read.
    end : RunEnd or None
        After an iteration: how the last part ended, with the counts of the run, or of that part if it continues.
    continues : bool
        After an iteration: the run has a further part that was not given.

    Raises
    ------
    RecordingError
        A file that is missing, empty, no recording of creak, of a newer version, or cut before its run is known;
        parts of different runs, or one of them twice.
    """

    live = False

    def __init__(self, *paths: Path) -> None:
        self._parts = _in_order([_open_part(path) for path in _files(paths)])
        self.run = self._parts[0].run
        self.paths = tuple(part.path for part in self._parts)
        self._closed = False
        self._reset()

    def frames(self) -> Iterator[Frame | Fault]:
        """Yield the frames as they came from the rig, and what the source then or the file now lacks."""
        for item in self.replayed():
            if isinstance(item, Frame | Fault):
                yield item

    def replayed(self) -> Iterator[Frame | Fault | Action | Clock]:
        """Yield the same, and in between what operators did and the times at which alarms changed.

        An alarm may change while no frame comes, because it is overdue or somebody acknowledges it: a replay
        knows that only from the change itself.
        """
        for record in self._pass(_REPLAYED):
            if isinstance(record, Frame):
                yield replace(record, status=FrameStatus.ACCEPTED, reason="")
            elif isinstance(record, _Damage):
                yield record.fault
            elif isinstance(record, Fault) and (
                record.kind in _REPORTED or (record.kind in _OF_SAMPLES and record.period is None)
            ):
                yield record
            elif isinstance(record, AlarmChange):
                yield Clock(record.time)
                action = action_of(record)
                if action is not None:
                    yield action

    def recorded(self) -> Iterator[Frame | Fault | Estimate | AlarmChange]:
        """Yield everything as it was recorded: frames as judged, all faults, estimates and alarm changes."""
        for record in self._pass(_RECORDED):
            if not isinstance(record, _Damage):
                yield record

    @property
    def losses(self) -> tuple[str, ...]:
        """Lines that say what is lost: `damage`, or else that the file lacks its end, cut between two chunks."""
        if self.damage or not self.truncated:
            return tuple(self.damage)
        return (f"{self.paths[-1].name}: has no end: it was cut after a whole chunk, or is still being written",)

    def close(self) -> None:
        """End the iteration after the record at hand."""
        self._closed = True

    def _reset(self) -> None:
        self.truncated = False
        self.continues = False
        self.damage: list[str] = []
        self.end: RunEnd | None = None
        self._time = self.run.start

    def _pass(self, wanted: AbstractSet[str]) -> Iterator[_Recorded | _Damage]:
        """Decode the messages that are wanted; to pass over an estimate with its spectra saves time."""
        self._reset()
        before: int | None = None
        for part in self._parts:
            if before is not None and part.number != before + 1:
                yield self._lost(f"{part.path.name}: part {before + 1} of the recording is missing before it")
            before = part.number
            for record in self._read(part, wanted):
                if self._closed:
                    return
                yield record

    def _read(self, part: _Part, wanted: AbstractSet[str]) -> Iterator[_Recorded | _Damage]:
        closing: codec.Closing | None = None
        whole = False
        names = _Names()
        with _naming(part.path), part.path.open("rb") as file:
            for item in salvage(file):
                if isinstance(item, Gap):
                    yield self._lost(f"{part.path.name}: bytes {item.start} to {item.end} are lost: {item.what}")
                elif isinstance(item, Whole):
                    whole = True
                elif isinstance(item, Metadata):
                    closing = closing or codec.closing_of(item.metadata)
                elif isinstance(item, Schema | Channel):
                    names.learn(item)
                elif isinstance(item, Message):
                    name = names.of(item)
                    if name == "RunEnd":
                        closing = codec.decode_closing(item.data)
                    elif name in wanted:
                        record = cast("_Recorded", codec.decode(name, item.data))
                        if isinstance(record, Frame) and record.status is not FrameStatus.REJECTED:
                            self._time = max(self._time, record.time)
                        yield record
        self.truncated = self.truncated or closing is None or not whole
        self.continues = closing is not None and closing.continues
        self.end = closing.end if closing is not None else None

    def _lost(self, line: str) -> _Damage:
        line = f"{line}, after {codec.time_json(self._time)}"
        self.damage.append(line)
        return _Damage(Fault(FaultKind.DAMAGED, self._time, line))


def recordings(*paths: Path) -> list[Recording]:
    """Open files of any number of runs: a recording for each run, its parts in their order.

    Raises
    ------
    RecordingError
        As `Recording`.
    """
    runs: dict[str, list[Path]] = {}
    for path in _files(paths):
        runs.setdefault(_open_part(path).run.id, []).append(path)
    return [Recording(*parts) for parts in runs.values()] or [Recording()]


class _Names:
    """Message names by channel id: those that creak gives, unless the file says otherwise."""

    def __init__(self) -> None:
        self._schemas: dict[int, str] = {}
        self._names = dict(enumerate(codec.TOPICS.values(), start=1))

    def learn(self, item: Schema | Channel) -> None:
        """Note what a file declares; another tool may have given other ids."""
        package = codec.full_name("")
        if isinstance(item, Schema):
            self._schemas[item.id] = item.name.removeprefix(package) if item.name.startswith(package) else ""
        else:
            self._names[item.id] = self._schemas.get(item.schema_id, "")

    def of(self, message: Message) -> str:
        """Name of a message, without its package; empty for one that is none of ours."""
        return self._names.get(message.channel_id, "")


def _files(paths: tuple[Path, ...]) -> Iterator[Path]:
    for path in paths:
        if not path.is_dir():
            yield path
            continue
        parts = sorted(path.glob("*.mcap"))
        if not parts:
            raise RecordingError(f"{path}: is a directory without recordings (*.mcap)")
        yield from parts


def _open_part(path: Path) -> _Part:
    with _naming(path), path.open("rb") as file:
        opening = _opening(file)
    return _Part(path, opening.part, opening.run)


def _opening(file: IO[bytes]) -> codec.Opening:
    """Find the run, which stands in the metadata at a file's beginning and in the first chunk."""
    if not file.read(1):
        raise RecordingError("is empty")
    if not is_mcap(file):
        raise RecordingError("is no MCAP file")
    foreign = False
    names = _Names()
    for item in salvage(file):
        opening: codec.Opening | None = None
        if isinstance(item, Header):
            foreign = item.profile != codec.PROFILE
        elif isinstance(item, Metadata):
            opening = codec.opening_of(item.metadata)
        elif isinstance(item, Schema | Channel):
            names.learn(item)
        elif isinstance(item, Message):
            if names.of(item) == "Run":
                opening = codec.decode_opening(item.data)
            elif foreign:
                break
        if opening is not None:
            return opening
    if foreign:
        raise RecordingError("is an MCAP file, but no recording of creak")
    raise RecordingError("is cut or damaged where it says what run it records, so nothing in it can be used")


def _in_order(parts: list[_Part]) -> tuple[_Part, ...]:
    """Sort the parts of a run by their numbers."""
    if not parts:
        raise RecordingError("no recording is given")
    parts.sort(key=lambda part: part.number)
    for one, other in pairwise(parts):
        if one.run.id != other.run.id:
            raise RecordingError(
                f"{other.path}: is of the run {other.run.id!r}, but {one.path.name} of {one.run.id!r}; "
                "give the parts of one run"
            )
        if one.number == other.number:
            raise RecordingError(f"{other.path}: is part {other.number} of its run, as {one.path.name} is")
    return tuple(parts)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Begin what is wrong with a recording with its name."""
    try:
        yield
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from None
