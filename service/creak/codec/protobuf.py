"""Records to protobuf messages and back, exactly: None stays None, NaN stays NaN, floats keep every bit."""

import json
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from google.protobuf import json_format
from google.protobuf.message import DecodeError

from creak.alarm_records import AlarmRules, BaselineRules
from creak.codec.schemas import FORMAT, LAYOUT, MESSAGES
from creak.errors import RecordingError
from creak.findings import DetectionLevel
from creak.records import (
    AlarmChange,
    AlarmState,
    Counts,
    ElementShare,
    Estimate,
    Excitation,
    Fault,
    FaultKind,
    Frame,
    FrameStatus,
    Limits,
    Node,
    NodeLevel,
    Real,
    Record,
    Rig,
    Run,
    RunEnd,
    RunStatus,
    Scope,
    Spectra,
)


@dataclass(frozen=True)
class Opening:
    """First record of a recording's file: the run, and which part of its recording the file is, from 1."""

    run: Run
    part: int = 1


@dataclass(frozen=True)
class Closing:
    """Last record of a recording's file: the end, and True if the recording goes on in a further part."""

    end: RunEnd
    continues: bool = False


def encode(record: Record | NodeLevel | Opening | Closing) -> bytes:
    """Serialise a record as the message of its name.

    Raises
    ------
    ValueError
        An integer beyond 64 bits.
    """
    if isinstance(record, Opening):
        return _bytes("Run", record.run, format=FORMAT, part=record.part)
    if isinstance(record, Closing):
        return _bytes("RunEnd", record.end, continues=record.continues)
    if isinstance(record, Run):
        return encode(Opening(record))
    if isinstance(record, RunEnd):
        return encode(Closing(record))
    return _bytes(type(record).__name__, record)


def decode(message: str, data: bytes) -> Record | NodeLevel:
    """Read a record back.

    Parameters
    ----------
    message : str
        Name of the message without its package, for instance ``Frame``.
    data : bytes

    Raises
    ------
    RecordingError
        The bytes are no such message, or hold what this version of creak does not know.
    """
    return cast("Record | NodeLevel", _record(message, _parse(message, data)))


def decode_opening(data: bytes) -> Opening:
    """Read a ``Run`` message with the part that its file is.

    Raises
    ------
    RecordingError
        As `decode`, or the recording is of a newer version.
    """
    return _opening(_parse("Run", data))


def decode_closing(data: bytes) -> Closing:
    """Read a ``RunEnd`` message with what it says about a further part; raises as `decode`."""
    return _closing(_parse("RunEnd", data))


# -- metadata: text that stands outside the checksummed chunks, so it carries a checksum of its own


def opening_text(opening: Opening) -> dict[str, str]:
    """Text of an opening, exact, for a file's metadata: a copy for the case that the message is damaged."""
    return _sealed("opening", "Run", encode(opening))


def closing_text(closing: Closing) -> dict[str, str]:
    """Text of a closing, exact, for a file's metadata."""
    return _sealed("closing", "RunEnd", encode(closing))


def opening_of(metadata: Mapping[str, str]) -> Opening | None:
    """Return the opening in a file's metadata; None where it is missing or its checksum does not hold."""
    message = _unsealed("opening", "Run", metadata)
    return None if message is None else _opening(message)


def closing_of(metadata: Mapping[str, str]) -> Closing | None:
    """Return the closing in a file's metadata; None where it is missing or its checksum does not hold."""
    message = _unsealed("closing", "RunEnd", metadata)
    return None if message is None else _closing(message)


def _sealed(key: str, name: str, data: bytes) -> dict[str, str]:
    message = MESSAGES[name].FromString(data)
    text = json.dumps(json_format.MessageToDict(message, preserving_proto_field_name=True))
    return {key: text, f"{key}_crc32": f"{zlib.crc32(text.encode()):08x}"}


def _unsealed(key: str, name: str, metadata: Mapping[str, str]) -> Any:
    text = metadata.get(key)
    if text is None or metadata.get(f"{key}_crc32") != f"{zlib.crc32(text.encode()):08x}":
        return None
    return json_format.Parse(text, MESSAGES[name](), ignore_unknown_fields=True)


# -- writing


def _bytes(name: str, record: Any, **more: int) -> bytes:
    """Serialise a record's attributes, and `more` fields that the message has beyond them.

    Concatenated serialisations of a message merge, so nested messages and arrays are appended as the bytes they
    are. An array's bytes are those of the packed field already: some thirty times quicker than by element.
    """
    message = MESSAGES[name](**more)
    nested: list[bytes] = []
    for number, (key, kind) in enumerate(LAYOUT[name].items(), start=1):
        if key in more:
            continue
        value = getattr(record, _ATTRIBUTES.get(key, key))
        if value is None:
            continue
        if (name, key) in _TO_MESSAGE:
            value = _TO_MESSAGE[name, key](value)
        base, repeated = kind.rstrip("?*"), kind.endswith("*")
        if base == "Array":
            nested.append(_delimited(number, _array_bytes(value)))
        elif base in LAYOUT:
            nested.extend(_delimited(number, _bytes(base, item)) for item in (value if repeated else (value,)))
        elif repeated:
            getattr(message, key).extend(map(_SCALARS[base], value))
        else:
            setattr(message, key, _SCALARS[base](value))
    return b"".join((message.SerializeToString(), *nested))


def _array_bytes(array: Real) -> bytes:
    shape: bytes = MESSAGES["Array"](shape=np.shape(array)).SerializeToString()
    return shape + _delimited(2, np.asarray(array, dtype="<f8").tobytes())


def _delimited(number: int, payload: bytes) -> bytes:
    """Wire form of a length-delimited field: tag, length, payload (protobuf.dev/programming-guides/encoding)."""
    head = bytearray([number << 3 | 2])  # fields up to 15, which all nested ones are
    size = len(payload)
    while size > 0x7F:
        head.append(size & 0x7F | 0x80)
        size >>= 7
    head.append(size)
    return bytes(head) + payload


# -- reading


def _parse(name: str, data: bytes) -> Any:
    try:
        return MESSAGES[name].FromString(data)
    except DecodeError:
        raise RecordingError(f"a message of {len(data)} bytes that is no creak.{name}") from None


def _opening(message: Any) -> Opening:
    if message.format > FORMAT:
        raise RecordingError(
            f"written by creak {message.software} in format {message.format}; "
            f"this version reads formats up to {FORMAT}"
        )
    return Opening(_record("Run", message), message.part)


def _closing(message: Any) -> Closing:
    return Closing(_record("RunEnd", message), message.continues)


def _record(name: str, message: Any) -> Any:
    """Build the record that a message holds; fields which its class does not have are left out."""
    build = _CLASSES[name]
    attributes = {field.name for field in fields(build)}
    values: dict[str, Any] = {}
    for key, kind in LAYOUT[name].items():
        attribute = _ATTRIBUTES.get(key, key)
        if attribute in attributes:
            if (name, key) in _CAME_LATER and not message.HasField(key):
                continue  # a recording of an older version: the record's default holds
            values[attribute] = _value(name, key, kind, message)
    return build(**values)


def _value(name: str, key: str, kind: str, message: Any) -> Any:
    base, value = kind.rstrip("?*"), getattr(message, key)
    if kind.endswith("*"):
        value = tuple(_record(base, item) for item in value) if base in LAYOUT else tuple(value)
    elif (kind.endswith("?") or base in LAYOUT) and not message.HasField(key):
        if kind.endswith("?") or (name, key) in _MAY_LACK:
            return None
        raise RecordingError(f"a creak.{name} without its {key}")
    try:
        if base == "Array":
            return np.array(value.values, dtype=np.float64).reshape(tuple(value.shape))
        if base in LAYOUT and not kind.endswith("*"):
            value = _record(base, value)
        return _FROM_MESSAGE[name, key](value) if (name, key) in _FROM_MESSAGE else value
    except RecordingError:
        raise
    except ValueError as error:  # a word that this version does not have, or a shape that does not fit
        raise RecordingError(f"{key} of a creak.{name} cannot be understood: {error}") from None


# -- where a record and its message are not alike


@dataclass(frozen=True)
class _Edge:
    between: tuple[str, ...]


@dataclass(frozen=True)
class _Network:
    edges: tuple[_Edge, ...]


@dataclass(frozen=True)
class _FaultCount:
    kind: str
    count: int


_CLASSES: dict[str, Any] = {
    "Edge": _Edge,
    "Network": _Network,
    "FaultCount": _FaultCount,
} | {
    class_.__name__: class_
    for class_ in (
        Node,
        Rig,
        Excitation,
        Limits,
        AlarmRules,
        BaselineRules,
        Run,
        Frame,
        Fault,
        NodeLevel,
        Spectra,
        ElementShare,
        DetectionLevel,
        Estimate,
        AlarmChange,
        Counts,
        RunEnd,
    )
}
_ATTRIBUTES = {"class": "class_"}  # the message's word is a keyword of Python
_SCALARS: dict[str, Callable[[Any], Any]] = {
    "int64": int,
    "double": float,
    "bool": bool,
    "string": str,
    "bytes": bytes,
}
_MAY_LACK = {("Rig", "network")}
_CAME_LATER = {("Run", "alarms"), ("Run", "baseline")}
_TO_MESSAGE: dict[tuple[str, str], Callable[[Any], Any]] = {
    ("Rig", "network"): lambda edges: _Network(tuple(_Edge(edge) for edge in edges)),
    ("Counts", "faults"): lambda faults: tuple(_FaultCount(*item) for item in faults.items()),
}
_FROM_MESSAGE: dict[tuple[str, str], Callable[[Any], Any]] = {
    ("Rig", "network"): lambda network: tuple(edge.between for edge in network.edges),
    ("Counts", "faults"): lambda counts: {item.kind: item.count for item in counts},
    ("Frame", "status"): FrameStatus,
    ("Fault", "kind"): FaultKind,
    ("Estimate", "scope"): Scope,
    ("AlarmChange", "state"): AlarmState,
    ("RunEnd", "status"): RunStatus,
}
