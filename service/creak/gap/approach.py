"""Linear elements of a beam brought near their values, step by step, whatever force acts at one place.

Between its stations a beam has modes of its own, so that a regression on properties that are 10 % off is far from
linear: a single one misses. Here the regression is repeated from where the last one led, the force at the supposed
place left free, so that no law need be known yet.
"""

import numpy as np
from numpy.typing import NDArray

from creak.errors import ConfigurationError
from creak.gap.hypothesis import Hypothesis, apply, own_elements
from creak.gap.regression import Indices, LinearKey, Sums
from creak.gap.setting import Setting
from creak.gap.view import see
from creak.records import Real

STEPS = 12
_MOVE = 0.1  # of its value that a number of the model moves in a step, at most
_GAIN = 1e-3  # relative, below which another step does not pay
_DAMPED = 0.1  # share of a step below which it is given up


def approach(
    setting: Setting,
    experiments: Indices,
    place: tuple[str, tuple[str, ...]] | None,
    free: NDArray[np.bool_],
    start: Hypothesis,
    steps: int = STEPS,
) -> tuple[float, Hypothesis]:
    """Move linear elements until what is left beside a free force at a place falls no further.

    Parameters
    ----------
    setting : Setting
    experiments : array of int
    place : tuple of str and tuple, or None
        Group and place of the free force; None for no force.
    free : array of bool, (K,)
        Linear elements that move, as `Sums` orders them.
    start : Hypothesis
        Linear changes from which to begin.
    steps : int
        At most so many.

    Returns
    -------
    float
        Whitened power that is left.
    Hypothesis
        Linear changes.
    """
    own = {item.key: item.value for item in own_elements(setting.model)}
    changes = dict(start.linear)
    sums = _sums(setting, changes, experiments)
    if sums is None:
        return np.inf, start
    left, share = _left(sums, place), 1.0
    for _ in range(steps):
        wanted = _fit(sums, place, free)
        step = {key: float(c) for key, c in zip(sums.elements, wanted, strict=True) if c}
        # Every number by its own bound: the one that the data hold least must not slow the others.
        for key, value in own.items():
            if key in step:
                most = _MOVE * (value + changes.get(key, 0.0))
                step[key] = min(max(step[key], -most), most)
        while share > _DAMPED:
            trial = {key: changes.get(key, 0.0) + share * step.get(key, 0.0) for key in {*changes, *step}}
            moved = _sums(setting, trial, experiments)
            after = np.inf if moved is None else _left(moved, place)
            if moved is not None and after < left:
                break
            share /= 3
        else:
            break
        gain, left, changes, sums, share = 1 - after / left, after, trial, moved, min(1.0, 3 * share)
        if gain < _GAIN:
            break
    order = {key: i for i, key in enumerate(sums.elements)}
    return left, Hypothesis(linear=tuple(sorted(changes.items(), key=lambda item: order[item[0]])))


def _sums(setting: Setting, changes: dict[LinearKey, float], experiments: Indices) -> Sums | None:
    """Sums seen through the changed model; None where it cannot be."""
    try:
        model = apply(setting.model, Hypothesis(linear=tuple(changes.items())))
        view = see(setting.rig, model, setting.data.of(experiments), setting.top)
    except ConfigurationError:
        return None
    every = np.arange(len(experiments))
    return Sums(view, every, every[:0])


def _left(sums: Sums, place: tuple[str, tuple[str, ...]] | None) -> float:
    none = np.zeros(len(sums.elements), dtype=bool)
    if place is None:
        return sums.fit().left
    return sums.beside_free_force(sums.view.pattern(place[1], place[0])[..., None], none)


def _fit(sums: Sums, place: tuple[str, tuple[str, ...]] | None, free: NDArray[np.bool_]) -> Real:
    if place is None:
        return sums.fit((), free).linear
    return sums.fit_beside_free_force(sums.view.pattern(place[1], place[0])[..., None], free)[1]
