"""Several effects at once: sets of laws that grow by one, with swaps, since a greedy choice is often half wrong.

The first law of a greedy search likes to be one that mimics a sum. So a few sets are kept at every size, their
inner parameters are searched in turn, and every member of the best set is dropped and searched anew.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from creak.gap.regression import Column, Indices
from creak.gap.scan import Found, Place, Scan, Trial
from creak.mechanics.steady import Each
from creak.records import Real

_WIDE = 3  # sets kept at every size
_PLACES = 5  # places at which a further law is tried
_LAWS = 3  # of each that go on
_TURNS = 3  # in which the inner parameters of a set are searched
_TRIES = 40  # of a simplex, for every inner parameter
_ENOUGH = 1.1  # whitened power at which nothing is left to swap for
_GAIN = 0.98  # of the rest that a swap must leave

Set = tuple[Trial, ...]


def grown(scan: Scan, sets: Sequence[Set], free: NDArray[np.bool_], each: Each = map) -> list[Set]:
    """Sets with one law more, the best first.

    Parameters
    ----------
    scan : Scan
    sets : sequence of tuple of Trial
        The best so far, of one size; one empty set to begin with.
    free : array of bool, (K,)
        Linear elements fitted beside them.
    each : callable
        What the laws of places and the sets are tried by, as for `simulate_steady`.
    """
    further = _further(scan, sets, free, each)
    found = [(*have, more) for have, some in zip(sets, further, strict=True) for more in some]
    found = distinct(sorted(found, key=lambda item: item[-1].rest))[:_WIDE]
    polished = sorted(each(partial(polish, scan, free=free), found), key=rest)
    if polished and len(polished[0]) > 1 and rest(polished[0]) > _ENOUGH:
        polished = sorted([swapped(scan, polished[0], free, each), *polished[1:]], key=rest)
    return polished


def rest(trials: Set) -> float:
    """What a set leaves relative to noise: as its member that was fitted last has it."""
    return min(trial.rest for trial in trials)


def polish(scan: Scan, trials: Set, free: NDArray[np.bool_]) -> Set:
    """Search the inner parameters of a set in turn."""
    if len(trials) < 2:
        return trials
    for _ in range(_TURNS):
        before = rest(trials)
        trials = turn(scan, trials, free)
        if rest(trials) > 0.99 * before:
            break
    return trials


def jointly(scan: Scan, trials: Set, free: NDArray[np.bool_]) -> Set:
    """Search the inner parameters of a set all at once, by the simplex method, then in turn.

    Two gaps at one place lie in a narrow valley aslant to both, in which turns do not move.
    """
    trials = polish(scan, trials, free)
    moving = [i for i, trial in enumerate(trials) if trial.candidate.one_inner]
    if len(moving) < 2 or rest(trials) <= _ENOUGH:
        return trials
    start = np.array([float(np.asarray(trials[i].inner)) for i in moving])

    def columns(x: Real, experiments: Indices) -> list[Column]:
        inner: list[float | Real] = [trial.inner for trial in trials]
        for i, value in zip(moving, x * start, strict=True):
            inner[i] = float(value)
        return [t.candidate.column(scan.view, value, experiments) for t, value in zip(trials, inner, strict=True)]

    def left(x: Real) -> float:
        return scan.small.fit(columns(x, scan.few), free).left if np.all(x > 0) else np.inf

    best = minimize(left, np.ones(len(moving)), method="Nelder-Mead", options={"maxfev": _TRIES * len(moving)}).x
    found = columns(best, scan.all)
    after = scan.sums.fit(found, free).held / scan.floor
    if not after < rest(trials):
        return trials
    values = dict(zip(moving, best * start, strict=True))
    moved = tuple(
        replace(trial, inner=float(values[i]) if i in values else trial.inner, column=column, rest=after)
        for i, (trial, column) in enumerate(zip(trials, found, strict=True))
    )
    return polish(scan, moved, free)


def turn(scan: Scan, trials: Set, free: NDArray[np.bool_]) -> Set:
    """Search the inner parameters of a set once each."""
    for i in range(len(trials)):
        others = [trial.column for j, trial in enumerate(trials) if j != i]
        trial = scan.trial(trials[i].candidate, free, others)
        if trial.rest < rest(trials):
            trials = (*trials[:i], trial, *trials[i + 1 :])
    return trials


def swapped(scan: Scan, trials: Set, free: NDArray[np.bool_], each: Each = map) -> Set:
    """Drop each member and search its place anew; again while that pays."""
    for _ in range(len(trials)):
        best = trials
        fewer = [(*trials[:i], *trials[i + 1 :]) for i in range(len(trials))]
        further = _further(scan, fewer, free, each)
        others = [(*have, more) for have, some in zip(fewer, further, strict=True) for more in some[:1]]
        for new in each(partial(polish, scan, free=free), others):
            if rest(new) < _GAIN * rest(best):
                best = new
        if best is trials:
            break
        trials = best
    return trials


def hypotheses(scan: Scan, sets: Sequence[Set], free: NDArray[np.bool_]) -> list[Found]:
    """Sets as hypotheses, their coefficients fitted jointly."""
    return [scan.hypothesis(trials, free) for trials in sets]


def _further(scan: Scan, sets: Sequence[Set], free: NDArray[np.bool_], each: Each) -> list[list[Trial]]:
    """For every set laws that it lacks, the best first."""
    at_places = each(partial(_places, scan, free), sets)
    wanted = [(k, place) for k, places in enumerate(at_places) for place in places]
    found: list[list[Trial]] = [[] for _ in sets]
    tried = each(partial(_laws, scan, free), [(sets[k], place) for k, place in wanted])
    for (k, _), trials in zip(wanted, tried, strict=True):
        found[k] += trials
    return [sorted(trials, key=lambda trial: trial.rest) for trials in found]


def _places(scan: Scan, free: NDArray[np.bool_], have: Set) -> list[Place]:
    """Places where a free force leaves least beside a set."""
    seen = scan.beside(have, free)
    places = [(group, at) for _, group, at in seen.places(seen.none)]
    return places[:_PLACES] if scan.view.rig.n > 1 else places


def _laws(scan: Scan, free: NDArray[np.bool_], beside: tuple[Set, Place]) -> list[Trial]:
    """Laws of one place that a set lacks."""
    have, (group, at) = beside
    trials = scan.trials(group, at, free, [trial.column for trial in have])[:_LAWS]
    names = {(trial.candidate.kind, trial.candidate.at) for trial in have}
    return [t for t in trials if np.isfinite(t.rest) and (t.candidate.kind, t.candidate.at) not in names]


def distinct(sets: Sequence[Set]) -> list[Set]:
    """Sets of different laws or places; of those alike the first."""
    kept: dict[frozenset[object], Set] = {}
    for trials in sets:
        kept.setdefault(frozenset((t.candidate.kind, t.candidate.at) for t in trials), trials)
    return list(kept.values())
