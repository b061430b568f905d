"""Output-error fit: parameters moved until the steady simulation, harmonics and all, meets the measurement.

The regression takes the laws at the measured motion, whose noise biases it; here the motion is simulated, so the
estimate is that of maximum likelihood for white noise between lines, and its Jacobian gives the standard errors.
"""

import math
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from creak.errors import ConfigurationError, SimulationError
from creak.gap.hypothesis import Hypothesis, own_elements
from creak.gap.regression import Indices
from creak.gap.rounding import before_rounding, quantised, settle_step
from creak.gap.setting import TOLERANCE, Setting
from creak.gap.view import lines_of
from creak.mechanics.effects import Damping, Effect, Mass, Stiffness
from creak.mechanics.electronics import ActuatorHysteresis
from creak.mechanics.sensitivity import Neighbours, sensitivities
from creak.mechanics.steady import MOST_SAMPLES, Each, SteadyState
from creak.mechanics.system import System
from creak.records import Complex, Real

FINE = 1e-9
_STEP = 1e-4  # of a parameter, for difference quotients
_MOVED = 10.0  # gain of a step in the log likelihood after which its Jacobian is taken anew
_GAINED = 0.02  # below which a step is the last
_COARSE = 4096  # points a period at which tangents are taken
_PART = 8  # experiments at most that are simulated together


@dataclass(frozen=True, eq=False)
class Refined:
    """A hypothesis with its best parameters.

    Parameters
    ----------
    hypothesis : Hypothesis
    covariance : array, (K, K)
        Of the effects' parameters, then of the linear changes.
    left : float
        Whitened power a complex sample at the experiments of the fit, lines below ``top``.
    held : float
        The same on those kept aside.
    settled : bool
        False if the steady state was not found for some experiment.
    """

    hypothesis: Hypothesis
    covariance: Real
    left: float
    held: float
    settled: bool
    guess: Real | None = field(default=None, repr=False)
    jacobian: Real | None = field(default=None, repr=False)


def vector(hypothesis: Hypothesis) -> Real:
    """Free parameters: those of the effects, then the linear changes."""
    values = [value for effect in hypothesis.effects for value in effect.parameters().values()]
    return np.array(values + [change for _, change in hypothesis.linear])


def with_vector(hypothesis: Hypothesis, values: Real) -> Hypothesis:
    """Hypothesis with other numbers.

    Raises
    ------
    ConfigurationError
        If an effect cannot have them.
    """
    rest = [float(value) for value in values]
    effects: list[Effect] = []
    for effect in hypothesis.effects:
        names = effect.parameter_names()
        effects.append(type(effect)(effect.at, *rest[: len(names)]))
        rest = rest[len(names) :]
    linear = tuple((key, change) for (key, _), change in zip(hypothesis.linear, rest, strict=True))
    return replace(hypothesis, effects=tuple(effects), linear=linear)


def refine(
    setting: Setting,
    hypothesis: Hypothesis,
    fitted: Indices,
    held: Indices,
    steps: int = 4,
    oversampling: int | None = None,
    tolerance: float = TOLERANCE,
    near: Refined | None = None,
    each: Each = map,
) -> Refined:
    """Gauss-Newton steps from a hypothesis, damped if they do not pay.

    Parameters
    ----------
    setting : Setting
    hypothesis : Hypothesis
        Where to begin.
    fitted, held : array of int
        Experiments.
    steps : int
        At most so many.
    oversampling : int, optional
        Of the solver; by default as much as it needs.
    tolerance : float
        Of the solver.
    near : Refined, optional
        Fit to the same experiments from nearby, whose motion and Jacobian serve to begin with.
    each : callable
        What parts of the experiments are simulated by, as for `creak.gap.search.Search`.

    Returns
    -------
    Refined
    """
    size = hypothesis.size
    output = _solved(setting, hypothesis, fitted, near.guess if near else None, oversampling, tolerance, each)
    if output is None:
        return Refined(hypothesis, np.full((size, size), np.nan), np.inf, np.inf, False)
    oversampling = output.parts[0].oversampling
    cost = _cost(output.r)
    jacobian = near.jacobian if near else None
    covariance = np.zeros((size, size)) if jacobian is None else _inverse(jacobian @ jacobian.T)
    gain = 0.0
    for _ in range(steps if size else 0):
        if gain > _MOVED or jacobian is None:
            jacobian = _jacobian(setting, hypothesis, fitted, output, each)
            covariance = _inverse(jacobian @ jacobian.T)
        step = covariance @ (-jacobian @ _flat(output.r))
        share, better = 1.0, None
        while share > 0.05:
            try:
                trial = with_vector(hypothesis, _limited(hypothesis, vector(hypothesis), share * step))
                better = _solved(setting, trial, fitted, output.motion, oversampling, tolerance, each)
            except ConfigurationError:
                better = None
            if better is not None and _cost(better.r) < cost * (1 + 1e-12):
                break
            better, share = None, share / 3
        if better is None:
            break
        gain = cost - _cost(better.r)
        hypothesis, output, cost = trial, better, cost - gain
        if gain < _GAINED and share == 1.0:
            break
    left = cost / output.r.size
    aside = _solved(setting, hypothesis, held, None, oversampling, tolerance, each) if len(held) else output
    apart = float(np.mean(np.abs(aside.r) ** 2)) if aside is not None else np.inf
    # |r|^2 of a complex sample has mean 1, so real and imaginary part have variance 1/2.
    return Refined(hypothesis, covariance / 2, left, apart, aside is not None, output.motion, jacobian)


def conclude(
    setting: Setting, hypothesis: Hypothesis, fitted: Indices, held: Indices, *, whole: bool, each: Each = map
) -> Refined:
    """Fit to the end: what is stated, and by how much it may be wrong.

    The steady state is solved until neither its tolerance nor harmonics that fold may move a parameter by a
    tenth of its standard error.

    Parameters
    ----------
    setting : Setting
    hypothesis : Hypothesis
    fitted, held : array of int
    whole : bool
        Free all linear numbers that the model has. Where many had to move, all of them are uncertain, and one
        that was left where it was because it nearly fits would bias the others and hide how uncertain they are.
    each : callable
        As for `refine`.

    Returns
    -------
    Refined
        Its covariance allows for weights that are themselves estimated.
    """
    if whole:
        had = {key for key, _ in hypothesis.linear}
        more = tuple((own.key, 0.0) for own in own_elements(setting.model) if own.key not in had and own.value > 0)
        hypothesis = replace(hypothesis, linear=(*hypothesis.linear, *more))
    oversampling = setting.samples_a_sample(hypothesis)
    refined = refine(setting, hypothesis, fitted, held, 5, oversampling, FINE, each=each)
    while refined.settled and setting.system(hypothesis).elements and refined.hypothesis.size:
        finer = 2 * oversampling
        if finer * setting.rig.period_samples > MOST_SAMPLES:
            break
        again = refine(setting, refined.hypothesis, fitted, held, 2, finer, FINE, refined, each)
        if not again.settled:
            break
        moved = vector(again.hypothesis) - vector(refined.hypothesis)
        errors = np.sqrt(np.maximum(np.diag(again.covariance), 1e-300))
        refined, oversampling = again, finer
        if np.all(np.abs(moved) < 0.1 * errors):
            break
    refined = rounded(setting, refined, fitted, held, oversampling, each)
    # Weights that are estimated from nu degrees of freedom lose nu/(nu - 2) of what they seem to know, and
    # what a fit leaves beyond noise counts as noise.
    nu = setting.data.degrees
    more_left = max(1.0, refined.left * (nu - 1) / nu)
    return replace(refined, covariance=refined.covariance * (nu / (nu - 2)) * more_left)


def rounded(
    setting: Setting,
    refined: Refined,
    fitted: Indices,
    held: Indices,
    oversampling: int | None = None,
    each: Each = map,
) -> Refined:
    """Fit with the steps of quantised sensors found as such, in turn with all else; the same fit without any.

    Parameters
    ----------
    setting : Setting
    refined : Refined
        Near enough: Gauss-Newton steps leave a quantiser's step where they begin, its likelihood has no slope.
    fitted, held, oversampling, each
        As for `refine`.
    """
    which = quantised(refined.hypothesis)
    if not which or not refined.settled:
        return refined
    oversampling = oversampling or setting.samples_a_sample(refined.hypothesis)
    spreads = {}
    for turn in range(2 if refined.hypothesis.size > 1 else 1):
        hypothesis = refined.hypothesis
        y = before_rounding(setting, hypothesis, fitted, oversampling)
        for i in which:
            hypothesis, spreads[i] = settle_step(setting, hypothesis, i, y, fitted)
        refined = refine(setting, hypothesis, fitted, held, 0 if turn else 2, oversampling, FINE, refined, each)
    covariance = refined.covariance.copy()
    for i, spread in spreads.items():
        at = sum(len(effect.parameter_names()) for effect in refined.hypothesis.effects[:i])
        covariance[at, at] = spread**2
    return replace(refined, covariance=covariance)


def _cost(r: Complex) -> float:
    return float(np.sum(np.abs(r) ** 2))


def _inverse(gram: Real) -> Real:
    """Inverse of a Gram matrix of rows of very unlike size; 0 along what the data do not hold."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    both = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(gram / both, rcond=1e-12, hermitian=True) / both)


@dataclass(frozen=True, eq=False)
class _Output:
    """Simulated experiments, in parts of at most `_PART`.

    Parameters
    ----------
    parts : tuple of SteadyState
        Without responses and forces.
    r : array, (E, top, n)
        Whitened residual of all.
    """

    parts: tuple[SteadyState, ...]
    r: Complex

    @property
    def motion(self) -> Real:
        """Displacements of the elements in all experiments."""
        return np.concatenate([part.motion for part in self.parts])


_Part = tuple[Indices, Real | None]
"""Experiments, and motion to begin with."""


def _parts(experiments: Indices) -> list[Indices]:
    """Parts of the experiments, of nearly one size: how many hangs on nothing else, nor do sums over them."""
    return np.array_split(experiments, math.ceil(len(experiments) / _PART))


def _solved(
    setting: Setting,
    hypothesis: Hypothesis,
    experiments: Indices,
    guess: Real | None,
    oversampling: int | None,
    tolerance: float,
    each: Each,
) -> _Output | None:
    """Steady state and residual; None if it does not settle."""
    parts = _parts(experiments)
    guesses = [None] * len(parts) if guess is None else np.array_split(guess, len(parts))
    task = partial(_solved_part, setting, hypothesis, oversampling, tolerance)
    solved = list((each if len(parts) > 1 else map)(task, zip(parts, guesses, strict=True)))
    settled = [part for part in solved if part is not None]
    if len(settled) < len(parts):
        return None
    return _Output(tuple(steady for steady, _ in settled), np.concatenate([r for _, r in settled]))


def _solved_part(
    setting: Setting, hypothesis: Hypothesis, oversampling: int | None, tolerance: float, part: _Part
) -> tuple[SteadyState, Complex] | None:
    experiments, guess = part
    try:
        steady = setting.simulate(hypothesis, experiments, guess, oversampling, tolerance)
    except (SimulationError, ConfigurationError, np.linalg.LinAlgError):
        return None
    if not steady.settled:
        return None
    r = setting.residual(steady.y, experiments, setting.top)
    return replace(steady, y=steady.y[:0], force=steady.force[:0]), r


def _flat(r: Complex) -> Real:
    return np.ascontiguousarray(r).reshape(-1).view(np.float64)


def _limited(hypothesis: Hypothesis, values: Real, step: Real) -> Real:
    """Step that keeps positive parameters positive and shares within [0, 1]."""
    moved = values + step
    i = 0
    for effect in hypothesis.effects:
        for name in effect.parameter_names():
            if name in effect.positive:
                moved[i] = min(max(moved[i], values[i] / 3), 3 * values[i])
            if name in effect.not_negative:
                moved[i] = max(moved[i], 0.0)
            if isinstance(effect, ActuatorHysteresis) and name == "share":
                moved[i] = min(moved[i], 1.0)
            i += 1
    return moved


def _jacobian(setting: Setting, hypothesis: Hypothesis, fitted: Indices, output: _Output, each: Each) -> Real:
    """Derivatives of the whitened residual, ``(K, 2 E top n)``."""
    here = setting.system(hypothesis)
    values, steps = vector(hypothesis), _steps(setting, hypothesis, here, output.motion)
    pairs = []
    for k, h in enumerate(steps):
        ends, width = [], 0.0
        for sign in (1.0, -1.0):
            changed = values.copy()
            changed[k] += sign * h
            try:
                ends.append(setting.system(with_vector(hypothesis, changed)))
                width += h
            except ConfigurationError:
                ends.append(here)
        pairs.append(Neighbours(ends[0], ends[1], max(width, 1e-300)))
    parts = _parts(fitted)
    task = partial(_jacobian_part, setting, here, pairs)
    rows = (each if len(parts) > 1 else map)(task, zip(parts, output.parts, strict=True))
    return np.concatenate(list(rows), axis=1)


def _jacobian_part(
    setting: Setting, here: System, pairs: list[Neighbours], part: tuple[Indices, SteadyState]
) -> Real:
    experiments, steady = part
    data, rig, top = setting.data, setting.rig, setting.top
    coarse = max(1, _COARSE // rig.period_samples)
    sigma = np.sqrt(data.variance[:top])
    found = sensitivities(here, steady, data.u[experiments], rig.sample_rate, rig.hold, pairs, coarse)
    return np.array([_flat(lines_of(y)[:, :top] / sigma) for y in found])


def _steps(setting: Setting, hypothesis: Hypothesis, system: System, motion: Real) -> list[float]:
    """Steps for difference quotients: a small part of every parameter, of its like in the model where it is 0."""
    sizes = {
        "gap": float(np.std(motion)) if motion.size else 1.0,
        "delay": 1 / setting.rig.sample_rate,
        "width": float(np.std(setting.data.u)),
        "damping_ratio": 1.0,
        "share": 1.0,
    }
    steps = [
        _STEP * (abs(value) or sizes.get(name, 1.0))
        for effect in hypothesis.effects
        for name, value in effect.parameters().items()
    ]
    own = {item.key: item.value for item in own_elements(setting.model)}
    middle = np.array([0.5 * (setting.rig.lines[0] + setting.rig.lines[-1]) * setting.rig.sample_rate])
    middle /= setting.rig.period_samples
    stiff = 1 / float(np.max(np.abs(system.outputs @ system.motion(middle, system.outputs.T))))
    for key, change in hypothesis.linear:
        order = {Stiffness: 0, Damping: 1, Mass: 2}.get(key[0], 0) if not isinstance(key[0], str) else 0
        like = 1e-2 * stiff / (2 * np.pi * float(middle[0])) ** order
        steps.append(_STEP * (own.get(key, 0.0) or abs(change) or like))
    return steps
