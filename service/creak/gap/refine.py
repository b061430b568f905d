"""Output-error fit: parameters moved until the steady simulation, harmonics and all, meets the measurement.

The regression takes the laws at the measured motion, whose noise biases it; here the motion is simulated, so the
estimate is that of maximum likelihood for white noise between lines, and its Jacobian gives the standard errors.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from creak.errors import ConfigurationError, SimulationError
from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.periodic import PeriodicData
from creak.gap.properties import stiffness_change
from creak.gap.regression import LINEAR, Indices
from creak.gap.view import lines_of
from creak.mechanics.effects import GROUND, Clearance, CoulombFriction, Effect, Hysteresis, OneSidedStop
from creak.mechanics.electronics import ActuatorHysteresis
from creak.mechanics.steady import SteadyState, simulate_steady
from creak.mechanics.system import Model, System, assemble
from creak.records import Complex, Real, Rig

_POINTS = (((CoulombFriction, Hysteresis), 16384), ((Clearance, OneSidedStop), 8192))
"""Points a period that a law needs; the others are smooth and do with 4096."""

_TOLERANCE = 1e-6
_STEP = 1e-3  # of a parameter, for difference quotients


@dataclass(frozen=True, eq=False)
class Setting:
    """What is fitted to what.

    Parameters
    ----------
    rig, model, data : Rig, Model, PeriodicData
    top : int
        Lines that count, from DC on.
    """

    rig: Rig
    model: Model
    data: PeriodicData
    top: int

    def system(self, hypothesis: Hypothesis) -> System:
        """Assemble the model with a hypothesis in it."""
        return assemble(apply(self.model, hypothesis), self.rig)

    def simulate(
        self,
        hypothesis: Hypothesis,
        experiments: Indices,
        guess: Real | None = None,
        oversampling: int | None = None,
    ) -> SteadyState:
        """Steady state of experiments."""
        return simulate_steady(
            self.system(hypothesis),
            self.data.u[experiments],
            self.rig.sample_rate,
            self.rig.hold,
            guess=guess,
            oversampling=oversampling or self.samples_a_sample(hypothesis),
            tolerance=_TOLERANCE,
        )

    def samples_a_sample(self, hypothesis: Hypothesis) -> int:
        """Samples of the elements a sample of the rig, so that folded harmonics lie below usual noise."""
        elements = self.system(hypothesis).elements
        if not elements:
            return 1
        wanted = max(next((size for kinds, size in _POINTS if isinstance(e, kinds)), 4096) for e in elements)
        return 1 << max(0, math.ceil(math.log2(wanted / self.rig.period_samples)))

    def residual(self, y: Real, experiments: Indices, top: int | None) -> Complex:
        """Whitened difference of simulated and measured motion, ``(E, top, n)``."""
        Y = lines_of(y)[:, :top]
        mean = self.data.Y[experiments][:, :top]
        return np.asarray((Y - mean) / np.sqrt(self.data.variance[:top]))


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

    Returns
    -------
    Refined
    """
    size = hypothesis.size
    state = _solved(setting, hypothesis, fitted, None, oversampling)
    if state is None:
        return Refined(hypothesis, np.full((size, size), np.nan), np.inf, np.inf, False)
    steady, r = state
    cost = float(np.sum(np.abs(r) ** 2))
    covariance = np.zeros((size, size))
    for _ in range(steps if size else 0):
        jacobian = _jacobian(setting, hypothesis, fitted, steady, r)
        gram = np.einsum("kx,jx->kj", jacobian, jacobian)
        right = -jacobian @ _flat(r)
        scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        covariance = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-12, hermitian=True) / np.outer(
            scale, scale
        )
        step = covariance @ right
        share, better = 1.0, None
        while share > 0.05:
            try:
                trial = with_vector(hypothesis, _limited(hypothesis, vector(hypothesis), share * step))
                better = _solved(setting, trial, fitted, steady.motion, steady.oversampling)
            except ConfigurationError:
                better = None
            if better is not None and float(np.sum(np.abs(better[1]) ** 2)) < cost * (1 + 1e-12):
                break
            better, share = None, share / 3
        if better is None:
            break
        gain = cost - float(np.sum(np.abs(better[1]) ** 2))
        hypothesis, (steady, r), cost = trial, better, cost - gain
        if gain < 0.02 and share == 1.0:
            break
    left = cost / r.size
    aside = _solved(setting, hypothesis, held, None, steady.oversampling) if len(held) else (steady, r)
    if aside is None:
        return Refined(hypothesis, covariance / 2, left, np.inf, False)
    # |r|^2 of a complex sample has mean 1, so real and imaginary part have variance 1/2.
    return Refined(hypothesis, covariance / 2, left, float(np.mean(np.abs(aside[1]) ** 2)), True)


def _solved(
    setting: Setting, hypothesis: Hypothesis, experiments: Indices, guess: Real | None, oversampling: int | None
) -> tuple[SteadyState, Complex] | None:
    """Steady state and residual; None if it does not settle."""
    try:
        steady = setting.simulate(hypothesis, experiments, guess, oversampling)
    except (SimulationError, ConfigurationError, np.linalg.LinAlgError):
        return None
    if not steady.settled:
        return None
    return steady, setting.residual(steady.y, experiments, setting.top)


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


def _jacobian(setting: Setting, hypothesis: Hypothesis, fitted: Indices, steady: SteadyState, r: Complex) -> Real:
    """Derivatives of the residual, ``(K, 2 E top n)``: differences for effects, tangents for linear elements."""
    values = vector(hypothesis)
    own = len(values) - len(hypothesis.linear)
    rows = []
    for k in range(own):
        h = _STEP * max(abs(values[k]), 1e-12)
        changed = values.copy()
        changed[k] += h
        other = None
        try:
            other = _solved(setting, with_vector(hypothesis, changed), fitted, steady.motion, steady.oversampling)
        except ConfigurationError:
            changed[k] -= 2 * h
            h = -h
            other = _solved(setting, with_vector(hypothesis, changed), fitted, steady.motion, steady.oversampling)
        rows.append(np.zeros(2 * r.size) if other is None else _flat((other[1] - r) / h))
    if hypothesis.linear:
        rows += [_flat(row) for row in _linear_rows(setting, hypothesis, steady)]
    return np.array(rows)


def _linear_rows(setting: Setting, hypothesis: Hypothesis, steady: SteadyState) -> list[Complex]:
    """Derivatives to linear changes, the nonlinear elements replaced by their equivalent linear ones."""
    system, rig, top = setting.system(hypothesis), setting.rig, setting.top
    stiffness, damping = np.zeros(len(system.elements)), np.zeros(len(system.elements))
    for i in range(len(system.elements)):
        d, f = steady.motion[:, i], steady.force[:, i]
        d = d - d.mean(axis=-1, keepdims=True)
        rate = np.gradient(d, axis=-1) * (rig.sample_rate * steady.oversampling)
        stiffness[i] = np.sum(f * d) / max(float(np.sum(d * d)), 1e-300)
        damping[i] = np.sum(f * rate) / max(float(np.sum(rate**2)), 1e-300)
    s: Complex = np.asarray(2j * np.pi * np.arange(top) * rig.sample_rate / rig.period_samples, np.complex128)
    rows_at = {node.name: system.outputs[i] for i, node in enumerate(rig.nodes)}
    equivalent = system.linearised(stiffness, damping)
    receptance = equivalent.outputs @ equivalent.motion(np.abs(s) / (2 * np.pi), system.outputs.T)
    order = np.array(system.derivatives)
    differentiated = s[:, None] ** order
    Y = lines_of(steady.y)[:, :top]
    D = np.where(np.abs(differentiated) > 0, Y / np.where(differentiated == 0, 1.0, differentiated), 0.0)
    names = list(rows_at)
    sigma = np.sqrt(setting.data.variance[:top])
    found = []
    corrected = apply(setting.model, hypothesis)
    for (kind, at), _ in hypothesis.linear:
        if isinstance(kind, str):
            force = np.matmul(stiffness_change(rig, corrected, kind, s), D[..., None])
            found.append(-np.matmul(receptance, force)[..., 0] * differentiated / sigma)
            continue
        b = np.zeros(rig.n)
        b[names.index(at[0])] = 1.0
        if at[1] != GROUND:
            b[names.index(at[1])] = -1.0
        force = (D @ b) * s ** LINEAR[kind]
        found.append(-((receptance @ b) * differentiated / sigma)[None] * force[..., None])
    return found
