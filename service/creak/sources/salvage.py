"""Reads an MCAP file that may be cut or damaged anywhere: what is whole, and where something is not.

A chunk counts only if its checksum holds. After damage no length is believed: the reader searches for the next
chunk whose checksum holds, at some 250 MB/s. One chunk is in memory at a time.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import IO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, breakup_chunk
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError


@dataclass(frozen=True)
class Gap:
    """Bytes `start` to `end` of a file that could not be read, and what can be said of them."""

    start: int
    end: int
    what: str


@dataclass(frozen=True)
class Whole:
    """Comes last if the file reaches its closing magic."""


Item = Header | Metadata | Schema | Channel | Message | Gap | Whole

_RECORD = struct.Struct("<BQ")  # opcode, length of what follows
_CHUNK_HEAD = struct.Struct("<QQQII")  # first and last time, size and checksum uncompressed, length of a name
_LENGTH = struct.Struct("<Q")
_WINDOW = 1 << 20
_OVERLAP = 64  # longer than what the search looks for
_TEXT_LIMIT = 1 << 24  # bytes of a header or of metadata

# What a record that is worth going on from looks like: opcode, a length below 2^40, and what must follow.
_SEARCHED = re.compile(
    rb"\x06.{5}\0{3}.{21}\0{3}.{4}(?:\0{4}|\x04\0{3}zstd|\x03\0{3}lz4).{5}\0{3}"  # chunk
    rb"|\x0c.{4}\0{4}\x05\0{3}creak"  # metadata
    rb"|\x0f\x04\0{7}.{4}[\x02\x03\x04\x08\x0b].{5}\0{3}",  # data end, and the summary's first record
    re.DOTALL,
)


class _DamagedError(Exception):
    """A record that cannot be read."""


def is_mcap(file: IO[bytes]) -> bool:
    """Tell if a file opens like an MCAP file; some wrong bytes are forgiven."""
    file.seek(0)
    magic = file.read(len(MCAP0_MAGIC))
    return sum(a == b for a, b in zip(magic, MCAP0_MAGIC, strict=False)) >= len(MCAP0_MAGIC) // 2


def salvage(file: IO[bytes]) -> Iterator[Item]:
    """Yield what is whole in the data section of an MCAP file, in its order, and a gap for what is not.

    Parameters
    ----------
    file : binary file
        Open for reading, seekable. What is appended to it meanwhile is not looked at.
    """
    size = file.seek(0, 2)
    at = len(MCAP0_MAGIC)
    while at < size:
        try:
            items, end = _record(file, at, size)
        except _DamagedError as damage:
            end = _search(file, at + 1, size)
            yield Gap(at, end, str(damage) if end < size else "the rest of the file, cut off or damaged")
        else:
            yield from items
            if end == size:
                return
        at = end


def _record(file: IO[bytes], at: int, size: int) -> tuple[list[Item], int]:
    """Read the record at a place: what it holds for us, and where the next one begins."""
    opcode, length = _head(file, at)
    end = at + _RECORD.size + length
    if end > size:
        raise _DamagedError("a record that reaches beyond the file")
    if opcode == Opcode.CHUNK:
        return _chunk(file, at + _RECORD.size, end), end
    if opcode == Opcode.DATA_END and length == 4:
        return ([Whole()] if _closes(file, end, size) else []), size
    if opcode == Opcode.MESSAGE_INDEX and length >= 6:
        (indexed,) = struct.unpack("<2xI", _read(file, at + _RECORD.size, 6))
        if indexed == length - 6 and indexed % 16 == 0 and _leads_on(file, end, size):
            return [], end
    if opcode in (Opcode.HEADER, Opcode.METADATA) and length <= _TEXT_LIMIT and _leads_on(file, end, size):
        return [_text(opcode, _read(file, at + _RECORD.size, length))], end
    raise _DamagedError("what is no record of a recording")


def _chunk(file: IO[bytes], at: int, end: int) -> list[Item]:
    """Read the records in a chunk whose content lies from a place to an end."""
    damage = _DamagedError("a damaged chunk")
    head = _read(file, at, min(_CHUNK_HEAD.size, end - at))
    if len(head) < _CHUNK_HEAD.size:
        raise damage
    first, last, uncompressed, checksum, named = _CHUNK_HEAD.unpack(head)
    name_at = at + _CHUNK_HEAD.size
    data_at = name_at + named + _LENGTH.size
    if named > 4 or data_at > end:
        raise damage
    compression = _read(file, name_at, named).decode("utf-8", "replace")
    (length,) = _LENGTH.unpack(_read(file, name_at + named, _LENGTH.size))
    if data_at + length != end or (not compression and uncompressed != length):
        raise damage
    data = _read(file, data_at, length)
    if not compression and zlib.crc32(data) != checksum:
        raise damage
    try:
        chunk = Chunk(compression, data, last, first, checksum, uncompressed)
        items = breakup_chunk(chunk, validate_crc=bool(compression))
    except (McapError, CRCValidationError, ZstdError, RuntimeError, MemoryError, struct.error):
        raise damage from None
    return [item for item in items if isinstance(item, Schema | Channel | Message)]


def _text(opcode: int, body: bytes) -> Item:
    stream = ReadDataStream(BytesIO(body))
    try:
        item: Item = Header.read(stream) if opcode == Opcode.HEADER else Metadata.read(stream)
    except (McapError, struct.error, UnicodeDecodeError):
        raise _DamagedError("damaged metadata") from None
    if stream.count != len(body):
        raise _DamagedError("damaged metadata")
    return item


def _search(file: IO[bytes], at: int, size: int) -> int:
    """Find the next record that holds what it promises; the file's end if there is none."""
    while at < size:
        window = _read(file, at, min(_WINDOW + _OVERLAP, size - at))
        for match in _SEARCHED.finditer(window):
            try:
                _record(file, at + match.start(), size)
            except _DamagedError:
                continue
            return at + match.start()
        at += _WINDOW
    return size


def _leads_on(file: IO[bytes], at: int, size: int) -> bool:
    """Tell if what begins at a place looks like a record, or is the end of a file that was cut there."""
    if at + _RECORD.size > size:
        return at <= size
    opcode, length = _head(file, at)
    return Opcode.HEADER <= opcode <= Opcode.DATA_END and length < 1 << 40


def _closes(file: IO[bytes], at: int, size: int) -> bool:
    magic = len(MCAP0_MAGIC)
    return size - at > magic and _read(file, size - magic, magic) == MCAP0_MAGIC


def _head(file: IO[bytes], at: int) -> tuple[int, int]:
    data = _read(file, at, _RECORD.size)
    if len(data) < _RECORD.size:
        raise _DamagedError("the beginning of a record")
    opcode, length = _RECORD.unpack(data)
    return opcode, length


def _read(file: IO[bytes], at: int, length: int) -> bytes:
    file.seek(at)
    return file.read(length)
