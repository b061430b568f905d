"""The step of a quantised sensor: a likelihood of cliffs, whose mean and width are found by looking at it.

A sample moves by a whole step as soon as the step changes enough for it to be rounded the other way, so the
likelihood has no slope that says anything: it falls off on both sides of its peak like a tent, much more steeply
than its curvature between two cliffs would tell. So it is drawn on ever finer grids around its peak, and the
posterior's mean and standard deviation are taken.
"""

from dataclasses import replace

import numpy as np

from creak.gap.hypothesis import Hypothesis
from creak.gap.regression import Indices
from creak.gap.setting import Setting
from creak.gap.view import lines_of
from creak.mechanics.electronics import SensorQuantisation
from creak.records import Real

_POINTS = 48
_ROUNDS = 12
_WIDE = 8.0  # of its levels' share by which a first guess may be off
_DEEP = 12.0  # log likelihood below the peak beyond which nothing counts


def quantised(hypothesis: Hypothesis) -> list[int]:
    """Indices of the quantised sensors among the effects."""
    return [i for i, effect in enumerate(hypothesis.effects) if isinstance(effect, SensorQuantisation)]


def settle_step(
    setting: Setting, hypothesis: Hypothesis, index: int, y: Real, experiments: Indices
) -> tuple[Hypothesis, float]:
    """Posterior mean of one sensor's step and its standard deviation, all else held.

    Parameters
    ----------
    setting : Setting
    hypothesis : Hypothesis
    index : int
        Of the quantised sensor among the effects.
    y : array, (E, n, N)
        Simulated responses before the rounding, at the experiments.
    experiments : array of int

    Returns
    -------
    Hypothesis
    float
    """
    effect = hypothesis.effects[index]
    assert isinstance(effect, SensorQuantisation)
    node = next(i for i, node in enumerate(setting.rig.nodes) if node.name == effect.at[0])
    samples = y[:, node]
    sigma = np.sqrt(setting.data.variance[: setting.top, node])
    mean = setting.data.Y[experiments][:, : setting.top, node]

    def cost(step: float) -> float:
        seen = SensorQuantisation(effect.at, step)._passed(samples, setting.rig.sample_rate)
        Y = lines_of(seen[:, None])[:, : setting.top, 0]
        return float(np.sum(np.abs((Y - mean) / sigma) ** 2))

    peak = float(np.max(np.abs(samples)))
    best, width = effect.step, _WIDE * effect.step / max(peak / effect.step, 1.0) * 0.25
    for _ in range(_ROUNDS):
        grid = best + width * np.linspace(-1.0, 1.0, 2 * _POINTS + 1)
        costs = np.array([cost(step) for step in grid])
        near = np.flatnonzero(costs < costs.min() + _DEEP)
        best = float(grid[np.argmin(costs)])
        if len(near) > _POINTS // 3:
            break
        width *= max(2.0 * (near[-1] - near[0] + 2) / (2 * _POINTS), 0.05)
    weights = np.exp(costs.min() - costs)
    weights /= weights.sum()
    centre = float(weights @ grid)
    spread = float(np.sqrt(weights @ (grid - centre) ** 2 + (grid[1] - grid[0]) ** 2 / 12))
    effects = list(hypothesis.effects)
    effects[index] = replace(effect, step=centre)
    return replace(hypothesis, effects=tuple(effects)), spread


def before_rounding(setting: Setting, hypothesis: Hypothesis, experiments: Indices, oversampling: int) -> Real:
    """Simulated responses as they are before quantised sensors round them."""
    kept = tuple(effect for effect in hypothesis.effects if not isinstance(effect, SensorQuantisation))
    return setting.simulate(replace(hypothesis, effects=kept), experiments, None, oversampling).y
