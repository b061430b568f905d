"""A structure known by measurement alone: its response matrix, and what hangs on it as dynamic stiffness.

Between nodes ``Z(w) = S(w)^-1`` is all that there is to a linear structure, whatever it is made of. What is added
at the nodes adds ``dZ = (k + s c + s^2 m) b b^T``, so the response becomes ``(1 + S dZ)^-1 S``: exact at the
measured lines, without a single mass or spring known.
"""

from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from creak.errors import ConfigurationError
from creak.mechanics.effects import GROUND, Damping, Effect, Mass, Resonator, Restoring, Stiffness
from creak.mechanics.electronics import Actuator, Sensor
from creak.mechanics.response import Continued, Response, derivatives, held
from creak.mechanics.structure import MeasuredResponse, check_effects
from creak.mechanics.system import System
from creak.records import Complex, Real, Rig


@dataclass(frozen=True, eq=False)
class MeasuredSystem(System):
    """A measured structure with effects at its nodes; it has no matrices, only motion line by line.

    Its coordinates are the displacements of the nodes, then one for every input, which never moves: a load on it
    is the input itself, while a load on a node is a force there, in units of that node's input. The hold is in
    what was measured, so inputs are to be taken as band-limited.

    Parameters
    ----------
    drive, forced : Continued
        Displacements per unit of input, with the hold and without.
    linear : tuple of (array, Effect)
        Linear effects, each with its row over the coordinates.
    """

    drive: Continued = field(kw_only=True)
    forced: Continued = field(kw_only=True)
    linear: tuple[tuple[Real, Effect], ...] = field(default=(), kw_only=True)

    def motion(self, frequencies: Real, loads: Real) -> Complex:
        """Displacement of all coordinates under unit loads, ``(F, dof, k)``."""
        n = len(self.outputs)
        loads = np.asarray(loads, dtype=np.float64)
        driven = list(self.drive.rig.driven)
        out = np.zeros((len(frequencies), *loads.shape), dtype=np.complex128)
        moved = out[:, :n]
        s = np.asarray(2j * np.pi * np.asarray(frequencies), dtype=np.complex128)
        receptance = np.zeros((len(s), n, n), dtype=np.complex128)
        receptance[..., driven] = self.forced.at(frequencies)
        moved += receptance @ loads[:n]
        if loads[n:].any():
            moved += self.drive.at(frequencies) @ loads[n:]
        if self.linear:
            added = np.zeros_like(receptance)
            for row, effect in self.linear:
                added += _dynamic_stiffness(effect, s)[:, None, None] * np.outer(row[:n], row[:n])
            moved[:] = np.linalg.solve(np.eye(n) + receptance @ added, moved)
        return out

    @property
    def free(self) -> bool:
        """False: what is known of a structure's rest is known from the band."""
        return False

    def linearised(self, stiffness: Real, damping: Real) -> Self:
        """System whose nonlinear elements are replaced by springs and dampers, ``(r,)`` each."""
        places = [("a", GROUND)] * len(self.elements)  # a place is not asked for: the row says where
        more = [
            (row, kind(at, float(value)))
            for row, at, k, c in zip(self.incidence.T, places, stiffness, damping, strict=True)
            for kind, value in ((Stiffness, k), (Damping, c))
        ]
        return replace(self, elements=(), incidence=self.incidence[:, :0], linear=(*self.linear, *more))


def _dynamic_stiffness(effect: Effect, s: Complex) -> Complex:
    """Force against a displacement, per unit of it."""
    match effect:
        case Stiffness():
            return np.full(s.shape, effect.coefficient, dtype=np.complex128)
        case Damping():
            return np.asarray(effect.coefficient * s)
        case Mass():
            return np.asarray(effect.coefficient * s**2)
        case Resonator():
            carried = effect.stiffness + s * effect.damping
            moving = effect.mass * s**2
            return np.asarray(moving * carried / (moving + carried))
    raise TypeError(effect)


def measured_system(model: MeasuredResponse, response: Response, rig: Rig) -> MeasuredSystem:
    """Put a measured structure, with the effects that a model adds to it, on a rig.

    Parameters
    ----------
    model : MeasuredResponse
    response : Response
        What its recording holds.
    rig : Rig
        Of the same nodes, inputs, units and sampling.

    Raises
    ------
    ConfigurationError
        If the rig is another one, or an effect acts where no input tells what a force does.
    """
    own = response.rig
    for key, one, other in (
        ("nodes", [(node.name, node.output, node.input) for node in own.nodes],
         [(node.name, node.output, node.input) for node in rig.nodes]),
        ("sample_rate", own.sample_rate, rig.sample_rate),
        ("period_samples", own.period_samples, rig.period_samples),
    ):  # fmt: skip
        if one != other:
            raise ConfigurationError(
                f"rig {rig.name}", key, f"{other!r} is not that of the model's recording, {one!r}"
            )
    names = [node.name for node in rig.nodes]
    n, q = rig.n, rig.q
    driven = {names[i] for i in rig.driven}
    check_effects(model.effects, set(names), driven, set(names))
    rows = {name: np.eye(n, n + q)[i] for i, name in enumerate(names)} | {GROUND: np.zeros(n + q)}
    for i, effect in enumerate(model.effects):
        for name in effect.at if isinstance(effect, Restoring | Stiffness | Damping | Mass | Resonator) else ():
            if name not in driven | {GROUND}:
                raise ConfigurationError(
                    "model",
                    f"effects[{i}].at",
                    f"{name!r} has no input, so what a force does there was not measured",
                )
    order = derivatives(own)
    s = 2j * np.pi * own.frequencies
    moved = response.S / s[:, None, None] ** np.array(order)[:, None]
    elements = tuple(effect for effect in model.effects if isinstance(effect, Restoring))
    incidence = [rows[effect.at[0]] - rows[effect.at[1]] for effect in elements]
    linear = tuple(
        (rows[effect.at[0]] - rows[effect.at[1]] if len(effect.at) > 1 else rows[effect.at[0]], effect)
        for effect in model.effects
        if isinstance(effect, Stiffness | Damping | Mass | Resonator)
    )
    none = np.zeros((0, 0))
    return MeasuredSystem(
        none,
        none,
        none,
        inputs=np.eye(n + q)[:, n:],
        outputs=np.eye(n, n + q),
        derivatives=order,
        elements=elements,
        incidence=np.array(incidence).reshape(len(elements), n + q).T,
        actuators=tuple(
            tuple(e for e in model.effects if isinstance(e, Actuator) and e.at == (names[i],)) for i in rig.driven
        ),
        sensors=tuple(
            tuple(e for e in model.effects if isinstance(e, Sensor) and e.at == (name,)) for name in names
        ),
        points=rows,
        drive=Continued(own, own.frequencies, moved),
        forced=Continued(own, own.frequencies, np.asarray(moved / held(own)[:, None, None])),
        linear=linear,
    )
