"""Logs of a CAN bus as a source: BLF, ASC, TRC, candump and MF4, through the same pipeline as the bus itself."""

import contextlib
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import can
import numpy as np

from creak.errors import MeasurementError
from creak.records import Fault, FaultKind, Frame, Run
from creak.sources.can_frames import EXTENDED, CanFrames
from creak.sources.can_mapping import CanMapping
from creak.sources.can_pipeline import CanPipeline
from creak.sources.dbc import Database

SUFFIXES: Final = (".blf", ".asc", ".trc", ".log", ".mf4")
"""What is read, told by the suffix of the file's name in either case; ``.log`` is what candump writes."""
_BATCH: Final = 4096


def read_log(path: Path) -> Iterator[can.Message]:
    """Yield the data frames of a log, in their order.

    Raises
    ------
    MeasurementError
        If the file cannot be read, or holds no log of the kind that its suffix says.
    """
    if path.suffix.lower() not in SUFFIXES:
        found = f"suffix {path.suffix}" if path.suffix else "no suffix"
        raise MeasurementError(f"{path}: {found}, expected one of {', '.join(SUFFIXES)}")
    try:
        file: Any = path.open("rb")
    except OSError as error:
        raise MeasurementError(f"{path}: cannot be read: {error.strerror}") from None
    reader: Any = None
    with contextlib.closing(file):
        try:
            if path.suffix.lower() in (".blf", ".mf4"):
                reader = {".blf": can.BLFReader, ".mf4": can.MF4Reader}[path.suffix.lower()](file)
            else:
                file.close()
                reader = can.LogReader(path)
            for message in reader:
                if not message.is_error_frame and not message.is_remote_frame:
                    yield message
        except Exception as error:  # readers raise whatever a damaged file provokes
            text = " ".join(str(error).split()) or type(error).__name__
            raise MeasurementError(f"{path}: cannot be read as {path.suffix} any further: {text[:200]}") from error
        finally:
            if reader is not None:
                with contextlib.suppress(Exception):  # some readers cannot be stopped after a damaged file
                    reader.stop()


def first_time(path: Path) -> int:
    """Time of a log's first frame, ns since the Unix epoch (or since the log's begin, as the format has it)."""
    for message in read_log(path):
        return round(message.timestamp * 1e6) * 1000
    raise MeasurementError(f"{path}: holds no frame")


class CanLog:
    """Logs of one run, in order.

    Parameters
    ----------
    run : Run
    mapping : CanMapping
    paths : sequence of Path
    patience : float
        Periods that a frame may be late.
    """

    live: bool = False

    def __init__(self, run: Run, mapping: CanMapping, paths: Sequence[Path], patience: float = 0.5) -> None:
        self.run = run
        self._paths = tuple(paths)
        self._pipeline = CanPipeline(run, mapping, patience)
        self._closed = False

    def frames(self) -> Iterator[Frame | Fault]:
        """Yield the period frames of all logs, and faults for what is lost or cannot be read."""
        for path in self._paths:
            messages = read_log(path)
            time = self.run.start
            while not self._closed:
                batch: list[can.Message] = []
                damage = ""
                try:
                    batch.extend(itertools.islice(messages, _BATCH))
                except MeasurementError as error:
                    damage = str(error)
                if batch:
                    frames = CanFrames.of(batch)
                    time = int(frames.times[-1])
                    yield from self._pipeline.push(frames)
                if damage:
                    yield Fault(FaultKind.DAMAGED, time, damage)
                if len(batch) < _BATCH:
                    break
        yield from self._pipeline.finish()

    def close(self) -> None:
        """End the iteration before its next batch."""
        self._closed = True


def survey(path: Path, database: Database) -> list[str]:
    """What a log holds of a DBC's messages: a line each with rate and how many samples are flagged invalid.

    A signal whose name ends with ``Valid`` flags the frames in which it is 0.
    """
    frames = CanFrames.of(list(read_log(path)))
    lines = []
    for message in database.messages.values():
        identifier = message.identifier | (EXTENDED if message.extended else 0)
        own = frames[np.flatnonzero(frames.identifiers == identifier)]
        if not len(own):
            continue
        seconds = (own.times[-1] - own.times[0]) * 1e-9
        rate = f" at {(len(own) - 1) / seconds:.2f} Hz" if seconds > 0 else ""
        line = f"{message.name}: {len(own)} frames{rate}"
        for name, signal in message.signals.items():
            if name.lower().endswith("valid"):
                line += f", {int((signal.raw(own.data) == 0).sum())} flagged invalid by {name}"
        lines.append(line)
    return lines
