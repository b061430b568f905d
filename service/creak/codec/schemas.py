"""The messages of a recording: their fields, the protobuf descriptors built from them, and the topics.

The tables below are the schema. A field's number is its place in its message, counted from 1, so fields are only
ever appended and never moved: an older creak then skips what it does not know and a newer one finds it absent.
The descriptor set travels in every recording, which is how ordinary MCAP tools read it without creak.
"""

from typing import Any, Final

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from creak.records import Rig

FORMAT: Final = 1
"""Version of the messages; raised only when an older reader would misunderstand a recording."""

PROFILE: Final = "creak"
ENCODING: Final = "protobuf"

_PACKAGE = "creak"
_LEVEL = "double?"

LAYOUT: Final[dict[str, dict[str, str]]] = {
    # type? is None where absent, type* is repeated; other names are messages of this table
    "Array": {"shape": "int64*", "values": "double*"},  # row-major
    "Node": {"name": "string", "output": "string", "input": "string?"},
    "Edge": {"between": "string*"},
    "Network": {"edges": "Edge*"},
    "Rig": {
        "name": "string",
        "sample_rate": "double",
        "period_samples": "int64",
        "transient_periods": "int64",
        "lines": "int64*",
        "nodes": "Node*",
        "grid": "string",
        "hold": "string",
        "network": "Network",
    },
    "Excitation": {"kind": "string", "rms": "double?", "seed": "int64?"},
    "Limits": {
        "total_to_noise_db": "double",
        "p_value": "double",
        "dead_band_db": "double",
        "windows": "int64",
        "exceeding": "int64",
        "warning_db": "double?",
        "false_alarms_per_year": "double?",
    },
    "AlarmRules": {
        "on_delay_s": "double",
        "off_delay_s": "double",
        "realarm_s": "double?",
        "shelving_max_s": "double",
        "silence_s": "double?",
        "stale_realisations": "double",
    },
    "BaselineRules": {
        "realisations": "int64",
        "change_db": "double",
        "state_tolerance_db": "double",
        "trend_false_alarms_per_year": "double?",
    },
    "Run": {
        "id": "string",
        "rig": "Rig",
        "steady_periods": "int64",
        "start": "int64",
        "excitation": "Excitation",
        "source": "string",
        "window": "int64",
        "limits": "Limits",
        "software": "string",
        "format": "int64",
        "part": "int64",
        "alarms": "AlarmRules",
        "baseline": "BaselineRules",
        "before": "bytes",
    },
    "Frame": {
        "time": "int64",
        "realisation": "int64",
        "experiment": "int64",
        "period": "int64",
        "status": "string",
        "reason": "string",
        "u": "Array",
        "y": "Array",
    },
    "Fault": {
        "kind": "string",
        "time": "int64",
        "message": "string",
        "realisation": "int64?",
        "experiment": "int64?",
        "period": "int64?",
    },
    "NodeLevel": {
        "name": "string",
        "signal_db": "double",
        "noise_db": _LEVEL,
        "total_db": _LEVEL,
        "nonlinear_db": _LEVEL,
        "total_to_noise_db": _LEVEL,
        "classical_noise_db": _LEVEL,
        "classical_total_db": _LEVEL,
        "classical_total_to_noise_db": _LEVEL,
        "p_value": _LEVEL,
    },
    "Spectra": {
        "frequency": "Array",
        "signal": "Array",
        "noise": "Array",
        "total": "Array",
        "nonlinear": "Array",
        "classical_noise": "Array",
        "classical_total": "Array",
        "classical_nonlinear": "Array",
        "p_value": "Array?",
        "q_value": "Array?",
        "classical_p_value": "Array?",
    },
    "ElementShare": {"between": "string*", "share": "double", "confidence": "double", "separable": "bool"},
    "DetectionLevel": {
        "name": "string",
        "excited_db": _LEVEL,
        "odd_db": _LEVEL,
        "even_db": _LEVEL,
        "noise_db": _LEVEL,
    },
    "Estimate": {
        "scope": "string",
        "time": "int64",
        "realisation": "int64",
        "realisations": "int64",
        "experiments": "int64",
        "periods": "int64",
        "nodes": "NodeLevel*",
        "spectra": "Spectra",
        "located": "bool",
        "elements": "ElementShare*",
        "unavailable": "string*",
        "detection": "DetectionLevel*",
        "remarks": "string*",
    },
    "AlarmChange": {
        "id": "string",
        "rig": "string",
        "node": "string",
        "class": "string",
        "severity": "string",
        "event": "string",
        "state": "string",
        "active": "bool",
        "acknowledged": "bool",
        "shelved": "bool",
        "since": "int64",
        "time": "int64",
        "level_db": "double",
        "version": "int64",
        "condition": "string",
        "by": "string",
        "comment": "string",
        "shelved_until": "int64?",
        "suppressed": "bool",
        "out_of_service": "bool",
        "latched": "bool",
        "guidance": "string",
        "never_raised": "bool",
    },
    "FaultCount": {"kind": "string", "count": "int64"},
    "Counts": {
        "frames": "int64",
        "rejected_frames": "int64",
        "transient_frames": "int64",
        "realisations": "int64",
        "experiments": "int64",
        "faults": "FaultCount*",
    },
    "RunEnd": {
        "time": "int64",
        "status": "string",
        "counts": "Counts",
        "message": "string",
        "continues": "bool",
    },
    "Spectrum": {"freq": "double*", "level": "double*"},  # Hz, dB; a view, see creak.codec.views
}

TOPICS: Final = {
    "/run": "Run",
    "/frames": "Frame",
    "/faults": "Fault",
    "/estimates": "Estimate",
    "/alarms": "AlarmChange",
    "/end": "RunEnd",
}
"""Topic and message of every record; schema and channel ids count through these in this order, from 1.

The order is as binding as field numbers are: a reader knows the ids even where the part of a file that declares
them is damaged.
"""

TREND: Final = "NodeLevel"
"""Message of the per-node trend topics, declared after the others."""


def level_topic(node: str) -> str:
    """Topic on which plotting tools find the trend of a node's live levels."""
    return f"/levels/{node}"


def topics(rig: Rig) -> dict[str, str]:
    """All topics of a rig's recording with their messages, in the order of their channel ids."""
    return TOPICS | {level_topic(node.name): TREND for node in rig.nodes}


def full_name(message: str) -> str:
    """Name of a message as a schema carries it, for instance ``creak.Frame``."""
    return f"{_PACKAGE}.{message}"


def _describe() -> descriptor_pb2.FileDescriptorProto:
    """Build the file descriptor that protoc would make of these tables."""
    field_type = descriptor_pb2.FieldDescriptorProto
    scalars = {
        "int64": field_type.TYPE_INT64,
        "double": field_type.TYPE_DOUBLE,
        "bool": field_type.TYPE_BOOL,
        "string": field_type.TYPE_STRING,
        "bytes": field_type.TYPE_BYTES,
    }
    file = descriptor_pb2.FileDescriptorProto(name="creak.proto", package=_PACKAGE, syntax="proto3")
    for name, fields in LAYOUT.items():
        message = file.message_type.add(name=name)
        for number, (key, kind) in enumerate(fields.items(), start=1):
            base = kind.rstrip("?*")
            field = message.field.add(name=key, number=number)
            field.label = field_type.LABEL_REPEATED if kind.endswith("*") else field_type.LABEL_OPTIONAL
            if base in scalars:
                field.type = scalars[base]
            else:
                field.type = field_type.TYPE_MESSAGE
                field.type_name = f".{_PACKAGE}.{base}"
            if kind.endswith("?"):  # proto3 tells absent from zero through a oneof of one
                field.proto3_optional = True
                field.oneof_index = len(message.oneof_decl)
                message.oneof_decl.add(name=f"_{key}")
    return file


_FILE = _describe()
_POOL = descriptor_pool.DescriptorPool()
_POOL.Add(_FILE)

DESCRIPTOR_SET: Final[bytes] = descriptor_pb2.FileDescriptorSet(file=[_FILE]).SerializeToString()
"""Self-contained ``FileDescriptorSet``, the schema data of every message."""

MESSAGES: Final[dict[str, Any]] = {
    name: message_factory.GetMessageClass(_POOL.FindMessageTypeByName(full_name(name))) for name in LAYOUT
}
"""Message classes by name, in a pool of their own so that nothing else in the process can collide."""
