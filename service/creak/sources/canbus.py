"""A rig on a CAN bus, live: a receive loop of our own that is bounded, reconnects and cannot die silently."""

import contextlib
import logging
import os
import queue
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import can

from creak.config.can import CanSource
from creak.errors import ConfigurationError
from creak.records import Fault, FaultKind, Frame, Run
from creak.sources.can_frames import EXTENDED, CanFrames
from creak.sources.can_mapping import CanMapping
from creak.sources.can_pipeline import CanPipeline

_log = logging.getLogger(__name__)

_BATCH_FRAMES: Final = 256
_BATCH_SECONDS: Final = 0.02
_QUEUE_BATCHES: Final = 256
_RECEIVE_BUFFER: Final = 8 << 20  # bytes
_BACK_OFF: Final = (0.1, 30.0)  # s, first and longest wait before the interface is opened again
_CAN_ERR_BUSOFF: Final = 0x40
_SO_RCVBUFFORCE: Final = 33
_DAY: Final = 86_400.0


@dataclass(frozen=True)
class _Batch:
    """What the receive loop hands over: frames, and what went wrong after them."""

    messages: list[can.Message]
    faults: tuple[Fault, ...] = ()


def open_bus(source: CanSource) -> can.BusABC:
    """Open an interface of python-can.

    Raises
    ------
    can.CanError, OSError, ValueError, TypeError
        What python-can has to say.
    """
    options: dict[str, Any] = dict(source.options)
    for key in ("bitrate", "data_bitrate"):
        if getattr(source, key) is not None:
            options.setdefault(key, getattr(source, key))
    # Only the keys of the service file count; python-can would also read its own files and environment.
    bus = can.Bus(source.channel, source.interface, ignore_config=True, fd=source.fd, **options)
    _widen(bus)
    return bus


def _widen(bus: can.BusABC) -> None:
    """Give the socket, where there is one, room for what comes while we are busy."""
    with (
        contextlib.suppress(OSError, NotImplementedError, ValueError),
        socket.socket(fileno=os.dup(bus.fileno())) as ours,
    ):
        try:
            ours.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)
        except OSError:  # needs a privilege; without it the system's limit holds
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)


def cannot_open(source: CanSource, error: Exception, file: str | Path, key: str) -> ConfigurationError:
    """One line that names interface and channel."""
    known = sorted(can.VALID_INTERFACES)
    if source.interface not in known:
        return ConfigurationError(
            str(file), f"{key}.interface", f"{source.interface!r} is not allowed: should be {', '.join(known)}"
        )
    reason = " ".join(str(error).split()) or type(error).__name__
    return ConfigurationError(
        str(file), f"{key}.channel", f"{source.channel!r} of {source.interface} cannot be opened: {reason}"
    )


class CanBus:
    """Period frames of a rig whose controller sends its samples on a CAN bus.

    Parameters
    ----------
    run : Run
    mapping : CanMapping
    source : CanSource
    file, key : str
        Where the source is configured, for messages.

    Raises
    ------
    ConfigurationError
        If the interface cannot be opened.
    """

    live: bool = True

    def __init__(self, run: Run, mapping: CanMapping, source: CanSource, file: str = "can", key: str = "source"):
        self.run = run
        self._source = source
        self._pipeline = CanPipeline(run, mapping, source.patience)
        holders = [part.message for part in mapping.parts] + [part.counted_by.message for part in mapping.parts]
        self._ours = {m.identifier | (EXTENDED if m.extended else 0) for m in holders}
        self._queue: queue.Queue[_Batch] = queue.Queue(_QUEUE_BATCHES)
        self._closed = threading.Event()
        self._ended = threading.Event()
        self._dropped = 0
        self.received = 0
        """Frames of the rig that were received."""
        try:
            self._bus: can.BusABC | None = open_bus(source)
        except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
            raise cannot_open(source, error, file, key) from None

    def frames(self) -> Iterator[Frame | Fault]:
        """Receive until `close`, and yield what became complete."""
        receiver = threading.Thread(target=self._receive, name=f"can {self.run.rig.name}", daemon=True)
        receiver.start()
        named = 0
        while True:
            try:
                batch = self._queue.get(timeout=0.1)
            except queue.Empty:
                if self._ended.is_set():
                    break
                continue
            if self._dropped > named:
                lost, named = self._dropped - named, self._dropped
                yield _fault(
                    FaultKind.LOST, f"{lost} frames were dropped: decoding could not keep up with the bus"
                )
            if batch.messages:
                yield from self._pipeline.push(CanFrames.of(batch.messages))
            yield from batch.faults
        receiver.join(1.0)
        yield from self._pipeline.finish()

    def close(self) -> None:
        """End the iteration soon, also from another thread."""
        self._closed.set()

    def _receive(self) -> None:
        """Fill the queue; whatever goes wrong becomes a fault and a new attempt, never the end of the thread."""
        loop = _ReceiveLoop(self._source, self._ours, self._hand_over, self._bus)
        try:
            while not self._closed.is_set():
                try:
                    loop.step()
                except Exception as error:  # noqa: BLE001 - a loop must not die silently
                    _log.exception("%s: receive loop", self.run.rig.name)
                    loop.disconnected(error)
                if loop.wait:
                    self._closed.wait(loop.wait)
        finally:
            loop.close()
            self.received = loop.received
            self._ended.set()

    def _hand_over(self, batch: _Batch) -> None:
        try:
            self._queue.put_nowait(batch)
        except queue.Full:
            self._dropped += len(batch.messages)
            if batch.faults:  # they are few, and must not be lost
                self._queue.put(_Batch([], batch.faults))


class _ReceiveLoop:
    """One step after the other: open, receive, hand over; knows whether it is connected and whether it hears."""

    def __init__(self, source: CanSource, ours: set[int], hand_over: Any, bus: can.BusABC | None) -> None:
        self._source = source
        self._ours = ours
        self._hand_over = hand_over
        self._bus = bus
        self._messages: list[can.Message] = []
        self._faults: list[Fault] = []
        self._begun = time.monotonic()  # of the batch
        self._heard = time.monotonic()
        self._silent = False
        self._failing = False
        self._errors = 0
        self._back_off = _BACK_OFF[0]
        self._shift: float | None = None
        self.wait = 0.0
        self.received = 0

    def step(self) -> None:
        """Receive one frame, or open the interface again."""
        self.wait = 0.0
        if self._bus is None:
            self._reopen()
            return
        try:
            message = self._bus.recv(_BATCH_SECONDS)
        except (can.CanError, OSError, ValueError) as error:
            self.disconnected(error)
            return
        now = time.monotonic()
        if message is not None:
            self._take(message, now)
        if not self._silent and now - self._heard > self._source.silence:
            self._silent = True
            self._say(FaultKind.SILENT, f"the rig has sent nothing for {self._source.silence:g} s")
        if (self._messages or self._faults or self._errors) and (
            len(self._messages) >= _BATCH_FRAMES or now - self._begun > _BATCH_SECONDS
        ):
            self._flush(now)

    def disconnected(self, error: Exception) -> None:
        """Close the interface and open it again after a while."""
        reason = " ".join(str(error).split()) or type(error).__name__
        self._leave(FaultKind.DISCONNECTED, f"{self._source.interface} {self._source.channel}: {reason}")

    def close(self) -> None:
        """Hand over what is left and close the interface."""
        self._flush(time.monotonic())
        self._shut()

    def _take(self, message: can.Message, now: float) -> None:
        if message.is_error_frame:
            if message.arbitration_id & _CAN_ERR_BUSOFF:
                self._leave(FaultKind.BUS_OFF, "the interface has left the bus: too many errors")
            else:
                self._errors += 1
            return
        identifier = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
        if message.is_remote_frame or identifier not in self._ours:
            return
        if self._shift is None:  # some interfaces count from their own start
            apart = time.time() - message.timestamp
            self._shift = apart if abs(apart) > _DAY else 0.0
        if self._shift:
            message.timestamp += self._shift
        self._heard = now
        self._silent = False
        self._failing = False
        self._back_off = _BACK_OFF[0]
        self.received += 1
        self._messages.append(message)

    def _leave(self, kind: FaultKind, why: str) -> None:
        if not self._failing or kind is FaultKind.BUS_OFF:  # said once, not at every attempt
            self._say(kind, f"{why}; it is opened again from {self._back_off:g} s on")
        self._failing = True
        self._flush(time.monotonic())
        self._shut()
        self.wait = self._back_off
        self._back_off = min(2 * self._back_off, _BACK_OFF[1])

    def _reopen(self) -> None:
        try:
            self._bus = open_bus(self._source)
        except (can.CanError, OSError, ValueError, TypeError) as error:
            self.disconnected(error)
        else:
            self._shift = None
            _log.info("%s %s: open again", self._source.interface, self._source.channel)

    def _shut(self) -> None:
        bus, self._bus = self._bus, None
        if bus is not None:
            with contextlib.suppress(can.CanError, OSError):
                bus.shutdown()

    def _say(self, kind: FaultKind, text: str) -> None:
        _log.warning("%s %s: %s", self._source.interface, self._source.channel, text)
        self._faults.append(_fault(kind, text))

    def _flush(self, now: float) -> None:
        if self._errors:
            self._faults.append(_fault(FaultKind.BUS_ERROR, f"{self._errors} error frames on the bus"))
            self._errors = 0
        if self._messages or self._faults:
            self._hand_over(_Batch(self._messages, tuple(self._faults)))
        self._messages, self._faults, self._begun = [], [], now


def _fault(kind: FaultKind, message: str) -> Fault:
    return Fault(kind, time.time_ns(), message)
