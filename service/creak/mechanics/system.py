"""A model seen through a rig: matrices, inputs, outputs and nonlinear elements, ready to be simulated."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Self, TypeAlias

import numpy as np

from creak.errors import ConfigurationError
from creak.mechanics.beam import Beam
from creak.mechanics.effects import GROUND, Damping, Mass, Resonator, Restoring, Stiffness
from creak.mechanics.electronics import Actuator, Sensor
from creak.mechanics.structure import Body, Lumped, Matrices, MeasuredResponse, check_mass, listed
from creak.records import Complex, Real, Rig

Model: TypeAlias = Lumped | Matrices | Beam | MeasuredResponse

DERIVATIVES: Final = {"m": 0, "m/s": 1, "m/s^2": 2}
"""Output units that a mechanical model can give, and how often the displacement is differentiated for them."""

_CHUNK: Final = 2_000_000  # matrix entries that are solved at once
_FREE: Final = 1e12  # condition of a stiffness matrix beyond which nothing holds the structure


@dataclass(frozen=True, eq=False)
class System:
    """``M a + C v + K x + B f(Bᵀx, Bᵀv) = inputs u``, outputs y.

    Parameters
    ----------
    mass, damping, stiffness : array, (dof, dof)
        With the linear effects in them.
    inputs : array, (dof, q)
        Force on the coordinates per unit of input.
    outputs : array, (n, dof)
        Displacement at the nodes.
    derivatives : tuple of int, (n,)
        0, 1, 2: a node gives displacement, velocity or acceleration.
    elements : tuple of Restoring, (r,)
        Nonlinear elements.
    incidence : array, (dof, r)
        B: their relative displacements are ``Bᵀ x``.
    actuators : tuple of tuples of Actuator, (q,)
        Effects on each input, in the order in which they act.
    sensors : tuple of tuples of Sensor, (n,)
        Effects on each response.
    points : mapping of str to array, (dof,)
        Displacement of every named point as a row over the coordinates; an element between two points has
        the difference of their rows as its column of B.
    """

    mass: Real
    damping: Real
    stiffness: Real
    inputs: Real
    outputs: Real
    derivatives: tuple[int, ...]
    elements: tuple[Restoring, ...]
    incidence: Real
    actuators: tuple[tuple[Actuator, ...], ...]
    sensors: tuple[tuple[Sensor, ...], ...]
    points: Mapping[str, Real] = field(default_factory=dict)

    def response(self, frequencies: Real) -> Complex:
        """Input-to-node matrix of the linear part, ``S = (K + jwC - w²M)⁻¹`` between inputs and outputs (2).

        Parameters
        ----------
        frequencies : array, (F,)
            Hz.

        Returns
        -------
        array, (F, n, q)
            In units of output per unit of input; without actuator and sensor effects.
        """
        return self.receptance(frequencies, self.inputs)

    @property
    def free(self) -> bool:
        """True if nothing holds the structure, so that its static response is not determined."""
        return bool(np.linalg.cond(self.stiffness) > _FREE)

    def linearised(self, stiffness: Real, damping: Real) -> Self:
        """System whose nonlinear elements are replaced by springs and dampers, ``(r,)`` each."""
        b = self.incidence
        return replace(
            self,
            stiffness=self.stiffness + (b * stiffness) @ b.T,
            damping=self.damping + (b * damping) @ b.T,
            elements=(),
            incidence=b[:, :0],
        )

    def receptance(self, frequencies: Real, loads: Real) -> Complex:
        """What the nodes show of unit forces on any coordinates, ``S b``: the columns of candidate forces.

        Parameters
        ----------
        frequencies : array, (F,)
            Hz, DC allowed.
        loads : array, (dof, k)
            Forces on the coordinates, for instance ``points["1"] - points["2"]`` as a column.

        Returns
        -------
        array, (F, n, k)
            In units of output per N; linear part alone.
        """
        s = 2j * np.pi * np.asarray(frequencies, dtype=np.float64)[:, None, None]
        motion = self.motion(frequencies, loads)
        return np.asarray(s ** np.array(self.derivatives)[:, None] * (self.outputs @ motion))

    def motion(self, frequencies: Real, loads: Real) -> Complex:
        """Displacement of all coordinates under unit forces on the linear part, ``(F, dof, k)``.

        A structure that nothing holds has no static response; it is then held by a spring so soft that the
        structure on it moves 1e5 times slower than it vibrates.
        """
        s: Complex = np.asarray(2j * np.pi * np.asarray(frequencies), dtype=np.complex128)
        out = np.empty((s.size, *np.shape(loads)), dtype=np.complex128)
        chunk = max(1, _CHUNK // self.mass.size)
        for begin in range(0, s.size, chunk):
            part = s[begin : begin + chunk, None, None]
            out[begin : begin + chunk] = (
                np.linalg.solve(self.stiffness + part * self.damping + part**2 * self.mass, loads)
                if part.all()
                else self._with_static(part, loads)
            )
        return out

    def _with_static(self, s: Complex, loads: Real) -> Complex:
        dynamic = self.stiffness + s * self.damping + s**2 * self.mass
        if self.free:
            softest = np.trace(self.stiffness) / np.trace(self.mass) * 1e-10
            dynamic[s[:, 0, 0] == 0] += softest * self.mass
        return np.asarray(np.linalg.solve(dynamic, loads))


def assemble(model: Model, rig: Rig) -> System:
    """Put a model on a rig.

    Parameters
    ----------
    model : Model
    rig : Rig
        Its nodes are looked up in the model by name.

    Returns
    -------
    System

    Raises
    ------
    ConfigurationError
        If a node of the rig is not in the model, lacks an actuator or a sensor there, or is measured in a
        unit that no mechanical model gives; if the effects leave no positive mass; for kind ``frf`` if its
        recording has not been read.
    """
    if isinstance(model, MeasuredResponse):
        from creak.mechanics.measured import measured_system  # which is built on the class above

        if model.response is None:
            raise ConfigurationError(
                "model", "kind", "'frf' cannot be simulated; allowed are lumped, matrices, beam"
            )
        return measured_system(model, model.response, rig)
    # Up to the Nyquist frequency, so that harmonics of a nonlinear force find their modes.
    body = model.body(rig.sample_rate / 2) if isinstance(model, Beam) else model.body()
    _check_nodes(body, rig)
    if isinstance(model, Lumped):
        _check_forces(rig)
    body = _with_linear_effects(body, model)
    elements = tuple(effect for effect in model.effects if isinstance(effect, Restoring))
    incidence = [body.points[effect.at[0]] - body.points[effect.at[1]] for effect in elements]
    driven = [rig.nodes[i].name for i in rig.driven]
    return System(
        mass=body.mass,
        damping=body.damping,
        stiffness=body.stiffness,
        inputs=np.column_stack([body.actuators[name] for name in driven]),
        outputs=np.array([body.sensors[node.name] for node in rig.nodes]),
        derivatives=tuple(DERIVATIVES[node.output] for node in rig.nodes),
        elements=elements,
        incidence=np.array(incidence).reshape(len(elements), len(body.mass)).T,
        actuators=tuple(
            tuple(e for e in model.effects if isinstance(e, Actuator) and e.at == (name,)) for name in driven
        ),
        sensors=tuple(
            tuple(e for e in model.effects if isinstance(e, Sensor) and e.at == (node.name,)) for node in rig.nodes
        ),
        points=body.points,
    )


def _check_nodes(body: Body, rig: Rig) -> None:
    for i, node in enumerate(rig.nodes):
        where = f"nodes[{i}]"
        if node.name not in body.points:
            known = listed(set(body.points) - {GROUND})
            raise ConfigurationError(
                f"rig {rig.name}", f"{where}.name", f"{node.name!r} is not in the model; known are {known}"
            )
        if node.name not in body.sensors:
            raise ConfigurationError(
                f"rig {rig.name}",
                f"{where}.output",
                f"the model has no sensor at {node.name!r}; {listed(set(body.sensors))} have one",
            )
        if node.input is not None and node.name not in body.actuators:
            raise ConfigurationError(
                f"rig {rig.name}",
                f"{where}.input",
                f"the model has no actuator at {node.name!r}; {listed(set(body.actuators))} have one",
            )
        if node.output not in DERIVATIVES:
            raise ConfigurationError(
                f"rig {rig.name}",
                f"{where}.output",
                f"{node.output!r} cannot be simulated; allowed are {', '.join(DERIVATIVES)}",
            )


def _check_forces(rig: Rig) -> None:
    """A lumped model has no actuators of its own, so nothing says what force an ampere makes."""
    for i, node in enumerate(rig.nodes):
        if node.input not in (None, "N"):
            raise ConfigurationError(
                f"rig {rig.name}",
                f"nodes[{i}].input",
                f"{node.input!r} is no force; a lumped model takes inputs in N",
            )


def _with_linear_effects(body: Body, model: Lumped | Matrices | Beam) -> Body:
    """Add springs, dampers and masses by rank one, and a coordinate for every resonator."""
    resonators = [effect for effect in model.effects if isinstance(effect, Resonator)]
    size = len(body.mass)
    more = len(resonators)

    def wider(row: Real) -> Real:
        return np.concatenate([row, np.zeros(more)])

    points = {name: wider(row) for name, row in body.points.items()}
    mass, damping, stiffness = (np.pad(matrix, (0, more)) for matrix in (body.mass, body.damping, body.stiffness))
    for i, resonator in enumerate(resonators):
        own = np.eye(size + more)[size + i]
        b = own - points[resonator.at[0]]
        mass += resonator.mass * np.outer(own, own)
        damping += resonator.damping * np.outer(b, b)
        stiffness += resonator.stiffness * np.outer(b, b)
    targets = {Stiffness: stiffness, Damping: damping, Mass: mass}
    for effect in model.effects:
        if isinstance(effect, Stiffness | Damping | Mass):
            b = points[effect.at[0]] - points[effect.at[1]]
            targets[type(effect)] += effect.coefficient * np.outer(b, b)
    if more or any(isinstance(effect, Mass) for effect in model.effects):
        check_mass("effects", mass)
    return Body(
        mass,
        damping,
        stiffness,
        points,
        {name: wider(row) for name, row in body.actuators.items()},
        {name: wider(row) for name, row in body.sensors.items()},
    )
