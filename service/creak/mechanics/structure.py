"""Structures as matrices, ``M a + C v + K x = B u``: chains of masses, and matrices that the user has.

All numbers are SI. A point of a structure is a row ``b`` with ``x_point = b x``; a force at the point acts
through the same row.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from creak.errors import ConfigurationError
from creak.mechanics.effects import GROUND, Effect
from creak.mechanics.response import Response
from creak.records import Real


@dataclass(frozen=True, eq=False)
class Body:
    """A linear structure with named points.

    Parameters
    ----------
    mass, damping, stiffness : array, (dof, dof)
    points : mapping of str to array, (dof,)
        Displacement of every named point as a row over the coordinates; effects act here.
    actuators : mapping of str to array, (dof,)
        Force on the coordinates per unit of input, for points that can be driven.
    sensors : mapping of str to array, (dof,)
        Displacement of the points that can be measured.
    """

    mass: Real
    damping: Real
    stiffness: Real
    points: Mapping[str, Real]
    actuators: Mapping[str, Real]
    sensors: Mapping[str, Real]


@dataclass(frozen=True)
class PointMass:
    """A mass of a lumped model, kg."""

    name: str
    mass: float


@dataclass(frozen=True)
class Link:
    """A linear spring and damper between two masses, or a mass and the ground; N/m and N s/m."""

    between: tuple[str, str]
    stiffness: float
    damping: float = 0.0


@dataclass(frozen=True)
class Lumped:
    """Masses joined by springs and dampers; every mass can be driven and measured.

    Raises
    ------
    ConfigurationError
        Key and problem, where the model contradicts itself.
    """

    masses: tuple[PointMass, ...]
    links: tuple[Link, ...]
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        if not self.masses:
            raise refusal("masses", "none given, must be at least one")
        check_names("masses", [mass.name for mass in self.masses])
        for i, mass in enumerate(self.masses):
            check_number(f"masses[{i}].mass", mass.mass, positive=True)
        names = {mass.name for mass in self.masses}
        for i, link in enumerate(self.links):
            if len(set(link.between)) != 2:
                raise refusal(f"links[{i}].between", f"{list(link.between)}, must name two different ends")
            for end in link.between:
                if end != GROUND and end not in names:
                    raise refusal(f"links[{i}].between", f"{end!r} is no mass; known are {listed(names)}")
            check_number(f"links[{i}].stiffness", link.stiffness)
            check_number(f"links[{i}].damping", link.damping)
        check_effects(self.effects, names, names, names)

    def body(self) -> Body:
        """Assemble; one coordinate a mass, in their order."""
        size = len(self.masses)
        rows = dict(zip((mass.name for mass in self.masses), np.eye(size), strict=True))
        points = {**rows, GROUND: np.zeros(size)}
        stiffness = np.zeros((size, size))
        damping = np.zeros((size, size))
        for link in self.links:
            b = points[link.between[0]] - points[link.between[1]]
            stiffness += link.stiffness * np.outer(b, b)
            damping += link.damping * np.outer(b, b)
        return Body(np.diag([mass.mass for mass in self.masses]), damping, stiffness, points, rows, rows)


@dataclass(frozen=True, eq=False)
class Matrices:
    """Mass, damping and stiffness matrices as the user has them.

    Parameters
    ----------
    mass, damping, stiffness : array, (dof, dof)
        The mass matrix symmetric and positive definite.
    inputs, outputs : mapping of str to int
        Degree of freedom by node name.
    effects : tuple of Effect
        At nodes that have an output, or else an input.

    Raises
    ------
    ConfigurationError
        Key and problem, where shapes or degrees of freedom do not fit.
    """

    mass: Real
    damping: Real
    stiffness: Real
    inputs: Mapping[str, int]
    outputs: Mapping[str, int]
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        shape = np.shape(self.mass)
        if len(shape) != 2 or shape[0] != shape[1] or not shape[0]:
            raise refusal("mass", f"shape {shape}, must be square")
        for key, matrix in (("mass", self.mass), ("damping", self.damping), ("stiffness", self.stiffness)):
            if np.shape(matrix) != shape:
                raise refusal(key, f"shape {np.shape(matrix)}, must be that of mass, {shape}")
            if not np.isfinite(matrix).all():
                raise refusal(key, "holds a value that is not finite")
        check_mass("mass", self.mass)
        for key, map_ in (("inputs", self.inputs), ("outputs", self.outputs)):
            check_names(key, list(map_))
            for name, dof in map_.items():
                if not 0 <= dof < shape[0]:
                    raise refusal(f"{key}.{name}", f"{dof}, must be a degree of freedom, 0 to {shape[0] - 1}")
        check_effects(self.effects, {*self.inputs, *self.outputs}, set(self.inputs), set(self.outputs))

    def body(self) -> Body:
        """Take the coordinates as they are."""
        unit = np.eye(len(self.mass))
        inputs = {name: unit[dof] for name, dof in self.inputs.items()}
        outputs = {name: unit[dof] for name, dof in self.outputs.items()}
        points = {**inputs, **outputs, GROUND: np.zeros(len(unit))}
        return Body(self.mass, self.damping, self.stiffness, points, inputs, outputs)


@dataclass(frozen=True)
class MeasuredResponse:
    """The response matrix that a recording holds (kind ``frf``): for diagnosis, not for simulation.

    Parameters
    ----------
    recording : str
        File.
    effects : tuple of Effect
        Added to the structure at its nodes.
    realisations : pair of int, optional
        First and last that count, from 0; by default all.
    linear : bool
        The response is all there is: distortion that the recording had already counts as a gap.
    response : Response, optional
        What the recording holds, once it has been read.
    """

    recording: str
    effects: tuple[Effect, ...] = field(default=())
    realisations: tuple[int, int] | None = None
    linear: bool = False
    response: Response | None = field(default=None, compare=False, repr=False)


def refusal(key: str, problem: str) -> ConfigurationError:
    """Error for one key of a model; whoever knows the file's name puts it in front."""
    return ConfigurationError("model", key, problem)


def listed(names: set[str]) -> str:
    """Names for a message."""
    return ", ".join(map(repr, sorted(names))) or "none"


def check_number(key: str, value: float, *, positive: bool = False) -> None:
    """Refuse what is not finite, negative, or zero where that cannot be."""
    if not math.isfinite(value) or value < 0 or (positive and value == 0):
        rule = "greater than 0" if positive else "0 or greater"
        raise refusal(key, f"{value!r}, must be finite and {rule}")


def check_names(key: str, names: list[str]) -> None:
    """Refuse names that are empty, doubled, or the ground's."""
    for name in names:
        if not name or name == GROUND:
            raise refusal(key, f"{name!r} cannot be the name of a node")
        if names.count(name) > 1:
            raise refusal(key, f"the name {name!r} is given {names.count(name)} times")


def check_mass(key: str, mass: Real) -> None:
    """Refuse a mass matrix that is not symmetric and positive definite."""
    if not np.allclose(mass, mass.T, rtol=1e-9, atol=0):
        raise refusal(key, "must be symmetric")
    lowest = float(np.linalg.eigvalsh(mass)[0])
    if lowest <= 0:
        raise refusal(key, f"must be positive definite, its lowest eigenvalue is {lowest:.3g} kg")


def check_effects(effects: tuple[Effect, ...], points: set[str], driven: set[str], measured: set[str]) -> None:
    """Refuse effects at places that the model does not have."""
    for i, effect in enumerate(effects):
        for name in effect.at:
            if name != GROUND and name not in points:
                raise refusal(f"effects[{i}].at", f"{name!r} is no node; known are {listed(points)}")
        if effect.effect.startswith("actuator_") and effect.at[0] not in driven:
            raise refusal(f"effects[{i}].at", f"{effect.at[0]!r} has no actuator; {listed(driven)} have")
        if effect.effect.startswith("sensor_") and effect.at[0] not in measured:
            raise refusal(f"effects[{i}].at", f"{effect.at[0]!r} has no sensor; {listed(measured)} have")
