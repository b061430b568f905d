"""A straight beam in bending with free ends, on springs and dampers at stations.

Euler-Bernoulli elements with consistent mass; two coordinates a mesh node, deflection (m) and slope (rad).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import eigh

from creak.mechanics.effects import GROUND, Effect
from creak.mechanics.structure import Body, check_effects, check_names, check_number, refusal
from creak.records import Real


@dataclass(frozen=True)
class Station:
    """A place on the beam where something is attached.

    Parameters
    ----------
    name : str
    position : float
        From the beam's end, m.
    moving_mass : float
        Mass that moves with the beam, kg.
    suspension_stiffness, suspension_damping : float
        To the ground, N/m and N s/m.
    actuator, sensor : bool
        Whether it can be driven, and measured.
    force_constant : float
        Newton per unit of input.
    """

    name: str
    position: float
    moving_mass: float = 0.0
    suspension_stiffness: float = 0.0
    suspension_damping: float = 0.0
    actuator: bool = False
    sensor: bool = False
    force_constant: float = 1.0


@dataclass(frozen=True)
class Beam:
    """A uniform beam of rectangular section, bending in the direction of its thickness.

    Parameters
    ----------
    length, width, thickness : float
        m.
    youngs_modulus : float
        Pa.
    density : float
        kg/m^3.
    damping_ratio : float
        Of every mode of the beam with its moving masses but without suspension, whose dampers come on top.
    elements : int
        Elements over the length; every station lies on a mesh node, so there may be a few more.
    stations : tuple of Station
    effects : tuple of Effect

    Raises
    ------
    ConfigurationError
        Key and problem, where the model contradicts itself.
    """

    length: float
    width: float
    thickness: float
    youngs_modulus: float
    density: float
    damping_ratio: float
    elements: int
    stations: tuple[Station, ...]
    effects: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        for key in ("length", "width", "thickness", "youngs_modulus", "density"):
            check_number(key, getattr(self, key), positive=True)
        check_number("damping_ratio", self.damping_ratio)
        if not 1 <= self.elements <= 1000:
            raise refusal("elements", f"{self.elements}, must be 1 to 1000")
        if not self.stations:
            raise refusal("stations", "none given, must be at least one")
        check_names("stations", [station.name for station in self.stations])
        for i, station in enumerate(self.stations):
            for key in ("position", "moving_mass", "suspension_stiffness", "suspension_damping"):
                check_number(f"stations[{i}].{key}", getattr(station, key))
            check_number(f"stations[{i}].force_constant", station.force_constant, positive=True)
            if station.position > self.length:
                raise refusal(
                    f"stations[{i}].position", f"{station.position!r}, must lie on the beam, 0 to {self.length!r}"
                )
        check_effects(
            self.effects,
            {station.name for station in self.stations},
            {station.name for station in self.stations if station.actuator},
            {station.name for station in self.stations if station.sensor},
        )

    def mesh(self) -> Real:
        """Positions of the mesh nodes, rising, m; among them both ends and every station."""
        marks = [0.0]
        for position in sorted({*(station.position for station in self.stations), self.length}):
            if position - marks[-1] > 1e-6 * self.length:
                marks.append(position)
        marks[-1] = self.length
        pieces = [
            np.linspace(a, b, max(1, round(self.elements * (b - a) / self.length)), endpoint=False)
            for a, b in pairwise(marks)
        ]
        return np.append(np.concatenate(pieces), self.length)

    def full(self) -> Body:
        """Assemble all elements; coordinates deflection and slope of every mesh node."""
        mesh = self.mesh()
        size = 2 * mesh.size
        mass = np.zeros((size, size))
        stiffness = np.zeros((size, size))
        for e, length in enumerate(np.diff(mesh)):
            at = slice(2 * e, 2 * e + 4)
            area = self.width * self.thickness
            mass[at, at] += _element_mass(length, self.density * area)
            stiffness[at, at] += _element_stiffness(length, self.youngs_modulus * area * self.thickness**2 / 12)
        rows = {
            station.name: np.eye(size)[2 * int(np.argmin(np.abs(mesh - station.position)))]
            for station in self.stations
        }
        for station in self.stations:
            mass += station.moving_mass * np.outer(rows[station.name], rows[station.name])
        damping = _modal_damping(mass, stiffness, self.damping_ratio)
        for station in self.stations:
            b = rows[station.name]
            stiffness += station.suspension_stiffness * np.outer(b, b)
            damping += station.suspension_damping * np.outer(b, b)
        return Body(
            mass,
            damping,
            stiffness,
            {**rows, GROUND: np.zeros(size)},
            {s.name: s.force_constant * rows[s.name] for s in self.stations if s.actuator},
            {s.name: rows[s.name] for s in self.stations if s.sensor},
        )

    def body(self, top_frequency: float) -> Body:
        """Reduce to the modes below a frequency and what the others add quasi-statically.

        The basis is that of mode acceleration: the undamped modes below `top_frequency`, and one residual
        flexibility shape for every station that can be driven or holds an effect, so that a force there
        finds its exact static stiffness.

        Parameters
        ----------
        top_frequency : float
            Hz.

        Returns
        -------
        Body
            In modal coordinates, in which the mass matrix is the identity.
        """
        full = self.full()
        squares, shapes = eigh(full.stiffness, full.mass)
        low = squares <= (2 * np.pi * top_frequency) ** 2
        forced = {name for effect in self.effects for name in effect.at} - {GROUND}
        loads = [full.points[s.name] for s in self.stations if s.actuator or s.name in forced]
        basis = shapes[:, low]
        if loads and not low.all():
            high = shapes[:, ~low]
            flexibility = high @ ((high.T @ np.column_stack(loads)) / squares[~low, None])
            # As many independent shapes as there are; stations at one place share theirs.
            weights, turns = eigh(flexibility.T @ full.mass @ flexibility)
            kept = weights > 1e-12 * weights[-1]
            basis = np.column_stack([basis, flexibility @ turns[:, kept] / np.sqrt(weights[kept])])
        _, turn = eigh(basis.T @ full.stiffness @ basis, basis.T @ full.mass @ basis)
        basis = basis @ turn
        return Body(
            np.eye(basis.shape[1]),
            basis.T @ full.damping @ basis,
            basis.T @ full.stiffness @ basis,
            {name: row @ basis for name, row in full.points.items()},
            {name: row @ basis for name, row in full.actuators.items()},
            {name: row @ basis for name, row in full.sensors.items()},
        )


def _element_mass(length: float, line_density: float) -> Real:
    a = length
    return (line_density * a / 420) * np.array(
        [
            [156, 22 * a, 54, -13 * a],
            [22 * a, 4 * a**2, 13 * a, -3 * a**2],
            [54, 13 * a, 156, -22 * a],
            [-13 * a, -3 * a**2, -22 * a, 4 * a**2],
        ]
    )


def _element_stiffness(length: float, bending_stiffness: float) -> Real:
    a = length
    return (bending_stiffness / a**3) * np.array(
        [
            [12, 6 * a, -12, 6 * a],
            [6 * a, 4 * a**2, -6 * a, 2 * a**2],
            [-12, -6 * a, 12, -6 * a],
            [6 * a, 2 * a**2, -6 * a, 4 * a**2],
        ]
    )


def _modal_damping(mass: Real, stiffness: Real, ratio: float) -> Real:
    """Matrix that gives every mode the same damping ratio, and a free motion none."""
    squares, shapes = eigh(stiffness, mass)
    # Free motions come out as squares of rounding size, of either sign.
    squares = np.where(squares > 1e-12 * squares[-1], squares, 0.0)
    weighted = mass @ shapes
    return np.asarray((weighted * (2 * ratio * np.sqrt(squares))) @ weighted.T)
