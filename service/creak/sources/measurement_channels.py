"""Named channels of one experiment: what the file formats with one experiment a file have in common.

A channel is named ``u:<node>`` (input) or ``y:<node>`` (response), with its unit in brackets if wanted:
``u:motor [A]``. Channels of other names are left alone.
"""

import re
from collections.abc import Iterable, Mapping

import numpy as np

from creak.errors import MeasurementError
from creak.records import Real, Rig
from creak.sources.measurement_checks import listing, shown

# Relative. An increment printed with six digits, as UFF has it, is right to 5e-6.
RATE_TOLERANCE = 1e-4

_LABEL = re.compile(r"(?P<channel>[uy]:.*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")


def channel_units(rig: Rig) -> dict[str, str]:
    """Return the unit of every channel that a measurement must have, inputs first, in the rig's order."""
    inputs = {f"u:{node.name}": node.input for node in rig.nodes if node.input is not None}
    return inputs | {f"y:{node.name}": node.output for node in rig.nodes}


def channel_of(label: str, rig: Rig, where: str) -> str | None:
    """Return the rig's channel that a label names, or None if it names none.

    Raises
    ------
    MeasurementError
        If the label gives another unit than the rig.
    """
    units = channel_units(rig)
    if label in units:
        return label
    match = _LABEL.fullmatch(label)
    if match is None or match["channel"] not in units:
        return None
    expected = units[match["channel"]]
    if match["unit"] is not None and match["unit"].strip() != expected:
        raise MeasurementError(
            f"{where}: unit {shown(match['unit'].strip())}, expected {expected} as the rig has it"
        )
    return match["channel"]


def require_channels(names: Iterable[str], rig: Rig, where: str, found: Iterable[str]) -> None:
    """Refuse an experiment that lacks a channel, naming it and what was found instead."""
    have = set(names)
    for name in channel_units(rig):
        if name not in have:
            raise MeasurementError(f"{where}: no channel {name}, found {listing(found)}")


def stack(channels: Mapping[str, Real], rig: Rig, where: str) -> tuple[Real, Real]:
    """Put the channels of an experiment in the rig's order.

    Parameters
    ----------
    channels : mapping of str to array, (T,)
        By name, complete.
    rig : Rig
    where : str
        File name for the message.

    Returns
    -------
    u : array, (q, T)
    y : array, (n, T)

    Raises
    ------
    MeasurementError
        If the channels differ in length.
    """
    names = list(channel_units(rig))
    samples = len(channels[names[0]])
    for name in names:
        if len(channels[name]) != samples:
            raise MeasurementError(
                f"{where}: {name}: {len(channels[name])} samples, expected {samples} as {names[0]} has"
            )
    table = np.stack([channels[name] for name in names])
    return table[: rig.q], table[rig.q :]


def check_time(time: Real, rig: Rig, where: str) -> None:
    """Refuse a time axis that is not that of the rig.

    Parameters
    ----------
    time : array, (T,)
        Seconds, from any origin.
    rig : Rig
    where : str
        File and channel, for the message.

    Raises
    ------
    MeasurementError
        If the mean rate differs from the rig's by more than 1e-4, or a step shows that samples are missing.
    """
    if len(time) < 2:
        return
    if not np.isfinite(time).all():
        raise MeasurementError(f"{where}: sample {int(np.argmin(np.isfinite(time)))} is not finite")
    steps = np.diff(time) * rig.sample_rate
    # A step may look longer by what printing with six digits does to two late times.
    longest = 1.5 + 1e-5 * rig.sample_rate * float(np.abs(time).max())
    odd = (steps > longest) | (steps < 0)
    if odd.any():
        at = int(np.argmax(odd))
        raise MeasurementError(
            f"{where}: goes on by {steps[at]:.6g} sample periods after sample {at}, expected even steps of 1"
        )
    mean = float(steps.mean())
    if abs(mean - 1) > RATE_TOLERANCE:
        rate = f"{rig.sample_rate / mean:.6g}" if mean else "infinite"
        raise MeasurementError(f"{where}: sample rate {rate} Hz, expected {rig.sample_rate:g} Hz")
