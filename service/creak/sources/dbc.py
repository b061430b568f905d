"""Signals of a DBC file, decoded in bulk: all frames of one message at once.

cantools reads the DBC and says where a signal lies; here its bits are taken out of a whole array of payloads with
a handful of numpy operations, which costs tens of nanoseconds a frame where a decode call a frame costs
microseconds.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cantools.database
import numpy as np
from cantools.database.errors import Error as CantoolsError
from numpy.typing import NDArray

from creak.errors import ConfigurationError
from creak.records import Real

Payload = NDArray[np.uint8]
"""Payloads of one message, ``(frames, bytes)``, those that are shorter filled up with zeros."""
Flags = NDArray[np.bool_]

MAX_BYTES: Final = 64  # of a CAN FD frame


@dataclass(frozen=True)
class Condition:
    """A multiplexer value on which a signal depends."""

    signal: "Signal"
    values: tuple[int, ...]


@dataclass(frozen=True)
class Signal:
    """Where a signal lies in the payload of its message, and how its bits become a number.

    Parameters
    ----------
    name : str
        ``Message.Signal``.
    start : int
        Start bit as the DBC has it: of the least significant bit (little endian), of the most significant one
        (big endian), counted 8 byte + bit.
    length : int
        Bits, 1 to 64.
    big_endian, signed, floating : bool
    scale, offset : float
        Physical value = scale raw + offset.
    conditions : tuple of Condition
        All must hold for a frame to carry the signal (multiplexing, also nested).
    """

    name: str
    start: int
    length: int
    big_endian: bool = False
    signed: bool = False
    floating: bool = False
    scale: float = 1.0
    offset: float = 0.0
    conditions: tuple[Condition, ...] = ()

    def bits(self, data: Payload) -> NDArray[np.uint64]:
        """Raw bits, right-aligned, ``(frames,)``.

        Parameters
        ----------
        data : array of uint8, (frames, bytes)
        """
        first, bit = divmod(self.start, 8)
        skipped = 7 - bit if self.big_endian else bit  # bits of the first byte before the signal begins
        count = (skipped + self.length + 7) // 8
        spare = 8 * count - skipped - self.length  # bits of the last byte after it ends
        if self.big_endian:
            word = _word(data, first, min(count, 8), ">u8")
            if count > 8:
                ninth = data[:, first + 8].astype(np.uint64)
                word = (word << np.uint64(8 - spare)) | (ninth >> np.uint64(spare))
            else:
                word >>= np.uint64(spare)
        else:
            word = _word(data, first, min(count, 8), "<u8") >> np.uint64(skipped)
            if count > 8:
                word |= data[:, first + 8].astype(np.uint64) << np.uint64(64 - skipped)
        if self.length < 64:
            word &= np.uint64((1 << self.length) - 1)
        return word

    def raw(self, data: Payload) -> NDArray[Any]:
        """Raw values before scaling: int64, uint64 (unsigned of 64 bits) or a float type, ``(frames,)``."""
        word = self.bits(data)
        if self.floating:
            return word.astype(f"u{self.length // 8}").view(f"f{self.length // 8}")
        if self.signed:
            unused = np.int64(64 - self.length)
            return (word.view(np.int64) << unused) >> unused
        return word if self.length == 64 else word.view(np.int64)

    def values(self, data: Payload) -> Real:
        """Physical values, ``(frames,)``."""
        raw = self.raw(data).astype(np.float64)
        if self.scale == 1.0 and self.offset == 0.0:
            return raw
        return raw * self.scale + self.offset

    def present(self, data: Payload) -> Flags:
        """Whether a frame carries the signal, ``(frames,)``."""
        carried = np.ones(len(data), dtype=np.bool_)
        for condition in self.conditions:
            carried &= np.isin(condition.signal.raw(data), condition.values)
        return carried

    def put(self, data: Payload, values: Real) -> Flags:
        """Write values into payloads whose bits are zero there.

        Parameters
        ----------
        data : array of uint8, (frames, bytes)
            Changed in place.
        values : array, (frames,)
            Physical values; those that the signal cannot hold are clipped.

        Returns
        -------
        array of bool, (frames,)
            Which were clipped.
        """
        if self.floating:
            word = ((values - self.offset) / self.scale).astype(f"f{self.length // 8}")
            self.put_bits(data, word.view(f"u{self.length // 8}").astype(np.uint64))
            return np.zeros(len(data), dtype=np.bool_)
        raw = np.rint((values - self.offset) / self.scale)
        low = -(2.0 ** (self.length - 1)) if self.signed else 0.0
        held = np.clip(raw, low, low + 2.0**self.length - 1)
        whole = held.astype(np.int64).view(np.uint64) if self.signed else held.astype(np.uint64)
        self.put_bits(data, whole & np.uint64(self.range - 1))
        return np.asarray(held != raw)

    def put_bits(self, data: Payload, word: NDArray[np.uint64]) -> None:
        """Write raw bits, right-aligned, into payloads whose bits are zero there."""
        first, bit = divmod(self.start, 8)
        skipped = 7 - bit if self.big_endian else bit
        count = (skipped + self.length + 7) // 8
        spare = 8 * count - skipped - self.length
        for i in range(count):
            shift = 8 * (count - 1 - i) - spare if self.big_endian else 8 * i - skipped
            part = word >> np.uint64(shift) if shift >= 0 else word << np.uint64(-shift)
            data[:, first + i] |= (part & np.uint64(0xFF)).astype(np.uint8)

    @property
    def range(self) -> int:
        """How many values the raw bits can take."""
        return 1 << self.length


def _word(data: Payload, first: int, count: int, order: str) -> NDArray[np.uint64]:
    """Up to eight bytes as one number."""
    padded = np.zeros((len(data), 8), dtype=np.uint8)
    at = 0 if order == "<u8" else 8 - count
    padded[:, at : at + count] = data[:, first : first + count]
    return padded.view(order)[:, 0].astype(np.uint64)


@dataclass(frozen=True)
class Message:
    """A message of a DBC.

    Parameters
    ----------
    name : str
    identifier : int
        Arbitration identifier.
    extended : bool
        True for 29 bits.
    length : int
        Payload, bytes.
    fd : bool
        Whether it needs CAN FD.
    signals : mapping of str to Signal
    """

    name: str
    identifier: int
    extended: bool
    length: int
    fd: bool
    signals: dict[str, Signal]


class Database:
    """The messages of a DBC file.

    Parameters
    ----------
    path : Path

    Raises
    ------
    ConfigurationError
        A file that cannot be read or is no DBC, signals that overlap or do not fit their message.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            read: Any = cantools.database.load_file(path, database_format="dbc", strict=True)
        except OSError as error:
            raise ConfigurationError(str(path), "", f"cannot be read: {error.strerror}") from None
        except (CantoolsError, UnicodeDecodeError, ValueError, AttributeError, KeyError) as error:
            reason = " ".join(str(error).split()).removeprefix("DBC: ").strip('"') or type(error).__name__
            raise ConfigurationError(str(path), "", f"cannot be used as a DBC: {reason}") from None
        self.messages = {message.name: _message(message) for message in read.messages}

    def signal(self, name: str, key: str, source: str) -> tuple[Message, Signal]:
        """Find a signal by ``Message.Signal``, or by its own name if that is the only one.

        Parameters
        ----------
        name : str
        key, source : str
            Where the name was given, for messages.

        Raises
        ------
        ConfigurationError
            If there is none of that name, or several.
        """
        message_name, dot, signal_name = name.partition(".")
        if dot:
            message = self.messages.get(message_name)
            if message is None:
                raise ConfigurationError(
                    source,
                    key,
                    f"{name!r}: {self.path} has no message {message_name!r}; it has {_some(self.messages)}",
                )
            if signal_name not in message.signals:
                raise ConfigurationError(
                    source,
                    key,
                    f"{name!r}: message {message_name!r} of {self.path} has no signal {signal_name!r}; "
                    f"it has {_some(message.signals)}",
                )
            return message, message.signals[signal_name]
        found = [message for message in self.messages.values() if name in message.signals]
        if len(found) == 1:
            return found[0], found[0].signals[name]
        if found:
            places = " and ".join(f"{message.name}.{name}" for message in found)
            raise ConfigurationError(source, key, f"{name!r} is ambiguous in {self.path}: write {places}")
        raise ConfigurationError(
            source, key, f"{name!r}: {self.path} has no such signal; its messages are {_some(self.messages)}"
        )


def _some(names: Sequence[str] | dict[str, Any], most: int = 8) -> str:
    listed = list(names)
    more = f" and {len(listed) - most} more" if len(listed) > most else ""
    return (", ".join(listed[:most]) or "none") + more


def _message(message: Any) -> Message:
    by_name = {signal.name: signal for signal in message.signals}
    known: dict[str, Signal] = {}

    def convert(signal: Any) -> Signal:
        if signal.name not in known:
            conditions: tuple[Condition, ...] = ()
            if signal.multiplexer_ids:
                above = convert(by_name[signal.multiplexer_signal])
                conditions = (*above.conditions, Condition(above, tuple(signal.multiplexer_ids)))
            known[signal.name] = Signal(
                name=f"{message.name}.{signal.name}",
                start=signal.start,
                length=signal.length,
                big_endian=signal.byte_order == "big_endian",
                signed=signal.is_signed,
                floating=signal.is_float,
                scale=float(signal.scale),
                offset=float(signal.offset),
                conditions=conditions,
            )
        return known[signal.name]

    for signal in message.signals:
        convert(signal)
    return Message(
        name=message.name,
        identifier=message.frame_id,
        extended=message.is_extended_frame,
        length=message.length,
        fd=bool(message.is_fd) or message.length > 8,
        signals=known,
    )
