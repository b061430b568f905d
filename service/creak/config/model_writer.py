"""A model as the text of a model file, so that a corrected model can be kept, read and given on."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from creak.mechanics.beam import Beam
from creak.mechanics.effects import Effect
from creak.mechanics.structure import Lumped, Matrices, MeasuredResponse
from creak.mechanics.system import Model
from creak.records import Real

_BEAM_KEYS = ("length", "width", "thickness", "youngs_modulus", "density", "damping_ratio", "elements")
_STATION_KEYS = (
    "name",
    "position",
    "moving_mass",
    "suspension_stiffness",
    "suspension_damping",
    "actuator",
    "sensor",
    "force_constant",
)


def model_toml(model: Model) -> str:
    """Text of a model file for a model.

    Parameters
    ----------
    model : Model
        Matrices are written as rows of numbers, also if they were read from a file.

    Returns
    -------
    str
        TOML; ``parse_model`` of it gives an equal model, every number exactly.
    """
    match model:
        case Lumped():
            rows = _lumped(model)
        case Matrices():
            rows = _matrices(model)
        case Beam():
            rows = _beam(model)
        case MeasuredResponse():
            rows = ['kind = "frf"', f"recording = {_value(model.recording)}"]
            if model.realisations is not None:
                rows.append(f"realisations = {_value(model.realisations)}")
            if model.linear:
                rows.append("linear = true")
    for effect in model.effects:
        rows += _table("effects", _effect(effect))
    return "\n".join(rows) + "\n"


def _lumped(model: Lumped) -> list[str]:
    rows = ['kind = "lumped"']
    for mass in model.masses:
        rows += _table("masses", {"name": mass.name, "mass": mass.mass})
    for link in model.links:
        rows += _table("links", {"between": link.between, "stiffness": link.stiffness, "damping": link.damping})
    return rows


def _matrices(model: Matrices) -> list[str]:
    rows = ['kind = "matrices"']
    rows += [f"{key} = {_matrix(getattr(model, key))}" for key in ("mass", "damping", "stiffness")]
    for key, places in (("inputs", model.inputs), ("outputs", model.outputs)):
        pairs = ", ".join(f"{_value(name)} = {dof}" for name, dof in places.items())
        rows.append(f"{key} = {{{pairs}}}")
    return rows


def _beam(model: Beam) -> list[str]:
    rows = ['kind = "beam"', *(f"{key} = {_value(getattr(model, key))}" for key in _BEAM_KEYS)]
    for station in model.stations:
        rows += _table("stations", {key: getattr(station, key) for key in _STATION_KEYS})
    return rows


def _effect(effect: Effect) -> Mapping[str, Any]:
    return {"effect": effect.effect, "at": effect.at, **effect.parameters()}


def _table(name: str, values: Mapping[str, Any]) -> list[str]:
    return ["", f"[[{name}]]", *(f"{key} = {_value(value)}" for key, value in values.items())]


def _matrix(matrix: Real) -> str:
    rows = ",\n".join("    [" + ", ".join(map(_value, row)) + "]" for row in np.asarray(matrix, float).tolist())
    return f"[\n{rows},\n]"


def _value(value: object) -> str:
    """A TOML value; floats by their shortest text that reads back to the same number."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            # JSON's escapes are TOML's, but for DEL, which TOML wants escaped, and surrogates, which it has not.
            return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
        case tuple():
            return "[" + ", ".join(map(_value, value)) + "]"
        case int():
            return str(value)
        case _:
            return repr(float(value))  # type: ignore[arg-type]
