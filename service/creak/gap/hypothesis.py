"""What a diagnosis supposes: effects that the model lacks, and linear elements that are off."""

from dataclasses import dataclass, field, replace

from creak.gap.properties import properties_of
from creak.gap.regression import LinearKey, LinearKind
from creak.mechanics.beam import Beam
from creak.mechanics.effects import GROUND, Damping, Effect, Mass, Stiffness
from creak.mechanics.structure import Lumped, PointMass
from creak.mechanics.system import Model

_LEFT = 0.05  # of a mass or a stiffness

_OF_STATION: dict[LinearKind, str] = {
    Mass: "moving_mass",
    Stiffness: "suspension_stiffness",
    Damping: "suspension_damping",
}


@dataclass(frozen=True)
class Hypothesis:
    """Changes of a model.

    Parameters
    ----------
    effects : tuple of Effect
        Added, in this order.
    linear : tuple of (LinearKey, float)
        Changes of the coefficients of linear elements.
    dropped : tuple of int
        Effects of the model that are taken out, by index.
    """

    effects: tuple[Effect, ...] = ()
    linear: tuple[tuple[LinearKey, float], ...] = ()
    dropped: tuple[int, ...] = ()

    @property
    def size(self) -> int:
        """Number of free parameters."""
        return len(self.linear) + sum(len(effect.parameter_names()) for effect in self.effects)


@dataclass(frozen=True)
class Own:
    """A linear element or property that a model has, with its value."""

    key: LinearKey
    name: str
    parameter: str
    value: float = field(default=0.0)


def own_elements(model: Model) -> list[Own]:
    """Masses, stiffnesses and dampings that a lumped model names, and what a beam has; none for matrices."""
    if isinstance(model, Beam):
        found = [
            Own((kind, (station.name, GROUND)), station.name, parameter, getattr(station, parameter))
            for station in model.stations
            for kind, parameter in _OF_STATION.items()
        ]
        return found + [Own((name, ()), "beam", name, getattr(model, name)) for name in properties_of(model)]
    if not isinstance(model, Lumped):
        return []
    found = [Own((Mass, (mass.name, GROUND)), mass.name, "mass", mass.mass) for mass in model.masses]
    for link in model.links:
        at = oriented(link.between, [mass.name for mass in model.masses])
        found.append(Own((Stiffness, at), "-".join(link.between), "stiffness", link.stiffness))
        found.append(Own((Damping, at), "-".join(link.between), "damping", link.damping))
    return found


def plausible(model: Model, hypothesis: Hypothesis) -> bool:
    """Whether linear changes leave something of the model's own masses and stiffnesses.

    Where all of them are free, a structure that vanishes together with its input or its response explains any
    motion: an actuator or a sensor that passes nothing is then the best of all candidates.
    """
    changes = dict(hypothesis.linear)
    return all(
        own.value + changes.get(own.key, 0.0) > _LEFT * own.value
        for own in own_elements(model)
        if own.value > 0 and own.parameter != "damping"
    )


def oriented(between: tuple[str, str], names: list[str]) -> tuple[str, str]:
    """Name a place as the diagnosis does: nodes in their order, the ground last."""
    a, b = between
    if a == GROUND or (b != GROUND and names.index(b) < names.index(a)):
        return b, a
    return a, b


def apply(model: Model, hypothesis: Hypothesis) -> Model:
    """Model with a hypothesis in it."""
    effects = [effect for i, effect in enumerate(model.effects) if i not in hypothesis.dropped]
    added: list[Effect] = list(hypothesis.effects)
    for (kind, at), change in hypothesis.linear:
        moved: Model | None = None
        if isinstance(kind, str):
            moved = replace(model, **{kind: getattr(model, kind) + change})
        elif isinstance(model, Lumped):
            moved = _moved(model, kind, at, change)
        elif isinstance(model, Beam):
            moved = _moved_station(model, kind, at, change)
        if moved is not None:
            model = moved
        elif not isinstance(kind, str):
            added.append(kind(at, change))
    return replace(model, effects=(*effects, *added))


def _moved(model: Lumped, kind: LinearKind, at: tuple[str, ...], change: float) -> Lumped | None:
    """Lumped model whose own element is changed; None if it has none, or would be left with less than nothing."""
    if kind is Mass:
        masses = [
            PointMass(mass.name, mass.mass + change) if at == (mass.name, GROUND) else mass
            for mass in model.masses
        ]
        if at[1] != GROUND or min(mass.mass for mass in masses) <= 0:
            return None
        return replace(model, masses=tuple(masses))
    key = "stiffness" if kind is Stiffness else "damping"
    links = list(model.links)
    for i, link in enumerate(links):
        if set(link.between) == set(at) and getattr(link, key) + change >= 0:
            links[i] = replace(link, **{key: getattr(link, key) + change})
            return replace(model, links=tuple(links))
    return None


def _moved_station(model: Beam, kind: LinearKind, at: tuple[str, ...], change: float) -> Beam | None:
    """Beam with another mass or suspension at a station; None between stations, or if less than 0 is left."""
    parameter = _OF_STATION[kind]
    for i, station in enumerate(model.stations):
        if at == (station.name, GROUND) and getattr(station, parameter) + change >= 0:
            stations = list(model.stations)
            stations[i] = replace(station, **{parameter: getattr(station, parameter) + change})
            return replace(model, stations=tuple(stations))
    return None
