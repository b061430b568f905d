"""Records as the JSON that the command line and the API show; the keys are the public contract.

Every number is finite or null: JSON has no NaN and no infinity.
"""

import math
import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta, timezone
from typing import Any

import numpy as np

from creak.errors import InputError
from creak.findings import DetectionLevel
from creak.records import (
    AlarmChange,
    AlarmState,
    Counts,
    ElementShare,
    Estimate,
    Fault,
    NodeLevel,
    Real,
    Spectra,
)
from creak.significance import FALSE_DISCOVERIES, octaves, pooled_p_value

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_TIME = re.compile(
    r"(?P<date>\d{4}-\d\d-\d\d)"
    r"(?:[T ](?P<clock>\d\d:\d\d(?::\d\d)?)(?:[.,](?P<fraction>\d+))?\s*(?P<zone>Z|[+-]\d\d(?::?\d\d)?)?)?",
    re.ASCII | re.IGNORECASE,
)


def time_json(time: int) -> str:
    """Write a recorded time in ISO 8601, UTC: six decimals, or nine where it is no whole microsecond.

    Parameters
    ----------
    time : int
        Nanoseconds since the Unix epoch, within 64 bits (the years 1677 to 2262).
    """
    seconds, rest = divmod(time, 1_000_000_000)
    moment = (_EPOCH + timedelta(seconds=seconds)).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{moment}.{rest // 1000:06d}Z" if rest % 1000 == 0 else f"{moment}.{rest:09d}Z"


def moment_json(time: int | None) -> str | None:
    """Write a recorded time that there may not be."""
    return None if time is None else time_json(time)


def parse_time(text: str) -> int:
    """Read an ISO 8601 time or date as nanoseconds since the Unix epoch.

    A date alone is its midnight; without an offset the time is UTC.

    Raises
    ------
    InputError
        No such time, one finer than a nanosecond, or one outside 1677-09-22 to 2262-04-11.
    """
    allowed = "allowed is ISO 8601, for instance 2026-05-01, 2026-05-01T08:30:00Z or 2026-05-01T08:30:00.25+02:00"
    match = _TIME.fullmatch(text.strip())
    if match is None:
        raise InputError(f"{text!r} is not a time; {allowed}")
    fraction = (match["fraction"] or "").rstrip("0")
    if len(fraction) > 9 or (fraction and len(match["clock"]) < 8):
        raise InputError(f"{text!r} is not a time in whole nanoseconds; {allowed}")
    try:
        moment = datetime.fromisoformat(f"{match['date']}T{match['clock'] or '00:00'}")
        moment = moment.replace(tzinfo=_zone(match["zone"] or "Z"))
    except ValueError as error:
        raise InputError(f"{text!r} is not a time ({error}); {allowed}") from None
    passed = moment - _EPOCH
    time = (passed.days * 86400 + passed.seconds) * 1_000_000_000 + int(fraction.ljust(9, "0"))
    if not -(2**63) <= time < 2**63:
        raise InputError(f"{text!r} lies outside 1677-09-22 to 2262-04-11, which nanoseconds in 64 bits can tell")
    return time


def _zone(text: str) -> timezone:
    if text in "Zz":
        return UTC
    minutes = int(text[1:3]) * 60 + int(text[3:].lstrip(":") or "0")
    return timezone(timedelta(minutes=-minutes if text[0] == "-" else minutes))


def node_json(level: NodeLevel, alarm: AlarmState) -> dict[str, Any]:
    """Show a node with its levels and the state of its alarm."""
    return {
        "name": level.name,
        "signal_db": number_json(level.signal_db),
        "noise_db": number_json(level.noise_db),
        "total_db": number_json(level.total_db),
        "nonlinear_db": number_json(level.nonlinear_db),
        "total_to_noise_db": number_json(level.total_to_noise_db),
        "classical_total_to_noise_db": number_json(level.classical_total_to_noise_db),
        "p_value": number_json(level.p_value),
        "alarm": alarm.value,
        "classical_noise_db": number_json(level.classical_noise_db),
        "classical_total_db": number_json(level.classical_total_db),
    }


def element_json(element: ElementShare) -> dict[str, Any]:
    """Show a place where distortion acts."""
    return {
        "between": list(element.between),
        "share": number_json(element.share),
        "confidence": number_json(element.confidence),
        "separable": element.separable,
    }


def detection_json(level: DetectionLevel) -> dict[str, Any]:
    """Show what the lines left out say about a node."""
    return {
        "name": level.name,
        "excited_db": number_json(level.excited_db),
        "odd_db": number_json(level.odd_db),
        "even_db": number_json(level.even_db),
        "noise_db": number_json(level.noise_db),
    }


def alarm_json(change: AlarmChange) -> dict[str, Any]:
    """Show an alarm occurrence as its newest change leaves it."""
    return {
        "id": change.id,
        "rig": change.rig,
        "node": change.node,
        "class": change.class_,
        "severity": change.severity,
        "state": change.state.value,
        "active": change.active,
        "acknowledged": change.acknowledged,
        "shelved": change.shelved,
        "since": time_json(change.since),
        "level_db": number_json(change.level_db),
        "event": change.event,
        "time": time_json(change.time),
        "version": change.version,
        "condition": change.condition,
        "by": change.by,
        "comment": change.comment,
        "shelved_until": moment_json(change.shelved_until),
        "suppressed": change.suppressed,
        "out_of_service": change.out_of_service,
        "latched": change.latched,
        "guidance": change.guidance,
    }


def fault_json(fault: Fault) -> dict[str, Any]:
    """Show data that were refused or never came."""
    return {
        "kind": fault.kind.value,
        "time": time_json(fault.time),
        "message": fault.message,
        "realisation": fault.realisation,
        "experiment": fault.experiment,
        "period": fault.period,
    }


def summary_json(
    rig_name: str,
    counts: Counts,
    estimate: Estimate | None,
    alarms: Mapping[str, AlarmState],
    truncated: bool,
    *,
    unavailable: Iterable[str] = (),
) -> dict[str, Any]:
    """Sum up a whole run: the document of ``creak replay --json``.

    Parameters
    ----------
    rig_name : str
    counts : Counts
    estimate : Estimate or None
        The last one over the run; None if there is none, and every level is then null.
    alarms : mapping of str to AlarmState
        State at the end for every node of the rig, in its order.
    truncated : bool
        The recording ended before its end record.
    unavailable : iterable of str
        What the data do not carry, beyond what the estimate says itself.
    """
    nodes = estimate.nodes if estimate is not None else tuple(map(NodeLevel, alarms))
    said = (*(estimate.unavailable if estimate is not None else ()), *unavailable)
    return {
        "rig": rig_name,
        "frames": counts.frames,
        "rejected_frames": counts.rejected_frames,
        "experiments": counts.experiments,
        "realisations": counts.realisations,
        "truncated": truncated,
        "nodes": [node_json(node, alarms.get(node.name, AlarmState.NORMAL)) for node in nodes],
        "elements": [element_json(element) for element in (estimate.elements if estimate is not None else ())],
        "located": estimate is not None and estimate.located,
        "transient_frames": counts.transient_frames,
        "faults": dict(counts.faults),
        "unavailable": list(dict.fromkeys(said)),
        "detection": [detection_json(level) for level in (estimate.detection if estimate is not None else ())],
        "remarks": list(estimate.remarks) if estimate is not None else [],
    }


def spectrum_json(estimate: Estimate, node: str) -> dict[str, Any]:
    """Show the levels of one node per excited line, dB re 1 unit squared, and what of them is significant.

    They are null where the power is not positive or not known. The first of ``bands`` is all lines.

    Raises
    ------
    InputError
        The estimate has no such node.
    """
    names = [level.name for level in estimate.nodes]
    if node not in names:
        raise InputError(f"{node!r} is not a node; there are {', '.join(names)}")
    column, spectra = names.index(node), estimate.spectra
    powers = {
        "signal_db": spectra.signal,
        "noise_db": spectra.noise,
        "total_db": spectra.total,
        "nonlinear_db": spectra.nonlinear,
        "classical_noise_db": spectra.classical_noise,
        "classical_total_db": spectra.classical_total,
        "classical_nonlinear_db": spectra.classical_nonlinear,
    }
    levels = {key: _decibels(power[:, column]) for key, power in powers.items()}
    return {"frequency_hz": spectra.frequency.tolist()} | levels | _significance(spectra, column)


def _significance(spectra: Spectra, column: int) -> dict[str, Any]:
    """What of a node's spectrum is significant: per line, per octave, and over all lines."""
    lines = len(spectra.frequency)
    unknown = np.full(lines, np.nan)
    p, q, classical = (
        unknown if values is None else values[:, column]
        for values in (spectra.p_value, spectra.q_value, spectra.classical_p_value)
    )
    bands = [
        {
            "from_hz": float(spectra.frequency[band][0]),
            "to_hz": float(spectra.frequency[band][-1]),
            "lines": len(spectra.frequency[band]),
            "p_value": number_json(float(pooled_p_value(p[band]))),
            "classical_p_value": number_json(float(pooled_p_value(classical[band]))),
        }
        for band in (slice(0, lines), *octaves(spectra.frequency))
    ]
    return {
        "p_value": [number_json(value) for value in p.tolist()],
        "q_value": [number_json(value) for value in q.tolist()],
        "classical_p_value": [number_json(value) for value in classical.tolist()],
        "false_discovery_rate": FALSE_DISCOVERIES,
        "significant": [None if math.isnan(value) else value <= FALSE_DISCOVERIES for value in q.tolist()],
        "bands": bands if lines else [],
    }


def number_json(value: float | None) -> float | None:
    """Write a number; JSON has none for what is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def _decibels(power: Real) -> list[float | None]:
    known = np.isfinite(power) & (power > 0)
    levels = 10 * np.log10(np.where(known, power, 1.0))
    return [level if there else None for level, there in zip(levels.tolist(), known.tolist(), strict=True)]
