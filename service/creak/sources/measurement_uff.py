"""Measurements as universal files (UFF, UNV), dataset 58: one experiment a file.

Which dataset is which channel:

1. *ID line 1* is a label ``u:<node>`` or ``y:<node>``, with or without a unit in brackets, like the columns of a
   CSV file.
2. Otherwise the *ordinate's specific data type* (record 9) tells: 13, excitation force, is an input; 8, 11 and 12,
   displacement, velocity and acceleration, are responses. The *response* degree of freedom (record 6) names the
   node: its node number with the direction (``3:+Z``), its entity name, or its node number (``3``), the first of
   these that the rig has. The reference degree of freedom is not looked at: a time history has none.

Only time responses count (function type 1, or 0 where it is not said); all other datasets are left alone.
"""

from pathlib import Path
from typing import Any

import numpy as np

from creak.errors import MeasurementError
from creak.records import Real, Rig
from creak.sources.measurement_channels import channel_of, channel_units, check_time, require_channels, stack
from creak.sources.measurement_checks import as_numbers, shown

_RESPONSES = {8: "m", 11: "m/s", 12: "m/s^2"}
_EXCITATION_FORCE = 13
_DIRECTIONS = {1: "X", 2: "Y", 3: "Z", 4: "RX", 5: "RY", 6: "RZ"}
_GENERAL, _TIME_RESPONSE = 0, 1


def read_uff(path: Path, rig: Rig) -> tuple[Real, Real]:
    """Read one experiment from the datasets 58 of a universal file, its channels told as the module's text says.

    Returns
    -------
    u : array, (q, T)
    y : array, (n, T)

    Raises
    ------
    MeasurementError
        Naming the dataset (counted from 1) and its channel.
    """
    import pyuff

    file = pyuff.UFF(str(path))
    channels: dict[str, Real] = {}
    labels: list[str] = []
    for index, kind in enumerate(file.get_set_types()):
        where = f"{path}: dataset {index + 1}"
        if kind == 164:
            _check_units(file.read_sets(index), where)
        if kind != 58 or file.read_sets(index, header_only=True)["func_type"] not in {_GENERAL, _TIME_RESPONSE}:
            continue
        dataset = file.read_sets(index)
        labels.append(_label(dataset))
        channel = _channel(dataset, rig, where)
        if channel is None:
            continue
        if channel in channels:
            raise MeasurementError(f"{where}: {channel}: is there twice")
        channels[channel] = _samples(dataset, rig, f"{where}: {channel}")
    require_channels(channels, rig, str(path), labels)
    return stack(channels, rig, str(path))


def _channel(dataset: dict[str, Any], rig: Rig, where: str) -> str | None:
    channel = channel_of(str(dataset["id1"]).strip(), rig, where)
    if channel is None:
        kind = int(dataset["ordinate_spec_data_type"])
        prefix = "u" if kind == _EXCITATION_FORCE else "y" if kind in _RESPONSES else None
        units = channel_units(rig)
        channel = next((name for name in (f"{prefix}:{dof}" for dof in _dofs(dataset)) if name in units), None)
        if channel is not None and prefix == "y" and units[channel] != _RESPONSES[kind]:
            raise MeasurementError(
                f"{where}: {channel}: data type {kind} ({_RESPONSES[kind]}), "
                f"expected {units[channel]} as the rig has it"
            )
    if channel is not None:
        unit, expected = _label_unit(dataset), channel_units(rig)[channel]
        if unit is not None and unit != _normal(expected):
            raise MeasurementError(
                f"{where}: {channel}: unit {shown(unit)}, expected {expected} as the rig has it"
            )
    return channel


def _dofs(dataset: dict[str, Any]) -> tuple[str, str, str]:
    """Names that the response degree of freedom may have in a rig, the most special first."""
    node, direction = int(dataset["rsp_node"]), int(dataset["rsp_dir"])
    sign = "-" if direction < 0 else "+"
    return f"{node}:{sign}{_DIRECTIONS.get(abs(direction), '')}", str(dataset["rsp_ent_name"]).strip(), str(node)


def _label(dataset: dict[str, Any]) -> str:
    """Return what a person would call the dataset."""
    name = str(dataset["id1"]).strip()
    dof, _, _ = _dofs(dataset)
    return f"{name} ({dof}, data type {dataset['ordinate_spec_data_type']})"


def _label_unit(dataset: dict[str, Any]) -> str | None:
    unit = _normal(str(dataset["ordinate_axis_units_lab"]))
    return None if unit in {"", "NONE"} else unit


def _normal(unit: str) -> str:
    """One spelling of a unit: m/s2, m/s**2 and m/s² are m/s^2."""
    unit = unit.replace(" ", "").replace("**", "^").replace("²", "^2")
    return unit.replace("s2", "s^2") if unit.endswith("/s2") else unit


def _samples(dataset: dict[str, Any], rig: Rig, where: str) -> Real:
    data = as_numbers(dataset["data"], where)
    if len(data) != dataset["num_pts"]:
        raise MeasurementError(f"{where}: {len(data)} samples, expected {dataset['num_pts']} as its header says")
    check_time(np.asarray(dataset["x"], dtype=np.float64), rig, f"{where}: time")
    return data


def _check_units(dataset: dict[str, Any], where: str) -> None:
    """Refuse a file whose units are not SI (dataset 164); which of its labels then hold is not certain."""
    for name in ("length", "force"):
        factor = float(dataset[name])
        if abs(factor - 1) > 1e-6:
            units = str(dataset["units_description"]).strip()
            raise MeasurementError(
                f"{where}: units {shown(units)}, {name} factor {factor:g}, expected SI with factor 1"
            )
