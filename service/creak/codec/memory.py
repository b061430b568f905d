"""What monitors keep and tell each other as bytes, and back: memories, checkpoints, digests, sums.

A JSON text that names every record and field, and behind it the bytes of the arrays that it refers to; of arrays
of zeros nothing is written. Only the records listed here are ever made from it, so a store or a broker that
somebody else can write to is no way into the process.
"""

import dataclasses
import json
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from creak.alarm_records import Verdict
from creak.alarms.judge import NodeAlarm, Watch
from creak.alarms.life import Alarm
from creak.alarms.quality import Quality
from creak.alarms.table import Facts
from creak.baseline import Baseline
from creak.detection import LineSums
from creak.digests import Digest
from creak.errors import RecordingError
from creak.judgement import Block
from creak.monitor import Checkpoint, Memory
from creak.quality import Flaw
from creak.records import Fault, FaultKind, Frame, FrameStatus
from creak.statistics import Sums, packed_moments
from creak.trend import Trend

_RECORDS: Mapping[str, type[Any]] = {
    kind.__name__: kind
    for kind in (
        Memory, NodeAlarm, Watch, Alarm, Facts, Quality, Baseline, Trend, Sums, Block, LineSums,
        Checkpoint, Digest, Flaw, Fault, Frame,
    )
}  # fmt: skip
_ENUMS: Mapping[str, type[Enum]] = {kind.__name__: kind for kind in (Verdict, FaultKind, FrameStatus)}
_FORMAT = 3
_READ = (2, 3)  # the first had moments as full matrices

_Packable = Memory | Checkpoint | Digest | Block | NDArray[Any]
_T = TypeVar("_T", Memory, Checkpoint, Digest, Block, NDArray[Any])


def memory_bytes(memory: Memory) -> bytes:
    """Write a memory as bytes."""
    return packed(memory)


def memory_of(data: bytes) -> Memory:
    """Read a memory from bytes.

    Raises
    ------
    RecordingError
        If they are none of this version's; a monitor then begins afresh.
    """
    return unpacked(Memory, data)


def packed(value: _Packable) -> bytes:
    """Write a record, or an array, as bytes."""
    arrays = _Arrays()
    text = json.dumps({"format": _FORMAT, "memory": _plain(value, arrays)}, separators=(",", ":")).encode()
    return b"".join((len(text).to_bytes(8, "little"), text, *arrays.parts))


def unpacked(kind: type[_T], data: bytes) -> _T:
    """Read a record of a kind, or an array, from bytes.

    Raises
    ------
    RecordingError
        If they are none of this version's, or of another kind.
    """
    value = _read(data, lambda document: document)
    if not isinstance(value, kind):
        raise RecordingError(f"{len(data)} bytes that are no {kind.__name__} of a monitor")
    return value


def baselines_of(data: bytes) -> tuple[Baseline, ...]:
    """Read the baselines alone from the bytes of a memory; the arrays beside them are not touched.

    Raises
    ------
    RecordingError
        As `memory_of`.
    """
    found = _read(data, lambda document: document[2]["baselines"])
    if not isinstance(found, tuple) or not all(isinstance(item, Baseline) for item in found):
        raise RecordingError("a monitor's state without baselines")
    return found


def _read(data: bytes, part: Callable[[Any], Any]) -> Any:
    length = int.from_bytes(data[:8], "little")
    try:
        document = json.loads(data[8 : 8 + length])
        if document["format"] not in _READ:
            raise RecordingError(f"a monitor's state of format {document['format']}; this creak reads {_READ}")
        return _made(part(document["memory"]), memoryview(data)[8 + length :])
    except RecordingError:
        raise
    except (
        LookupError,
        ValueError,
        TypeError,
        AttributeError,
        ArithmeticError,
        MemoryError,
        RecursionError,
    ) as error:
        raise RecordingError(f"a monitor's state that cannot be read: {error}") from error


class _Arrays:
    """Bytes of arrays, in the order of their memory; an array that several records share stands there once."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self._size = 0
        self._known: dict[int, tuple[NDArray[Any], list[Any]]] = {}  # with the array, so that its id stays its own

    def add(self, value: NDArray[Any]) -> list[Any]:
        """Where an array lies and how it is read: type, shape in memory, offset, and which axes those are."""
        if id(value) not in self._known:
            axes = sorted(range(value.ndim), key=lambda axis: -value.strides[axis])
            little = value.dtype.newbyteorder("<")
            stored = np.ascontiguousarray(value.transpose(axes), dtype=little)
            shape = list(stored.shape)
            kind, parts = "ordered", stored
            if stored.size and not stored.reshape(-1).view(np.uint8).any():
                kind, parts = "zeros", stored[:0]
            place = [kind, little.str, shape, self._size, axes]
            self.parts.append(parts.tobytes())
            self._size += parts.nbytes
            self._known[id(value)] = value, place
        return self._known[id(value)][1]


def _plain(value: Any, arrays: _Arrays) -> Any:
    """Turn a value into what JSON holds: a scalar, or a list that begins with its kind."""
    if isinstance(value, Enum):
        return ["enum", type(value).__name__, value.value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        return arrays.add(value)
    if isinstance(value, tuple):
        return ["tuple", *(_plain(item, arrays) for item in value)]
    if isinstance(value, frozenset):
        return ["set", *(_plain(item, arrays) for item in sorted(value))]
    if isinstance(value, Mapping):
        return ["map", *([_plain(key, arrays), _plain(item, arrays)] for key, item in value.items())]
    name = type(value).__name__
    if _RECORDS.get(name) is not type(value):
        raise TypeError(f"{name} is none of the records that monitors keep and tell")
    fields = {f.name: _plain(getattr(value, f.name), arrays) for f in dataclasses.fields(value)}
    return ["record", name, fields]


def _made(value: Any, arrays: memoryview) -> Any:
    if not isinstance(value, list):
        return value
    kind, *rest = value
    match kind:
        case "enum":
            return _ENUMS[rest[0]](rest[1])
        case "array" | "ordered":  # the first is how it was written before, always the last axis fastest
            dtype, shape, offset, *axes = np.dtype(rest[0]), tuple(rest[1]), *rest[2:]
            count = int(np.prod(shape, dtype=np.int64))
            stored = np.frombuffer(arrays, dtype, count, offset).reshape(shape).copy()
            return stored.transpose(np.argsort(axes[0])) if axes else stored
        case "zeros":
            return np.zeros(tuple(rest[1]), np.dtype(rest[0])).transpose(np.argsort(rest[3]))
        case "tuple":
            return tuple(_made(item, arrays) for item in rest)
        case "set":
            return frozenset(_made(item, arrays) for item in rest)
        case "map":
            return {_made(key, arrays): _made(item, arrays) for key, item in rest}
        case "record":
            fields = {name: _made(item, arrays) for name, item in rest[1].items()}
            if rest[0] == "Sums":
                for name in ("between", "within"):
                    if name in fields:
                        fields[f"packed_{name}"] = packed_moments(fields.pop(name))
            return _RECORDS[rest[0]](**fields)
    raise ValueError(f"{kind!r} is no kind of value")
