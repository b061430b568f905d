"""Frames as they come from a bus or a log, gathered into arrays, and the checksums that guard them."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from creak.sources.dbc import MAX_BYTES, Payload, Signal

EXTENDED = 1 << 31
"""Added to an identifier of 29 bits, so that it differs from the same number of 11 bits."""


@dataclass(frozen=True, eq=False)
class CanFrames:
    """Data frames in the order in which they came.

    Parameters
    ----------
    identifiers : array of uint32, (frames,)
        Arbitration identifiers, ``EXTENDED`` added to those of 29 bits.
    times : array of int64, (frames,)
        When they came, ns since the Unix epoch.
    lengths : array of uint8, (frames,)
        Bytes of payload.
    data : array of uint8, (frames, 64)
        Payloads, filled up with zeros.
    """

    identifiers: NDArray[np.uint32]
    times: NDArray[np.int64]
    lengths: NDArray[np.uint8]
    data: Payload

    def __len__(self) -> int:
        return len(self.identifiers)

    @classmethod
    def none(cls) -> Self:
        """No frames at all."""
        return cls.of([])

    @classmethod
    def of(cls, messages: Sequence[Any]) -> Self:
        """Gather messages of python-can; all must be data frames."""
        count = len(messages)
        payloads = [message.data for message in messages]
        return cls(
            np.fromiter(
                [m.arbitration_id | EXTENDED if m.is_extended_id else m.arbitration_id for m in messages],
                np.uint32,
                count,
            ),
            np.rint(np.fromiter([m.timestamp for m in messages], np.float64, count) * 1e6).astype(np.int64) * 1000,
            np.fromiter(map(len, payloads), np.uint8, count),
            np.frombuffer(b"".join([bytes(p).ljust(MAX_BYTES, b"\0") for p in payloads]), np.uint8).reshape(
                count, MAX_BYTES
            ),
        )

    def __getitem__(self, rows: Any) -> Self:
        return type(self)(*(getattr(self, column.name)[rows] for column in fields(self)))

    def __add__(self, other: Self) -> Self:
        return type(self)(*(np.concatenate((getattr(self, c.name), getattr(other, c.name))) for c in fields(self)))


CHECKSUMS = {8: (0x1D, 0xFF, 0xFF), 16: (0x1021, 0xFFFF, 0), 32: (0, 0, 0)}
"""Polynomial, start and final inversion by width: CRC-8/SAE-J1850, CRC-16/CCITT-FALSE, CRC-32 of zlib."""


def checksum(payload: bytes, width: int) -> int:
    """Checksum of a payload, bit by bit for 8 and 16 bits: short and obvious, not fast.

    Parameters
    ----------
    payload : bytes
        With the checksum's own bits at zero.
    width : int
        8, 16 or 32 bits.
    """
    if width == 32:
        return zlib.crc32(payload)
    polynomial, register, final = CHECKSUMS[width]
    for byte in payload:
        register ^= byte << (width - 8)
        for _ in range(8):
            register = (register << 1) ^ (polynomial if register >> (width - 1) else 0)
            register &= (1 << width) - 1
    return register ^ final


@cache
def _table(width: int, length: int) -> NDArray[np.uint32]:
    """What every byte value at every position adds to the checksum, ``(length, 256)``: checksums are linear."""
    table = np.empty((length, 256), dtype=np.uint32)
    nothing = checksum(bytes(length), width)
    for position in range(length):
        single = [
            checksum(bytes(position) + bytes([1 << b]) + bytes(length - position - 1), width) for b in range(8)
        ]
        values = np.zeros(256, dtype=np.uint32)
        for b, found in enumerate(single):
            values[(np.arange(256) >> b) & 1 == 1] ^= np.uint32(found ^ nothing)
        table[position] = values
    table.setflags(write=False)
    return table


def checksums_agree(signal: Signal, data: Payload) -> NDArray[np.bool_]:
    """Whether the checksum in every frame is that of its other bytes, ``(frames,)``.

    Parameters
    ----------
    signal : Signal
        The checksum; whole bytes.
    data : array of uint8, (frames, length)
        Payloads of the message's length.
    """
    length = data.shape[1]
    first = signal.start // 8
    bare = data.copy()
    bare[:, first : first + signal.length // 8] = 0
    table = _table(signal.length, length)
    found = np.full(len(data), checksum(bytes(length), signal.length), dtype=np.uint32)
    for position in range(length):
        found ^= table[position][bare[:, position]]
    agree: NDArray[np.bool_] = found.astype(np.uint64) == signal.bits(data)
    return agree
