"""Effects that act where nothing is measured: on a beam between its sensors, at a mass that has none.

A missing force F at a point x shows as motion ``h_x(w) F(w)`` of the sensors, with the receptances ``h_x`` between
x and them. Left free per line and experiment, F takes up all but noise where x is right. Then F and the motion of
x are known, and the laws compete there as they do at a measured place. At last x moves together with the law's
parameters in an output-error fit, whose Jacobian gives the position's standard error.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from creak.errors import ConfigurationError
from creak.gap.hidden import Place, Profile, extended, finest, intervals, profile, with_station
from creak.gap.hypothesis import Hypothesis
from creak.gap.records import MissingForce
from creak.gap.refine import Refined, refine, vector, with_vector
from creak.gap.regression import Indices
from creak.gap.scan import Scan
from creak.gap.setting import Setting
from creak.gap.view import View, see
from creak.mechanics.beam import Beam
from creak.mechanics.effects import GROUND, Effect
from creak.mechanics.steady import Each
from creak.records import Real

_NOISE = 1.15  # whitened power that a free force leaves at most at the only place where something acts
_TRIED = 3  # laws of a place that are fitted to the output
_MOVED = 2  # of which so many are moved along the beam
_ODDS = 20.0  # in twice the log likelihood: what the data still cannot tell apart
_PLACES = 4  # places that are alike and are all given their laws
_EXPERIMENTS = 6  # for the fit to the output
_STEP = 1e-4  # of the beam's length, for difference quotients
_ROUNDS = 6
_SHORTEST = 0.05  # share of a step that is still tried
_GAIN = 0.02  # in the log likelihood, below which another round does not pay


@dataclass(frozen=True, eq=False)
class Located:
    """An effect at a place that is not measured.

    Parameters
    ----------
    setting : Setting
        Its model has the point, for instance as a station without sensor.
    refined : Refined or None
        The law there, fitted to the output together with the position; None if none leaves noise.
    at : tuple of str
    rest : float
        Whitened power that a free force leaves there, relative to noise.
    position, standard_error : float or None
        On a beam, m; with the law's parameters free beside it, or a free force if no law is known.
    alike : tuple of (Place or interval)
        Where the sensors alone cannot tell the force from this place: intervals of positions in m, or names.
    """

    setting: Setting
    refined: Refined | None
    at: Place
    rest: float
    position: float | None = None
    standard_error: float | None = None
    alike: tuple[tuple[float, float] | Place, ...] = ()

    def on(self, force: MissingForce) -> MissingForce:
        """Missing force with the position, if it is the one that was located."""
        if force.at != self.at:
            return force
        return replace(force, position=self.position, position_error=self.standard_error)

    def notes(self) -> list[str]:
        """What the sensors cannot tell, a sentence each."""
        where = [_words(item) for item in self.alike]
        return [f"the sensors cannot tell {self.at[0]}-{self.at[1]} from {' or '.join(where)}"] if where else []


def _words(alike: tuple[float, float] | Place) -> str:
    low, high = alike
    if isinstance(low, str):
        return f"{low}-{high}"
    return f"{low:.4g} m" if low == high else f"{low:.4g} to {high:.4g} m"


def locate(
    setting: Setting,
    fitted: Indices,
    held: Indices,
    floor: float,
    explains: Callable[[Refined], bool],
    each: Each = map,
) -> Located | None:
    """Find an effect at a place that is not measured; None where a free force leaves more than noise at each.

    Parameters
    ----------
    setting : Setting
    fitted, held : array of int
        Experiments of the fit, and others.
    floor : float
        Whitened power of noise alone.
    explains : callable
        Whether a fitted law leaves noise.
    each : callable
        What laws are fitted by, as for `creak.gap.search.Search`.

    Returns
    -------
    Located or None
    """
    view = see(setting.rig, setting.model, setting.data, setting.top)
    seen = profile(setting, view, fitted)
    if seen is None:
        return None
    scan = Scan(view, fitted, held, floor)
    measured = scan.places(scan.none)
    if isinstance(setting.model, Beam):
        # Near a station a force between sensors looks like one at the station: measured places go first.
        if measured[0][0] <= _NOISE:
            return None
        return _on_beam(setting, view, seen, fitted, held, floor, explains, each)
    best = int(np.argmin(seen.rest))
    if seen.rest[best] > _NOISE * floor or measured[0][0] <= 0.9 * seen.rest[best] / floor:
        return None
    order = np.argsort(seen.rest)[:_PLACES]
    alike = [seen.places[i] for i in order if seen.rest[i] <= 1.05 * seen.rest[best]]
    found = [(law, at) for at in alike for law in _laws(setting, at, fitted, held, floor, each) if explains(law)]
    if not found:
        return Located(setting, None, alike[0], float(seen.rest[best]) / floor, alike=tuple(alike[1:]))
    score = _scored(setting, held if len(held) else fitted, floor)
    refined, at = min(found, key=lambda item: score(item[0]))
    near = score(refined) + _ODDS
    others = {other: None for law, other in found if other != at and score(law) < near}
    return Located(setting, refined, at, float(seen.rest[seen.places.index(at)]) / floor, alike=tuple(others))


def _on_beam(
    setting: Setting,
    view: View,
    seen: Profile,
    fitted: Indices,
    held: Indices,
    floor: float,
    explains: Callable[[Refined], bool],
    each: Each,
) -> Located | None:
    assert isinstance(setting.model, Beam)
    start, error, rest = finest(setting, view, seen, fitted)
    if rest > _NOISE * floor:
        return None
    model, name = with_station(setting.model, start)
    placed = replace(setting, model=model)
    stretches = intervals(seen)
    alike = stretches if len(stretches) > 1 else ()
    unknown = Located(placed, None, (name, GROUND), rest / floor, start, error, alike)
    laws = _laws(placed, (name, GROUND), fitted, held, floor, each)[:_MOVED]
    for moved in each(partial(_moved, setting, start, fitted), [law.hypothesis for law in laws]):
        if moved is None:
            continue
        model, name = with_station(setting.model, moved.position)
        placed = replace(setting, model=model)
        # No step, for the power that it leaves on experiments kept aside.
        refined = refine(placed, _renamed(moved.hypothesis, name), fitted, held, 0)
        if refined.settled and explains(refined):
            refined = replace(refined, covariance=moved.covariance[1:, 1:])
            deviation = float(np.sqrt(moved.covariance[0, 0]))
            return Located(placed, refined, (name, GROUND), rest / floor, moved.position, deviation, alike)
    return unknown


def _laws(setting: Setting, at: Place, fitted: Indices, held: Indices, floor: float, each: Each) -> list[Refined]:
    """Laws at one place fitted to the output, the best first."""
    view = see(setting.rig, setting.model, setting.data, setting.top)
    scan = Scan(extended(view, at), fitted, held, floor)
    trials = [trial for trial in scan.trials("internal", at, scan.none) if np.isfinite(trial.rest)]
    found = [scan.hypothesis([trial], scan.none).hypothesis for trial in trials[:_TRIED]]
    fits = each(partial(refine, setting, fitted=_few(fitted), held=_few(held), steps=3), found)
    return sorted(
        (refined for refined in fits if refined.settled),
        key=_scored(setting, held if len(held) else fitted, floor),
    )


def _scored(setting: Setting, experiments: Indices, floor: float) -> Callable[[Refined], float]:
    """Bayesian information criterion of laws on experiments: of two that fit alike the simpler one is better."""
    samples = len(_few(experiments)) * setting.top * setting.rig.n
    return lambda law: 2 * samples * law.held / floor + law.hypothesis.size * float(np.log(2 * samples))


def _few(experiments: Indices) -> Indices:
    """Some of many experiments, spread evenly."""
    chosen = np.linspace(0, len(experiments) - 1, min(_EXPERIMENTS, len(experiments)))
    return np.asarray(experiments[chosen.astype(int)])


def _renamed(hypothesis: Hypothesis, name: str) -> Hypothesis:
    effects: list[Effect] = []
    for effect in hypothesis.effects:
        values = effect.parameters().values()
        effects.append(type(effect)((name, *effect.at[1:]), *values))
    return replace(hypothesis, effects=tuple(effects))


@dataclass(frozen=True, eq=False)
class _Moved:
    position: float
    hypothesis: Hypothesis
    covariance: Real  # of the position, then of the law's parameters


def _moved(setting: Setting, position: float, experiments: Indices, hypothesis: Hypothesis) -> _Moved | None:
    """Move position and parameters together by Gauss-Newton; None where the motion is not found."""
    beam = setting.model
    assert isinstance(beam, Beam)

    def residual(values: Real) -> Real | None:
        if not 0 <= values[0] <= beam.length:
            return None
        model, name = with_station(beam, float(values[0]))
        try:
            law = with_vector(_renamed(hypothesis, name), values[1:])
            steady = replace(setting, model=model).simulate(law, experiments)
        except (ConfigurationError, np.linalg.LinAlgError):
            return None
        if not steady.settled:
            return None
        return setting.residual(steady.y, experiments, setting.top).reshape(-1).view(np.float64)

    def slope(values: Real, k: int, r: Real) -> Real:
        size = beam.length * _STEP if k == 0 else 1e-3 * max(abs(values[k]), 1e-12)
        for h in (size, -size):
            changed = values.copy()
            changed[k] += h
            other = residual(changed)
            if other is not None:
                return (other - r) / h
        return np.zeros_like(r)

    values = np.array([position, *vector(hypothesis)])
    r = residual(values)
    if r is None:
        return None
    for _ in range(_ROUNDS):
        jacobian = np.array([slope(values, k, r) for k in range(len(values))])
        scale = np.maximum(np.linalg.norm(jacobian, axis=1), 1e-300)
        unit = jacobian / scale[:, None]
        # Real and imaginary part of a whitened sample have variance 1/2.
        covariance = np.linalg.pinv(unit @ unit.T, hermitian=True) / np.outer(scale, scale) / 2
        step = -2 * covariance @ (jacobian @ r)
        share, better = 1.0, None
        while better is None and share > _SHORTEST:
            better = residual(values + share * step)
            if better is None or better @ better > r @ r:
                better, share = None, share / 3
        if better is None:
            break
        gain = float(r @ r - better @ better)
        values, r = values + share * step, better
        if gain < _GAIN:
            break
    return _Moved(float(values[0]), with_vector(hypothesis, values[1:]), covariance)
