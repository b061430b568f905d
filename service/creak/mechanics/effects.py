"""Effects that a structure may hold: one class an effect, each a frozen record that checks itself.

Signs: an internal element ``at = ("i", "j")`` pulls on ``d = x_i - x_j``: the force that it returns acts on
node i against the direction of x_i, and on node j along x_j. ``ground`` is x = 0. Actuator and sensor effects
are in `electronics`, names and look-up in `vocabulary`.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import ClassVar, Final

import numpy as np
from numpy.typing import ArrayLike

from creak.errors import ConfigurationError
from creak.mechanics import laws
from creak.records import Real

GROUND: Final = "ground"


@dataclass(frozen=True)
class Effect:
    """What all effects share: a name in the vocabulary, a place, and parameters that are checked.

    Parameters
    ----------
    at : tuple of str
        Where it acts.

    Raises
    ------
    ConfigurationError
        For a place or a parameter that is not allowed; the key is relative to the effect.
    """

    effect: ClassVar[str]
    positive: ClassVar[frozenset[str]] = frozenset()
    not_negative: ClassVar[frozenset[str]] = frozenset()

    at: tuple[str, ...]

    def __post_init__(self) -> None:
        self._check_place()
        for name, value in self.parameters().items():
            if not math.isfinite(value):
                raise self.refusal(name, f"{value!r}, must be finite")
            if name in self.positive and value <= 0:
                raise self.refusal(name, f"{value!r}, must be greater than 0")
            if name in self.not_negative and value < 0:
                raise self.refusal(name, f"{value!r}, must not be negative")

    @classmethod
    def parameter_names(cls) -> tuple[str, ...]:
        """Names of the parameters, in the order of the contract."""
        return tuple(field.name for field in fields(cls) if field.name != "at")

    def parameters(self) -> Mapping[str, float]:
        """Parameters by name, in the order of the contract."""
        return {name: getattr(self, name) for name in self.parameter_names()}

    def _check_place(self) -> None:
        """Refuse a place of the wrong kind."""
        raise NotImplementedError

    def refusal(self, key: str, problem: str) -> ConfigurationError:
        """Error for one of the keys of this effect."""
        return ConfigurationError(f"effect {self.effect}", key, problem)

    def __str__(self) -> str:
        return f"{self.effect} at {'-'.join(self.at)}"


@dataclass(frozen=True)
class Internal(Effect):
    """An effect between two points, or between a point and the ground."""

    def _check_place(self) -> None:
        if len(self.at) != 2 or self.at[0] == self.at[1] or self.at[0] == GROUND:
            raise self.refusal(
                "at", f"{list(self.at)}, must name a node and another node, or a node and 'ground', in this order"
            )


@dataclass(frozen=True)
class Stiffness(Internal):
    """Added linear spring: force k d; a negative coefficient takes stiffness away."""

    effect: ClassVar[str] = "stiffness"
    coefficient: float


@dataclass(frozen=True)
class Damping(Internal):
    """Added linear damper: force c v."""

    effect: ClassVar[str] = "damping"
    coefficient: float


@dataclass(frozen=True)
class Mass(Internal):
    """Added mass: force m a of the relative acceleration (between two nodes an inerter)."""

    effect: ClassVar[str] = "mass"
    coefficient: float


@dataclass(frozen=True)
class Resonator(Effect):
    """A mode that the model lacks: a mass on a spring and a damper, attached at a node."""

    effect: ClassVar[str] = "resonator"
    positive: ClassVar[frozenset[str]] = frozenset({"mass", "frequency_hz"})
    not_negative: ClassVar[frozenset[str]] = frozenset({"damping_ratio"})
    mass: float
    frequency_hz: float
    damping_ratio: float

    def _check_place(self) -> None:
        if not self.at or self.at[0] == GROUND or self.at[1:] not in {(), (GROUND,)}:
            raise self.refusal("at", f"{list(self.at)}, must name one node")

    @property
    def stiffness(self) -> float:
        """Of its spring, N/m."""
        return self.mass * (2 * math.pi * self.frequency_hz) ** 2

    @property
    def damping(self) -> float:
        """Of its damper, N s/m."""
        return 2 * self.damping_ratio * self.mass * 2 * math.pi * self.frequency_hz


@dataclass(frozen=True)
class Restoring(Internal):
    """A nonlinear force of relative displacement and velocity."""

    law: ClassVar[int]

    def constants(self) -> tuple[float, float]:
        """Parameters as the compiled law takes them."""
        values = [*self.parameters().values(), 0.0]
        return float(values[0]), float(values[1])

    def over_period(self, d: ArrayLike, v: ArrayLike) -> Real:
        """Force over one period of a periodic motion.

        Parameters
        ----------
        d, v : array, (..., N)
            Relative displacement and velocity, m and m/s; time runs last. Memory (hysteresis) is periodic:
            the samples are passed through until it repeats itself.

        Returns
        -------
        array, (..., N)
            Force, N.
        """
        d, v = np.broadcast_arrays(np.atleast_1d(np.asarray(d, float)), np.asarray(v, float))
        p, q = self.constants()
        rows = d.reshape(-1, d.shape[-1]), v.reshape(-1, v.shape[-1])
        flat = laws.force_over_period(self.law, p, q, *map(np.ascontiguousarray, rows))
        return flat.reshape(d.shape)


@dataclass(frozen=True)
class CubicStiffness(Restoring):
    """Force k3 d^3."""

    effect: ClassVar[str] = "cubic_stiffness"
    law: ClassVar[int] = laws.CUBIC
    coefficient: float


@dataclass(frozen=True)
class QuadraticStiffness(Restoring):
    """Force k2 d^2."""

    effect: ClassVar[str] = "quadratic_stiffness"
    law: ClassVar[int] = laws.QUADRATIC
    coefficient: float


@dataclass(frozen=True)
class Clearance(Restoring):
    """Contact on both sides once ``|d| > gap``: force k (|d| - gap) sign(d)."""

    effect: ClassVar[str] = "clearance"
    positive: ClassVar[frozenset[str]] = frozenset({"stiffness"})
    not_negative: ClassVar[frozenset[str]] = frozenset({"gap"})
    law: ClassVar[int] = laws.CLEARANCE
    stiffness: float
    gap: float


@dataclass(frozen=True)
class OneSidedStop(Restoring):
    """Contact once ``d > gap``: force k (d - gap); with a negative gap it pushes at rest (preloaded)."""

    effect: ClassVar[str] = "one_sided_stop"
    positive: ClassVar[frozenset[str]] = frozenset({"stiffness"})
    law: ClassVar[int] = laws.STOP
    stiffness: float
    gap: float


@dataclass(frozen=True)
class CoulombFriction(Restoring):
    """Force F tanh(v/velocity)."""

    effect: ClassVar[str] = "coulomb_friction"
    positive: ClassVar[frozenset[str]] = frozenset({"force", "velocity"})
    law: ClassVar[int] = laws.COULOMB
    force: float
    velocity: float


@dataclass(frozen=True)
class QuadraticDamping(Restoring):
    """Force c2 v |v|."""

    effect: ClassVar[str] = "quadratic_damping"
    law: ClassVar[int] = laws.QUADRATIC_DAMPING
    coefficient: float


@dataclass(frozen=True)
class Hysteresis(Restoring):
    """Bouc-Wen: force k z with dz/dt = v (1 - (1 + sign(v z))/2 (z/z_y)^2)."""

    effect: ClassVar[str] = "hysteresis"
    positive: ClassVar[frozenset[str]] = frozenset({"stiffness", "yield_displacement"})
    law: ClassVar[int] = laws.HYSTERESIS
    stiffness: float
    yield_displacement: float
