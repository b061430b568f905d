"""The model file ``model.toml``: what the simulator and the diagnosis believe of a structure."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from pydantic import Field, ValidationError

from creak.config.fields import Strict
from creak.config.validation import explain, parse_toml, read_text
from creak.errors import ConfigurationError
from creak.mechanics.beam import Beam, Station
from creak.mechanics.effects import GROUND, Effect
from creak.mechanics.structure import Link, Lumped, Matrices, MeasuredResponse, PointMass
from creak.mechanics.system import Model
from creak.mechanics.vocabulary import VOCABULARY
from creak.records import Real

Number = Annotated[float, Field(strict=True)]
Whole = Annotated[int, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]
_Matrix = list[list[Number]] | str


class _MassTable(Strict):
    name: str
    mass: Number


class _LinkTable(Strict):
    between: tuple[str, str]
    stiffness: Number
    damping: Number = 0.0


class _LumpedTable(Strict):
    masses: list[_MassTable]
    links: list[_LinkTable] = Field(default=[])


class _MatricesTable(Strict):
    mass: _Matrix
    damping: _Matrix
    stiffness: _Matrix
    inputs: dict[str, Whole]
    outputs: dict[str, Whole]


class _StationTable(Strict):
    name: str
    position: Number
    moving_mass: Number = 0.0
    suspension_stiffness: Number = 0.0
    suspension_damping: Number = 0.0
    actuator: Flag = False
    sensor: Flag = False
    force_constant: Number = 1.0


class _BeamTable(Strict):
    length: Number
    width: Number
    thickness: Number
    youngs_modulus: Number
    density: Number
    damping_ratio: Number
    elements: Whole
    stations: list[_StationTable]


class _MeasuredTable(Strict):
    recording: str
    realisations: tuple[Whole, Whole] | None = None
    linear: Flag = False


def load_model(path: Path) -> Model:
    """Model from a model file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    Model

    Raises
    ------
    ConfigurationError
        If the file, or one that it names, cannot be read or holds what is not allowed.
    """
    return parse_model(read_text(path), str(path))


def parse_model(text: str, source: str) -> Model:
    """Model from the text of a model file.

    Parameters
    ----------
    text : str
        TOML.
    source : str
        Name of the file, for messages; matrices and recordings in files are looked up beside it.

    Returns
    -------
    Model

    Raises
    ------
    ConfigurationError
        One line that names file, key and value, and says what is allowed.
    """
    tables = parse_toml(text, source)
    kind = tables.pop("kind", None)
    if kind is None:
        raise ConfigurationError(source, "kind", f"is missing; allowed are {', '.join(_KINDS)}")
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ConfigurationError(source, "kind", f"{kind!r} is not known; allowed are {', '.join(_KINDS)}")
    effects = _effects(tables.pop("effects", []), source)
    try:
        return _KINDS[kind](tables, effects, source)
    except ValidationError as error:
        raise explain(error, source) from None
    except ConfigurationError as error:
        if error.source != "model":
            raise
        raise ConfigurationError(source, error.key, error.problem) from None


def _lumped(tables: Mapping[str, Any], effects: tuple[Effect, ...], _source: str) -> Model:
    table = _LumpedTable.model_validate(tables)
    return Lumped(
        tuple(PointMass(mass.name, mass.mass) for mass in table.masses),
        tuple(Link(link.between, link.stiffness, link.damping) for link in table.links),
        effects,
    )


def _matrices(tables: Mapping[str, Any], effects: tuple[Effect, ...], source: str) -> Model:
    for key in ("mass", "damping", "stiffness"):
        if isinstance(tables.get(key), list):
            _check_rows(tables[key], key, source)
    table = _MatricesTable.model_validate(tables)
    return Matrices(
        _matrix(table.mass, "mass", source),
        _matrix(table.damping, "damping", source),
        _matrix(table.stiffness, "stiffness", source),
        table.inputs,
        table.outputs,
        effects,
    )


def _beam(tables: Mapping[str, Any], effects: tuple[Effect, ...], _source: str) -> Model:
    table = _BeamTable.model_validate(tables)
    stations = tuple(Station(**station.model_dump()) for station in table.stations)
    values = {key: getattr(table, key) for key in _BeamTable.model_fields if key != "stations"}
    return Beam(**values, stations=stations, effects=effects)


def _measured(tables: Mapping[str, Any], effects: tuple[Effect, ...], _source: str) -> Model:
    table = _MeasuredTable.model_validate(tables)
    return MeasuredResponse(table.recording, effects, table.realisations, table.linear)


_KINDS: Final[Mapping[str, Callable[[Mapping[str, Any], tuple[Effect, ...], str], Model]]] = {
    "lumped": _lumped,
    "matrices": _matrices,
    "beam": _beam,
    "frf": _measured,
}


_EITHER_WAY: Final = frozenset(
    {"stiffness", "damping", "mass", "cubic_stiffness", "clearance"}
    | {"coulomb_friction", "quadratic_damping", "hysteresis"}
)
"""Effects of odd law, for which ``["ground", "1"]`` is the same as ``["1", "ground"]``."""


def _effects(tables: object, source: str) -> tuple[Effect, ...]:
    if not isinstance(tables, list):
        raise ConfigurationError(source, "effects", "must be a list of tables, [[effects]]")
    return tuple(_effect(table, f"effects[{i}]", source) for i, table in enumerate(tables))


def _effect(table: object, where: str, source: str) -> Effect:
    if not isinstance(table, dict):
        raise ConfigurationError(source, where, "must be a table, [[effects]]")
    values = dict(table)
    for key in ("effect", "at"):
        if key not in values:
            raise ConfigurationError(source, f"{where}.{key}", "is missing")
    name, at = values.pop("effect"), values.pop("at")
    if not isinstance(name, str) or name not in VOCABULARY:
        raise ConfigurationError(
            source, f"{where}.effect", f"{name!r} is not known; allowed are {', '.join(VOCABULARY)}"
        )
    if not isinstance(at, list) or not all(isinstance(end, str) for end in at):
        raise ConfigurationError(source, f"{where}.at", f"{at!r}, must be a list of node names")
    kind = VOCABULARY[name]
    parameters = kind.parameter_names()
    for key, value in values.items():
        if key not in parameters:
            raise ConfigurationError(
                source, f"{where}.{key}", f"is no parameter of {name}, which takes {', '.join(parameters)}"
            )
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ConfigurationError(source, f"{where}.{key}", f"{value!r}, must be a number")
    for key in parameters:
        if key not in values:
            raise ConfigurationError(source, f"{where}.{key}", f"is missing; {name} needs it")
    if at[:1] == [GROUND] and len(at) == 2 and name in _EITHER_WAY:
        at = at[::-1]
    try:
        return kind(tuple(at), **{key: float(value) for key, value in values.items()})
    except ConfigurationError as error:
        raise ConfigurationError(source, f"{where}.{error.key}", error.problem) from None


def _check_rows(rows: list[Any], key: str, source: str) -> None:
    for i, row in enumerate(rows):
        if not isinstance(row, list) or len(row) != len(rows):
            found = f"{len(row)} values" if isinstance(row, list) else repr(row)
            raise ConfigurationError(
                source, f"{key}[{i}]", f"{found}, must be a row of {len(rows)} numbers, as many as there are rows"
            )
        for j, value in enumerate(row):
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ConfigurationError(source, f"{key}[{i}][{j}]", f"{value!r}, must be a number")


def _matrix(value: list[list[float]] | str, key: str, source: str) -> Real:
    """Matrix from numbers, or from a file beside the model."""
    if not isinstance(value, str):
        return np.array(value, dtype=np.float64)
    try:
        return np.asarray(_read_matrix(Path(source).parent / value, key), dtype=np.float64)
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
    except (ValueError, TypeError, EOFError) as error:
        problem = f"holds no matrix of real numbers: {str(error).splitlines()[0]}"
    raise ConfigurationError(source, key, f"{value!r} {problem}")


def _read_matrix(path: Path, key: str) -> Any:
    """Array in a file; of an npz the one of that name, or the only one."""
    match path.suffix.lower():
        case ".npy":
            return np.load(path, allow_pickle=False)
        case ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                names = list(arrays)
                if key not in names and len(names) != 1:
                    raise ValueError(f"it has {', '.join(names)}, and should have {key!r}")
                return arrays[key if key in names else names[0]]
        case ".csv":
            return np.loadtxt(path, delimiter=",", ndmin=2)
    raise ValueError("should be rows of numbers, or a file .npy, .npz or .csv")
