"""Ranking by regression: places by a free force, then the laws that compete there.

They compete alone, beside linear elements, or in place of an effect that the model has.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from creak.gap.candidates import EVEN, Candidate, candidates_at, group_of, optimise, places, resting
from creak.gap.hypothesis import Hypothesis
from creak.gap.regression import LINEAR, Column, Indices, LinearKey, Sums
from creak.gap.view import View
from creak.mechanics.effects import GROUND, Effect, Resonator
from creak.mechanics.electronics import SensorQuantisation
from creak.records import Real

_FAILED = 2.0  # whitened power beyond which a law has not explained a place, and a hidden mode is tried there
_MEANS = 8  # turns in which an even law and the mean that it makes are found
_SMALL = 6  # experiments on which inner parameters are searched


Place = tuple[str, tuple[str, ...]]
"""Group (``internal``, ``actuator`` or ``sensor``) and names."""


@dataclass(frozen=True, eq=False)
class Found:
    """A hypothesis as the regression has it, with what it leaves relative to noise on experiments kept aside."""

    hypothesis: Hypothesis
    rest: float


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate with its inner parameter and the column that it makes."""

    candidate: Candidate
    inner: float | Real
    column: Column
    rest: float


class Scan:
    """One view of one recording, ready to be searched.

    Parameters
    ----------
    view : View
    fitted, held : array of int
    floor : float
        Whitened power of noise alone, ``nu/(nu - 1)``.
    """

    def __init__(self, view: View, fitted: Indices, held: Indices, floor: float) -> None:
        self.view, self.floor, self.sets = view, floor, (fitted, held)
        self.sums = Sums(view, fitted, held)
        few = fitted[:_SMALL]
        self.few = few
        self.small = Sums(view, few, few[:0])
        self._single = Sums(view, few[:1], few[:0])
        self.all = np.arange(len(view.r))

    def __reduce__(self) -> tuple[Any, ...]:
        """Made anew of its view elsewhere: the sums are several times as large and soon had."""
        return Scan, (self.view, *self.sets, self.floor)

    @property
    def none(self) -> NDArray[np.bool_]:
        """No linear element."""
        return np.zeros(len(self.sums.elements), dtype=bool)

    def rest(self) -> float:
        """Whitened power that the model leaves, relative to noise."""
        return self.sums.fit().held / self.floor

    def places(
        self, free: NDArray[np.bool_], beside: Sequence[tuple[str, tuple[str, ...]]] = ()
    ) -> list[tuple[float, str, tuple[str, ...]]]:
        """Places by what a free force there (and at those beside) leaves relative to noise, the best first."""
        n = self.view.rig.n
        if n <= 1 + len(beside):
            return [(1.0, group, at) for group, at in places(self.view)]
        fixed = [self.view.pattern(at, group) for group, at in beside]
        every = places(self.view)
        if not beside and not free.any():
            patterns = np.stack([self.view.pattern(at, group) for group, at in every], axis=-1)
            left = np.diag(self.sums.beside_free_forces(patterns)).tolist()
        else:
            known: dict[Place, float] = {}
            for group, at in every:
                # A free force at most actuators is one between their node and the ground.
                twin = (
                    ("internal", (*at, GROUND)) if group == "actuator" and self._drives_its_node(at[0]) else None
                )
                patterns = np.stack([*fixed, self.view.pattern(at, group)], axis=-1)
                known[group, at] = known[twin] if twin else self.sums.beside_free_force(patterns, free)
            left = list(known.values())
        return sorted(((rest / self.floor, *place) for rest, place in zip(left, every, strict=True)), key=_rest)

    def _drives_its_node(self, name: str) -> bool:
        """Whether an actuator acts on the coordinates as a force at its node does."""
        system = self.view.system
        load = system.inputs[:, self.view.rig.driven.index(self.view.names.index(name))]
        row = system.points[name]
        return bool(np.allclose(load * np.linalg.norm(row), row * np.linalg.norm(load)))

    def place_pairs(self) -> list[tuple[float, Place, Place]]:
        """Pairs of places by what free forces at both leave relative to noise, the best first; 3 nodes or more."""
        every = places(self.view)
        patterns = np.stack([self.view.pattern(at, group) for group, at in every], axis=-1)
        left = self.sums.beside_free_forces(patterns) / self.floor
        found = [(float(left[i, j]), every[i], every[j]) for i in range(len(every)) for j in range(i)]
        return sorted(found, key=_rest)

    def beside(self, trials: Sequence[Trial], free: NDArray[np.bool_]) -> "Scan":
        """The same on what trials and linear elements leave, for places."""
        fit = self.sums.fit([trial.column for trial in trials], free)
        r = self.view.r - np.einsum(
            "lnk,elk->eln", self.sums.q, self.sums.phi * fit.linear[: self.sums.q.shape[-1]]
        )
        r -= self.sums.whole @ fit.linear[self.sums.q.shape[-1] :]
        for trial, coefficient in zip(trials, fit.own, strict=True):
            r = r - coefficient * trial.column.q * trial.column.phi[..., None]
        return Scan(replace(self.view, r=r), self.few, self.few[:0], self.floor)

    def trials(
        self,
        group: str,
        at: tuple[str, ...],
        free: NDArray[np.bool_],
        beside: Sequence[Column] = (),
        kinds: frozenset[type[Effect]] | None = None,
    ) -> list[Trial]:
        """Every effect at one place, inner parameters optimised, the best first."""
        found = []
        for candidate in candidates_at(group, at):
            if kinds is not None and candidate.kind not in kinds:
                continue
            if candidate.kind in LINEAR and free.any():
                continue
            found.append(self.trial(candidate, free, beside))
        if (
            group == "internal"
            and at[1] == GROUND
            and kinds is None
            and min(item.rest for item in found) > _FAILED
        ):
            found.append(self.trial(Candidate(Resonator, at[:1], group), free, beside))
        return sorted(found, key=lambda item: item.rest)

    def trial(self, candidate: Candidate, free: NDArray[np.bool_], beside: Sequence[Column] = ()) -> Trial:
        """One candidate with its inner parameter optimised."""
        if candidate.kind in EVEN and not self.view.shows_mean(candidate.at):
            return self._trial_about_mean(candidate, free, beside)
        return self._trial(candidate, free, beside)

    def _trial(self, candidate: Candidate, free: NDArray[np.bool_], beside: Sequence[Column]) -> Trial:
        if (
            candidate.kind is SensorQuantisation
        ):  # its score is rough: one experiment finds the step, then the rest
            along, few = self._single.along(candidate.pattern(self.view), free, beside), self.few[:1]
        else:
            along, few = self.small.along(candidate.pattern(self.view), free, beside), self.few
        inner = optimise(candidate, self.view, few, lambda phi, fixed: along.left(phi, fixed=fixed))
        column = candidate.column(self.view, inner, self.all)
        fit = self.sums.fit([*beside, column], free)
        possible = candidate.effect(float(fit.own[-1]), inner) is not None
        return Trial(candidate, inner, column, fit.held / self.floor if possible else np.inf)

    def _trial_about_mean(self, candidate: Candidate, free: NDArray[np.bool_], beside: Sequence[Column]) -> Trial:
        """An even law under velocities or accelerations, which do not show the mean that it makes.

        The mean follows from the law and the structure's static compliance, so that both are found in turn.
        """
        best = self._trial(candidate, free, beside)
        for _ in range(_MEANS):
            coefficient = float(self.sums.fit([*beside, best.column], free).own[-1])
            law = best.candidate.unit(float(np.asarray(best.inner)))
            offset = resting(self.view, candidate.at, law, coefficient * self.view.static(candidate.at))
            trial = self._trial(replace(candidate, offset=offset), free, beside)
            if not trial.rest < best.rest:
                break
            gain, best = best.rest - trial.rest, trial
            if gain < 1e-3 * best.rest:
                break
        return best

    def hypothesis(self, trials: Sequence[Trial], free: NDArray[np.bool_], dropped: tuple[int, ...] = ()) -> Found:
        """Trials together, their coefficients fitted jointly, beside linear elements."""
        fit = self.sums.fit([trial.column for trial in trials], free)
        effects = [
            trial.candidate.effect(float(coefficient), trial.inner)
            for trial, coefficient in zip(trials, fit.own, strict=True)
        ]
        linear = tuple((self.key(i), float(fit.linear[i])) for i in np.flatnonzero(free).tolist())
        if any(effect is None for effect in effects):
            return Found(Hypothesis((), linear, dropped), np.inf)
        kept = tuple(effect for effect in effects if effect is not None)
        return Found(Hypothesis(kept, linear, dropped), fit.held / self.floor)

    def key(self, i: int) -> LinearKey:
        """Linear element by its index."""
        return self.sums.elements[i]

    def pruned(self, trials: Sequence[Trial], free: NDArray[np.bool_], least: float) -> NDArray[np.bool_]:
        """Linear elements that matter: the one that costs least is dropped until every one costs ``least``.

        The cost is in twice the log likelihood, with the rest taken as the noise that it is measured against.
        """
        columns = [trial.column for trial in trials]
        gram, right, power = self.sums._system(0, columns, free)
        fixed = np.array([False] * int(free.sum()) + [c.fixed for c in columns], dtype=bool)
        right = right - gram[:, fixed].sum(axis=1)
        keep = list(np.flatnonzero(~fixed))
        chosen = list(np.flatnonzero(free))
        m = len(chosen)
        while True:
            linear = [k for k in keep if k < m]
            if not linear:
                break
            sub = gram[np.ix_(keep, keep)]
            scale = np.sqrt(np.maximum(np.diag(sub), 1e-300))
            inverse = np.linalg.pinv(sub / np.outer(scale, scale), rcond=1e-10, hermitian=True)
            theta = inverse @ (right[keep] / scale)
            left = (power - theta @ (right[keep] / scale)) / self.sums.counts[0]
            with np.errstate(over="ignore"):  # what explains everything costs infinitely much to drop
                cost = 2 * theta**2 / np.maximum(np.diag(inverse), 1e-300) / max(left, 1e-300)
            costs = [cost[keep.index(k)] for k in linear]
            worst = int(np.argmin(costs))
            if costs[worst] >= least:
                break
            keep.remove(linear[worst])
        mask = self.none
        mask[[chosen[k] for k in keep if k < m]] = True
        return mask


def _rest(item: tuple[Any, ...]) -> float:
    return float(item[0])


def trials_at(scan: Scan, free: NDArray[np.bool_], place: Place) -> list[Trial]:
    """Every effect at one place, as `Scan.trials` has them: a task."""
    return scan.trials(*place, free)


def replacement(scan: Scan, effect: Effect, index: int) -> Found:
    """An effect of the model, taken out of the scanned view, with its best parameters."""
    candidate = Candidate(type(effect), effect.at, group_of(effect.at, type(effect)))
    trial = scan.trial(candidate, scan.none)
    return scan.hypothesis([trial], scan.none, (index,))


def strongest_lines(power: Real, share: float) -> tuple[int, int]:
    """First and last line of the band that holds a share of a power, the rest split evenly beside it."""
    total = np.cumsum(power)
    if total[-1] <= 0:
        return 0, len(power) - 1
    rest = (1 - share) / 2
    first = int(np.searchsorted(total, rest * total[-1]))
    return first, int(min(np.searchsorted(total, (1 - rest) * total[-1]), len(power) - 1))
