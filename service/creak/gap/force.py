"""The missing force: at which places it acts, in which band, and its picture over displacement and velocity."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from creak.gap.candidates import group_of
from creak.gap.hidden import see_beyond
from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.records import ForceCurve, MissingForce, Pattern
from creak.gap.regression import LINEAR, Indices, LinearKey
from creak.gap.scan import strongest_lines
from creak.gap.setting import Setting
from creak.gap.view import View
from creak.mechanics.effects import GROUND, Damping, Effect, Mass, Restoring, Stiffness
from creak.mechanics.electronics import Electronic
from creak.records import Complex, Real

_POINTS = 600  # of a curve
_CLEAR = 4.0  # power over noise beyond which a line of the force is drawn
Place = tuple[float, str, tuple[str, ...]]


def acting_places(hypothesis: Hypothesis) -> list[tuple[str, tuple[str, ...]]]:
    """Places that a hypothesis names, as group and names, each once."""
    found: list[tuple[str, tuple[str, ...]]] = []
    for effect in hypothesis.effects:
        at = (
            effect.at
            if group_of(effect.at, type(effect)) != "internal" or len(effect.at) > 1
            else (*effect.at, GROUND)
        )
        if (group_of(effect.at, type(effect)), at) not in found:
            found.append((group_of(effect.at, type(effect)), at))
    for (_, at), _ in hypothesis.linear:
        if at and not any(set(at) == set(other) for _, other in found):
            found.append(("internal", at))
    return found


def missing_force(
    setting: Setting, hypothesis: Hypothesis, places: Sequence[Place], experiments: Indices
) -> tuple[MissingForce, ...]:
    """Where the missing force acts, in falling share.

    Parameters
    ----------
    setting : Setting
    hypothesis : Hypothesis
        What was found; if it is empty, the best places of a free force stand.
    places : sequence
        What a free force leaves at every place, the best first.
    experiments : array of int
    """
    acting = acting_places(hypothesis)
    if not acting:
        best = places[0][0]
        acting = [(group, at) for rest, group, at in places if rest <= 1.02 * best + 0.02][:1]
    view = see_beyond(setting, [at for _, at in acting])
    residuals = {(group, frozenset(at)): rest for rest, group, at in places}
    forces = _joint_forces(view, acting, experiments)
    powers = []
    for i, (group, at) in enumerate(acting):
        pattern = view.pattern(at, group)
        moved = np.sum(np.abs(forces[..., i]) ** 2, axis=0) * np.sum(np.abs(pattern) ** 2, axis=1)
        powers.append(float(np.sum(moved)))
    total = float(np.sum(np.abs(view.r[experiments]) ** 2))
    over = max(sum(powers), total, 1e-300)
    frequency = setting.rig.sample_rate / setting.rig.period_samples
    found = []
    for i, (group, at) in enumerate(acting):
        clear = np.maximum(
            np.mean(np.abs(forces[..., i]) ** 2, axis=0)
            - 1 / np.maximum(np.sum(np.abs(view.pattern(at, group)) ** 2, axis=1), 1e-300),
            0.0,
        )
        clear[0] = 0.0
        # The force is known no better than the motion shows it: beyond the excited band that is little.
        low, high = strongest_lines(clear * _seen(view, at, group, forces[..., i]), 0.9)
        found.append(
            MissingForce(
                at,
                powers[i] / over,
                (low * frequency, high * frequency),
                _pattern(group, at),
                residuals.get((group, frozenset(at)), float("nan")),
            )
        )
    return tuple(sorted(found, key=lambda item: -item.share))


def _seen(view: View, at: tuple[str, ...], group: str, force: Complex) -> Real:
    """1 at lines where the force stands clear of noise, else 0."""
    pattern = np.sum(np.abs(view.pattern(at, group)) ** 2, axis=1)
    return np.asarray(np.mean(np.abs(force) ** 2, axis=0) * pattern > 2.0).astype(np.float64)


def _pattern(group: str, at: tuple[str, ...]) -> Pattern:
    if group == "actuator":
        return "actuator"
    if group == "sensor":
        return "sensor"
    return "ground" if at[1] == GROUND else "edge"


def _joint_forces(view: View, acting: Sequence[tuple[str, tuple[str, ...]]], experiments: Indices) -> Complex:
    """Forces at places that together leave least of the whitened motion, ``(E, L, places)``."""
    patterns = np.stack([view.pattern(at, group) for group, at in acting], axis=-1)
    inverse = np.linalg.pinv(patterns, rcond=1e-9)
    return np.asarray(np.einsum("lkn,eln->elk", inverse, view.r[experiments]))


def force_curves(
    setting: Setting, hypothesis: Hypothesis, where: Sequence[MissingForce], experiments: Indices
) -> tuple[ForceCurve, ...]:
    """Measured force over displacement and velocity at each place, and the law that was fitted.

    At a place the causes found elsewhere and the linear corrections at other places are in the model already.
    For an actuator the displacement is its input, for a sensor the simulated response.
    """
    found = []
    one = experiments[:1]
    size = setting.rig.period_samples
    for place in where:
        here = tuple(e for e in hypothesis.effects if set(e.at) == set(place.at))
        linear = tuple(item for item in hypothesis.linear if set(item[0][1]) == set(place.at))
        others = Hypothesis(
            tuple(e for e in hypothesis.effects if e not in here),
            tuple(item for item in hypothesis.linear if item not in linear),
            hypothesis.dropped,
        )
        model = apply(setting.model, others)
        data = setting.data.of(one)
        view = see_beyond(replace(setting, model=model, data=data), [place.at])
        group = place.pattern if place.pattern in ("actuator", "sensor") else "internal"
        pattern = view.pattern(place.at, group)
        power = np.sum(np.abs(pattern) ** 2, axis=1)
        force = np.einsum("ln,eln->el", pattern.conj(), view.r) / np.maximum(power, 1e-300)
        lines = np.where(np.abs(force[0]) ** 2 * power > _CLEAR, force[0], 0.0)
        whole = np.zeros(size // 2 + 1, dtype=np.complex128)
        whole[: len(lines)] = lines
        samples = np.fft.irfft(whole * size, n=size)
        if group == "internal":
            b = view.weights(place.at)
            d, v = b @ view.d[0], b @ view.v[0]
        else:
            i = view.names.index(place.at[0])
            d = view.u[0, setting.rig.driven.index(i)] if group == "actuator" else view.motion[0, i]
            v = np.gradient(d) * setting.rig.sample_rate
        fitted = _fitted(place.at, here, linear, d, v, setting.rig.sample_rate, group)
        thin = np.linspace(0, size - 1, min(_POINTS, size)).astype(int)
        found.append(
            ForceCurve(place.at, d[thin], v[thin], samples[thin], None if fitted is None else fitted[thin])
        )
    return tuple(found)


def _fitted(
    at: tuple[str, ...],
    effects: Sequence[Effect],
    linear: Sequence[tuple[LinearKey, float]],
    d: Real,
    v: Real,
    rate: float,
    group: str,
) -> Real | None:
    """Force of laws at one place along a motion; None if there are none."""
    if not effects and not linear:
        return None
    if group != "internal":
        out = d
        for effect in effects:
            if isinstance(effect, Electronic):
                out, memory = effect.apply(out, rate)
                out, _ = effect.apply(d, rate, memory)
        return np.asarray(d - out if group == "actuator" else out - d)
    parts: dict[type[Effect], Real] = {Stiffness: d, Damping: v, Mass: np.gradient(v) * rate}
    total = np.zeros_like(d)
    for effect in effects:
        sign = 1.0 if effect.at == at else -1.0
        if isinstance(effect, Restoring):
            total += sign * effect.over_period(sign * d, sign * v)
        elif type(effect) in LINEAR:
            total += effect.parameters()["coefficient"] * parts[type(effect)]
    for (kind, _), change in linear:
        if not isinstance(kind, str):
            total += change * parts[kind]
    return total
