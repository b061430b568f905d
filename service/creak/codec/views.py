"""What tools that know nothing of creak show of a record: curves, and Foxglove's events and log lines.

Views stand in a recording beside the records that they are made of; a reader of creak passes over them.

=================================  ==================  ================================================
topic                              message             one message
=================================  ==================  ================================================
``/spectra/<node>/<quantity>``     ``creak.Spectrum``  a live estimate: ``freq`` (Hz), ``level`` (dB)
``/events``                        ``foxglove.Event``  an alarm change, from the alarm's begin until then
``/log``                           ``foxglove.Log``    an alarm change, a fault, begin and end of the run
=================================  ==================  ================================================

The messages of Foxglove are those of its own package ``foxglove-schemas-protobuf``.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.Event_pb2 import Event
from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.schema import build_file_descriptor_set

from creak.codec.protobuf import Closing, Opening
from creak.codec.schemas import DESCRIPTOR_SET, MESSAGES, full_name
from creak.records import AlarmChange, Estimate, Fault, Frame, Real, Rig, Scope

_SPECTRUM: Final = "Spectrum"
_TOLD: Final = ("id", "rig", "node", "class_", "severity", "event", "state", "condition", "by", "comment")

Viewed = Opening | Frame | Fault | Estimate | AlarmChange | Closing


@cache
def view_schemas() -> dict[str, bytes]:
    """Schema data of the views' messages, by their full names."""
    return {full_name(_SPECTRUM): DESCRIPTOR_SET} | {
        message.DESCRIPTOR.full_name: build_file_descriptor_set(message).SerializeToString()
        for message in (Event, Log)
    }


def view_topics(rig: Rig) -> dict[str, str]:
    """Topics of a rig's views with the full names of their messages.

    The quantities are the networked ones where they can exist, the classical ones elsewhere.
    """
    spectra = {
        spectrum_topic(node.name, quantity): full_name(_SPECTRUM)
        for node in rig.nodes
        for quantity in _quantities(rig)
    }
    return {"/events": Event.DESCRIPTOR.full_name, "/log": Log.DESCRIPTOR.full_name} | spectra


def spectrum_topic(node: str, quantity: str) -> str:
    """Topic of the live spectra of a node; quantities are named like the fields of `Spectra`."""
    return f"/spectra/{node}/{quantity}"


def views(record: Viewed, rig: Rig) -> Iterator[tuple[str, bytes]]:
    """Yield topic and message of every view of a record; none of a frame."""
    match record:
        case Estimate(scope=Scope.WINDOW):
            yield from _spectra(record, rig)
        case AlarmChange():
            yield "/events", _event(record)
            yield "/log", _log(record.time, _alarm_level(record), alarm_line(record), rig)
        case Fault():
            yield "/log", _log(record.time, Log.WARNING, record.message, rig)
        case Opening(run=run, part=part):
            line = f"run {run.id} begins" if part == 1 else f"part {part} of run {run.id} begins"
            yield "/log", _log(run.start, Log.INFO, f"{line}, source {run.source}", rig)
        case Closing(end=end):
            line = f"{end.status}" + (f": {end.message}" if end.message else "")
            yield "/log", _log(end.time, Log.INFO, line, rig)


def alarm_line(change: AlarmChange) -> str:
    """Say in one line what became of an alarm."""
    place = f"node {change.node}" if change.node not in {"", "*"} else f"rig {change.rig}"
    if change.class_ == "quality":
        return f"{place}: {change.condition.replace('_', ' ')} {change.event}"
    return f"{place}: {change.event} at {change.level_db:.1f} dB"


def _quantities(rig: Rig) -> tuple[str, ...]:
    prefix = "" if rig.square else "classical_"
    return ("signal", *(f"{prefix}{name}" for name in ("noise", "total", "nonlinear")))


def _spectra(estimate: Estimate, rig: Rig) -> Iterator[tuple[str, bytes]]:
    frequency = estimate.spectra.frequency.tolist()
    for quantity in _quantities(rig):
        levels = _decibels(getattr(estimate.spectra, quantity))
        for node, level in zip(rig.nodes, levels.T, strict=True):
            if np.isfinite(level).any():
                message = MESSAGES[_SPECTRUM](freq=frequency, level=level.tolist())
                yield spectrum_topic(node.name, quantity), message.SerializeToString()


def _decibels(power: Real) -> Real:
    """Levels of powers; NaN, which plots leave out, where there is none."""
    return 10 * np.log10(power, out=np.full_like(power, np.nan), where=power > 0)


def _event(change: AlarmChange) -> bytes:
    told = {key.rstrip("_"): str(getattr(change, key)) for key in _TOLD} | {"level_db": f"{change.level_db:.2f}"}
    event = Event(
        start_time=_timestamp(change.since),
        end_time=_timestamp(max(change.since, change.time)),
        metadata=[KeyValuePair(key=key, value=value) for key, value in told.items() if value],
    )
    return bytes(event.SerializeToString())


def _log(time: int, level: Any, line: str, rig: Rig) -> bytes:
    log = Log(timestamp=_timestamp(time), level=level, message=line, name=rig.name)
    return bytes(log.SerializeToString())


def _alarm_level(change: AlarmChange) -> Any:
    if change.event != "raised":
        return Log.INFO
    return Log.ERROR if change.severity == "alarm" else Log.WARNING


def _timestamp(time: int) -> Timestamp:
    seconds, nanos = divmod(time, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)
