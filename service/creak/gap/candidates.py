"""The vocabulary as candidates: what an effect of unknown parameters adds to the whitened motion.

Every candidate is one column of the regression. Its coefficient is fitted; up to one inner parameter (a gap, a
velocity, a limit ...) is searched on a logarithmic grid first and optimised then.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.optimize import minimize, minimize_scalar

from creak.gap.regression import LINEAR, Column, Indices, internal_places
from creak.gap.view import View
from creak.mechanics import laws
from creak.mechanics.effects import (
    GROUND,
    Clearance,
    CoulombFriction,
    CubicStiffness,
    Effect,
    Hysteresis,
    OneSidedStop,
    QuadraticDamping,
    QuadraticStiffness,
    Resonator,
    Restoring,
)
from creak.mechanics.electronics import (
    ActuatorDeadZone,
    ActuatorDelay,
    ActuatorGain,
    ActuatorHysteresis,
    ActuatorSaturation,
    SensorClipping,
    SensorDelay,
    SensorGain,
    SensorQuantisation,
    delayed,
)
from creak.records import Complex, Real

SMALLEST: Final = 0.002
"""Least inner parameter that is tried, in standard deviations of the motion."""

_LEAST_GAIN: Final = 0.02
_PLAIN: Final = (CubicStiffness, QuadraticStiffness, QuadraticDamping, *LINEAR, ActuatorGain, SensorGain)


_BALANCED = 30  # steps to the mean of a motion
_FAR = 1e3  # times the motion that a mean may lie away from where it is


@dataclass(frozen=True)
class Candidate:
    """One effect at one place.

    Parameters
    ----------
    kind : type of Effect
    at : tuple of str
    group : str
        ``internal``, ``actuator`` or ``sensor``.
    offset : array, (E,), optional
        Mean displacement that the measured motion lacks, m.
    """

    kind: type[Effect]
    at: tuple[str, ...]
    group: str
    offset: Real | None = field(default=None, compare=False)

    @property
    def parameters(self) -> int:
        """Number of free parameters."""
        return len(self.kind.parameter_names())

    @property
    def one_inner(self) -> bool:
        """Whether there is one inner parameter that may be moved smoothly."""
        return self.kind not in (*_PLAIN, Resonator, SensorQuantisation)

    def grid(self, view: View, experiments: Indices) -> Real:
        """Inner parameters to begin with; one dummy where there is none."""
        if self.kind in _PLAIN:
            return np.ones(1)
        if self.group == "internal":
            d, v = self._motion(view, experiments)
            if self.kind is CoulombFriction:
                return np.std(v) * np.geomspace(SMALLEST, 3.0, 14)
            if self.kind is Hysteresis:
                return np.std(d) * np.geomspace(SMALLEST, 10.0, 15)
            reach = np.max(np.abs(d)) / max(float(np.std(d)), 1e-300)
            gaps = np.std(d) * np.geomspace(SMALLEST, 0.98 * reach, 16)
            if self.kind is Clearance:
                return np.asarray(gaps)
            return np.concatenate([-gaps[::-1], [0.0], gaps])
        signal = self._signal(view, experiments)
        rms, peak = float(np.std(signal)), float(np.max(np.abs(signal)))
        if self.kind in (ActuatorSaturation, SensorClipping):
            return peak * np.concatenate([np.geomspace(0.01, 0.08, 6), np.linspace(0.1, 0.98, 14)])
        if self.kind is ActuatorDeadZone:
            return rms * np.geomspace(SMALLEST, 2.0, 14)
        if self.kind is ActuatorHysteresis:
            return rms * np.geomspace(0.01, 10.0, 14)
        if self.kind is SensorQuantisation:
            # A step is only seen if no sample lies a level off: steps so close that the largest one does not.
            return 1 / np.arange(1 / (2 * rms), 1 / (0.02 * rms), 0.25 / peak)
        sample = 1 / view.rig.sample_rate  # delays
        grid = sample * np.geomspace(0.01, 20.0, 14)
        return np.concatenate([-grid[::-1], grid])

    def column(self, view: View, inner: float | Real, experiments: Indices) -> Column:
        """Column at an inner parameter; filled at the given experiments, zero elsewhere."""
        phi = np.zeros((len(view.r), len(view.s)), dtype=np.complex128)
        phi[experiments], fixed = self.forces(view, experiments)(inner)
        return Column(self.pattern(view), phi, fixed)

    def pattern(self, view: View) -> Complex:
        """Whitened motion of the nodes per unit of its force, ``(L, n)``."""
        at = (*self.at, GROUND) if self.kind is Resonator else self.at
        return view.pattern(at, self.group)

    def forces(self, view: View, experiments: Indices) -> Callable[[float | Real], tuple[Complex, bool]]:
        """Lines ``(E, L)`` of its force as a function of the inner parameter, and whether its coefficient is 1."""
        kept = len(view.s)
        if self.kind is Resonator:
            D = view.D[experiments] @ view.weights(self.at)
            return lambda inner: (view.s**2 * attached(view.s, *np.asarray(inner)) * D, False)
        if self.group == "internal" and self.kind in LINEAR:
            D = view.D[experiments] @ view.weights(self.at) * view.s ** LINEAR[self.kind]
            return lambda inner: (D, False)
        if self.group == "internal":
            d, v = self._motion(view, experiments)
            return lambda inner: (lines(self.unit(float(inner)).over_period(d, v), kept), False)
        samples = self._signal(view, experiments)

        def electronic(inner: float | Real) -> tuple[Complex, bool]:
            changed, fixed = _electronic(self.kind, samples, float(inner), view.rig.sample_rate)
            return lines(changed, kept), fixed

        return electronic

    def _motion(self, view: View, experiments: Indices) -> tuple[Real, Real]:
        """Relative displacement, mean included, and velocity, ``(E, N)``."""
        d, v = relative(view, self.at, experiments)
        return (d if self.offset is None else d + self.offset[experiments, None]), v

    def _signal(self, view: View, experiments: Indices) -> Real:
        """Input or response that an actuator or sensor effect acts on, ``(E, N)``."""
        i = view.names.index(self.at[0])
        if self.group == "actuator":
            return np.asarray(view.u[experiments, view.rig.driven.index(i)])
        return np.asarray(view.motion[experiments, i])

    def unit(self, inner: float) -> Restoring:
        """Law with coefficient 1."""
        values = [1.0, inner][: self.parameters]
        return self.kind(self.at, *values)  # type: ignore[return-value]

    def effect(self, coefficient: float, inner: float | Real) -> Effect | None:
        """Effect with these numbers; None if they are none that it can have."""
        names = self.kind.parameter_names()
        if not (np.isfinite(coefficient) and np.all(np.isfinite(inner))):
            return None  # of a column that a strange inner parameter made infinite
        if self.kind in (ActuatorGain, SensorGain):
            if 1.0 + coefficient < _LEAST_GAIN:
                return None  # silence explains everything, beside a structure that is free to vanish too
            values = [1.0 + coefficient]
        elif self.group != "internal" and len(names) == 1:
            values = [float(inner)]
        elif self.kind is Resonator:
            values = [coefficient, *(float(value) for value in np.asarray(inner))]
        else:
            values = [coefficient, float(inner)][: len(names)]
        if self.kind is ActuatorHysteresis and not 0 < coefficient <= 1:
            return None
        if any(name in self.kind.positive and value <= 0 for name, value in zip(names, values, strict=True)):
            return None
        return self.kind(self.at, *values)


def attached(s: Complex, frequency: float, damping_ratio: float) -> Complex:
    """Motion of an attached mass relative to that of its node, ``(w0^2 + 2 z w0 s)/(s^2 + 2 z w0 s + w0^2)``.

    Its force on the node is ``m s^2`` times this times the node's displacement, against the effects' sign.
    """
    w = 2 * np.pi * frequency
    carried = w**2 + 2 * damping_ratio * w * s
    return np.asarray(carried / (s**2 + carried))


def lines(samples: Real, kept: int) -> Complex:
    """First lines of periods, ``(E, N)`` to ``(E, kept)``."""
    return np.asarray(np.fft.rfft(samples, axis=-1)[..., :kept] / samples.shape[-1])


def relative(view: View, at: tuple[str, ...], experiments: Indices) -> tuple[Real, Real]:
    """Relative displacement and velocity at an internal place, ``(E, N)``."""
    b = view.weights(at)
    return np.einsum("n,ent->et", b, view.d[experiments]), np.einsum("n,ent->et", b, view.v[experiments])


def resting(view: View, at: tuple[str, ...], law: Restoring, compliance: float) -> Real:
    """Mean displacement at which a law's mean force and the structure's static stiffness balance, ``(E,)``.

    Parameters
    ----------
    view : View
    at : tuple of str
    law : Restoring
        With coefficient 1.
    compliance : float
        Static displacement per unit of the law's force.

    Returns
    -------
    array, (E,)
        0 where nothing balances, as the law pushes away harder than the structure holds.
    """
    d, v = relative(view, at, np.arange(len(view.r)))
    mean = np.zeros(len(d))
    h = 1e-4 * float(np.std(d))
    for _ in range(_BALANCED):
        force, moved = (np.mean(law.over_period(d + (mean + x)[:, None], v), axis=-1) for x in (0.0, h))
        # Never more than twice a plain step: a spring that pushes away could turn the slope round.
        slope = np.maximum(1.0 + compliance * (moved - force) / h, 0.5)
        step = (mean + compliance * force) / slope
        if not np.max(np.abs(step)) <= _FAR * np.std(d):
            return np.zeros(len(d))
        mean = mean - step
        if np.max(np.abs(step)) <= 1e-6 * np.std(d):
            break
    return mean


def _electronic(kind: type[Effect], samples: Real, inner: float, rate: float) -> tuple[Real, bool]:
    """What the simulator has too much of, when the effect is there: before minus after (actuator).

    For a sensor the pattern is ``-1/sigma``, so it is after minus before.
    """
    if kind is ActuatorGain:
        return -samples, False
    if kind is SensorGain:
        return samples, False
    if kind is ActuatorDelay:
        return samples - delayed(samples, inner, rate), True
    if kind is SensorDelay:
        return delayed(samples, inner, rate) - samples, True
    clipped = np.clip(samples, -inner, inner)
    if kind is ActuatorSaturation:
        return samples - clipped, True
    if kind is ActuatorDeadZone:
        return clipped, True
    if kind is SensorClipping:
        return clipped - samples, True
    if kind is SensorQuantisation:
        return inner * np.round(samples / inner) - samples, True
    unit = laws.force_over_period(laws.HYSTERESIS, 1.0, inner, np.ascontiguousarray(samples), samples * 0.0)
    return samples - unit, False


EVEN: Final[tuple[type[Effect], ...]] = (QuadraticStiffness, OneSidedStop)
"""Laws whose force has a mean that moves the structure."""
INTERNAL: Final[tuple[type[Effect], ...]] = (
    CubicStiffness,
    QuadraticStiffness,
    QuadraticDamping,
    Clearance,
    OneSidedStop,
    CoulombFriction,
    Hysteresis,
)
ACTUATOR: Final[tuple[type[Effect], ...]] = (
    ActuatorGain,
    ActuatorDelay,
    ActuatorSaturation,
    ActuatorDeadZone,
    ActuatorHysteresis,
)
SENSOR: Final[tuple[type[Effect], ...]] = (SensorGain, SensorDelay, SensorClipping, SensorQuantisation)


def candidates_at(group: str, at: tuple[str, ...]) -> list[Candidate]:
    """Every effect that can act at a place; one that is not symmetric also the other way round."""
    if group == "internal":
        found = [Candidate(kind, at, group) for kind in (*LINEAR, *INTERNAL)]
        if at[1] != GROUND:
            found.append(Candidate(OneSidedStop, (at[1], at[0]), group))
        return found
    return [Candidate(kind, at, group) for kind in (ACTUATOR if group == "actuator" else SENSOR)]


def places(view: View) -> list[tuple[str, tuple[str, ...]]]:
    """Every place, as group and names."""
    found: list[tuple[str, tuple[str, ...]]] = [("internal", at) for at in internal_places(view.names)]
    found += [("actuator", (view.names[i],)) for i in view.rig.driven]
    return found + [("sensor", (name,)) for name in view.names]


Score = Callable[[Complex, bool], float]
"""What a force leaves, from its lines at the experiments of the search and whether its coefficient is 1."""


def optimise(candidate: Candidate, view: View, experiments: Indices, score: Score) -> float | Real:
    """Inner parameter with the least score: the best of the grid, then Brent's method around it."""
    forces = candidate.forces(view, experiments)
    if candidate.kind is Resonator:
        return _resonance(view, lambda inner: score(*forces(inner)))
    grid = candidate.grid(view, experiments)
    if len(grid) == 1:
        return float(grid[0])
    scores = [score(*forces(float(x))) for x in grid]
    best = int(np.argmin(scores))
    low, high = sorted((float(grid[max(best - 1, 0)]), float(grid[min(best + 1, len(grid) - 1)])))
    result = minimize_scalar(
        lambda x: score(*forces(x)),
        bounds=(low, high),
        method="bounded",
        options={"xatol": 1e-4 * (high - low), "maxiter": 18},
    )
    return float(result.x) if result.fun < scores[best] else float(grid[best])


def _resonance(view: View, score: Callable[[Real], float]) -> Real:
    """Frequency and damping ratio of a resonator: the best of a grid, then the simplex method."""
    rig = view.rig
    resolution = rig.sample_rate / rig.period_samples
    low, high = 0.7 * max(rig.lines[0], 2) * resolution, 1.4 * rig.lines[-1] * resolution
    grid = [np.array((f, z)) for z in (0.003, 0.01, 0.03, 0.1, 0.3) for f in np.geomspace(low, high, 48)]
    scores = [score(point) for point in grid]
    found = []
    for best in np.argsort(scores)[:2]:
        result = minimize(
            lambda x: score(np.exp(x)),
            np.log(grid[best]),
            method="Nelder-Mead",
            options={"xatol": 1e-4, "fatol": 1e-6 * scores[best], "maxfev": 80},
        )
        found.append((result.fun, result.x))
    return np.asarray(np.exp(min(found, key=lambda item: item[0])[1]))


def group_of(at: Sequence[str], kind: type[Effect]) -> str:
    """Group of an effect."""
    if kind in ACTUATOR:
        return "actuator"
    return "sensor" if kind in SENSOR else "internal"
