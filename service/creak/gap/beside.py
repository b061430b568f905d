"""Linear elements that are off, alone or beside one law: the model's own first, then any that it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from creak.errors import ConfigurationError
from creak.gap.approach import STEPS, approach
from creak.gap.hypothesis import Hypothesis, apply, own_elements
from creak.gap.properties import properties_of
from creak.gap.ranking import FEW, Ranked
from creak.gap.refine import Refined, refine
from creak.gap.regression import Indices
from creak.gap.scan import Found, Place, Scan
from creak.gap.setting import Setting
from creak.mechanics.effects import GROUND

if TYPE_CHECKING:
    from creak.gap.search import Search

PLACES: Final = 4  # best places at which laws are tried
HOPELESS: Final = 5e-3  # of the excess: what a regression may leave and its output-error fit still reach noise
ONE_PLACE: Final = 1.15  # what a free force leaves at most at the only place where something acts
MANY: Final = 4.0  # and beyond which no single place is worth a law
_MATTERS: Final = 25.0  # twice the log likelihood that a linear element must bring
_DEAF: Final = 1e12  # by which the noise of a node is raised that is not to count
_STEPS_DEAF: Final = 8


class BesideLinear:
    """The stage of a search in which linear elements are free.

    Parameters
    ----------
    search : Search
        Whose recording, experiments and competition are used.

    Attributes
    ----------
    placed : list of (float, str, tuple of str)
        Places by what a free force beside the linear elements leaves, relative to noise; the best first.
    """

    def __init__(self, search: Search) -> None:
        self.search, self.setting = search, search.setting
        self.placed: list[tuple[float, str, tuple[str, ...]]] = []

    def run(self) -> tuple[Ranked, ...]:
        """Linear elements alone, and one effect beside them; whitened anew with the corrected linear part."""
        scan = self.search.scan(self.setting)
        keys = {own.key for own in own_elements(self.setting.model) if own.value > 0}
        own = self.search.own = np.array([element in keys for element in scan.sums.elements])
        every: list[Ranked] = []
        for free in [own, ~scan.none] if own.any() else [~scan.none]:
            stage = (
                self._approached(scan, free) if properties_of(self.setting.model) else self._corrected(scan, free)
            )
            if free is own and not self.search.explained(stage):
                stage = tuple(
                    sorted([*stage, *self._sensor_beside_linear(scan, own)], key=lambda item: item.score)
                )
            if self.search.explained(stage):
                return stage
            every += stage
        return tuple(sorted(every, key=lambda item: item.score))

    def _corrected(self, scan: Scan, free: NDArray[np.bool_]) -> tuple[Ranked, ...]:
        """Linear elements of a lumped model alone, then beside the laws at the places that leave least."""
        stage = self.search.compete(self._again(scan.hypothesis([], free), free))
        if not self.search.explained(stage):
            places = scan.places(free)
            if not self.placed or places[0][0] < 0.7 * self.placed[0][0]:
                self.placed = places
            singles, _ = self.search.singles(scan, places, free)
            found = [again for first in singles[:1] for again in self._again(first, free)]
            stage = (*stage, *self.search.compete(found))
        return tuple(sorted(stage, key=lambda item: item.score))

    def _sensor_beside_linear(self, scan: Scan, own: NDArray[np.bool_]) -> tuple[Ranked, ...]:
        """Linear numbers fitted to all nodes but one, then the laws of that one's sensor.

        The regressions take the motion as it was measured; what a sensor has spoilt misleads them.
        """
        if self.setting.rig.n == 1 or not own.any():
            return ()
        sensors = [at[0] for _, group, at in scan.places(own) if group == "sensor"][:PLACES]
        starts = ((name, _beside_sensor(scan, name, own)) for name in sensors)
        task = partial(_without_node, self.setting, self.search.few, self.search.aside)
        fits: list[tuple[float, tuple[str, ...], Refined]] = []
        for name, refined in zip(sensors, self.search.each(task, starts), strict=False):
            left = refined.left * self.setting.rig.n / (self.setting.rig.n - 1) / self.search.floor
            fits.append((left, (name,), refined))
            if left < ONE_PLACE:
                break
        fits.sort(key=lambda item: item[0])
        placed = [(rest, "sensor", at) for rest, at, _ in fits]
        if not placed or placed[0][0] > MANY:
            return ()
        if not self.placed or placed[0][0] < 0.7 * self.placed[0][0]:
            others = [place for place in self.placed if place[1:] not in {p[1:] for p in placed}]
            self.placed = [*placed, *others]
        _, at, refined = fits[0]
        linear = refined.hypothesis.linear
        seen = self.search.scan(replace(self.setting, model=apply(self.setting.model, Hypothesis(linear=linear))))
        found = []
        for trial in seen.trials("sensor", at, seen.none):
            law = seen.hypothesis([trial], seen.none)
            if np.isfinite(law.rest):
                found.append(Found(replace(law.hypothesis, linear=linear), law.rest))
        return self.search.compete(found)

    def _approached(self, scan: Scan, free: NDArray[np.bool_]) -> tuple[Ranked, ...]:
        """Linear elements of a beam alone, then beside a free force at one place, then beside the laws there."""
        none = Hypothesis()
        left, alone = approach(self.setting, self.search.few, None, free, none)
        stage = self.search.compete([Found(alone, left / self.search.floor)])
        if self.search.explained(stage) or self.setting.rig.n == 1:
            return stage
        every = [(group, at) for _, group, at in scan.places(free)]
        alike = self._nearer([(place, start) for place in _unlike(every) for start in (none, alone)], free, 3)
        near = sorted(((alike[_spot(place)][0] / self.search.floor, place) for place in every), key=_rest)
        best = [place for _, place in near[:PLACES]]
        ended = self._nearer([(place, alike[_spot(place)][1]) for place in _unlike(best)], free)
        found, placed = [], []
        for place in best:
            self.search.step()
            left, linear = ended[_spot(place)]
            placed.append((left / self.search.floor, *place))
            if left / self.search.floor > max(MANY, HOPELESS * self.search.before):
                continue
            changed = replace(self.setting, model=apply(self.setting.model, linear))
            seen = self.search.scan(changed)
            changes = dict(linear.linear)
            for trial in seen.trials(*place, free)[:2]:
                if np.isfinite(trial.rest):
                    law = seen.hypothesis([trial], free)
                    total = tuple((key, changes.get(key, 0.0) + c) for key, c in law.hypothesis.linear)
                    found.append(Found(replace(law.hypothesis, linear=total), law.rest))
        rest = [(left, *place) for left, place in near[PLACES:]]
        placed = sorted([*placed, *rest], key=lambda item: item[0])
        if not self.placed or placed[0][0] < 0.7 * self.placed[0][0]:
            self.placed = placed
        return tuple(sorted([*stage, *self.search.compete(found)], key=lambda item: item.score))

    def _nearer(
        self, tried: list[tuple[Place, Hypothesis]], free: NDArray[np.bool_], steps: int = STEPS
    ) -> dict[Place, tuple[float, Hypothesis]]:
        """The best of some starts of `approach` beside a free force, by the place as `_spot` has it."""
        near: dict[Place, tuple[float, Hypothesis]] = {}
        task = partial(_approached, self.setting, self.search.few, free, steps)
        for (place, _), ended in zip(tried, self.search.each(task, tried), strict=True):
            self.search.step()
            near[_spot(place)] = min(near.get(_spot(place), ended), ended, key=_rest)
        return near

    def _again(self, first: Found, free: NDArray[np.bool_]) -> list[Found]:
        """Rank once more, seen through the corrected linear part; then drop what does not matter."""
        linear = dict(first.hypothesis.linear)
        corrected = replace(
            self.setting, model=apply(self.setting.model, Hypothesis(linear=first.hypothesis.linear))
        )
        try:
            scan = self.search.scan(corrected)
        except ConfigurationError:  # corrected beyond what a structure can be
            return []
        found = []
        if first.hypothesis.effects:
            places = scan.places(free)
            _, trials = self.search.singles(scan, places, free)
            chosen = [[trial] for tried in trials.values() for trial in tried if np.isfinite(trial.rest)]
            chosen.sort(key=lambda item: item[0].rest)
            chosen = chosen[:3]
        else:
            chosen = [[]]
        whole = self.search.scan(self.setting)
        for trials_ in chosen:
            fit = scan.sums.fit([trial.column for trial in trials_], free)
            # What matters is judged from the model as it was, where a correction stands whole.
            again = [whole.trial(trial.candidate, free) for trial in trials_]
            kept = whole.pruned(again, free, _MATTERS)
            if kept.sum() > FEW:
                kept |= free & self.search.own
            total = tuple(
                (key, linear.get(key, 0.0) + float(fit.linear[i]))
                for i, key in enumerate(scan.sums.elements)
                if kept[i]
            )
            together = scan.hypothesis(trials_, free).hypothesis
            found.append(Found(replace(together, linear=total), fit.held / self.search.floor))
        return found


def _approached(
    setting: Setting,
    few: Indices,
    free: NDArray[np.bool_],
    steps: int,
    tried: tuple[Place, Hypothesis],
) -> tuple[float, Hypothesis]:
    """Linear elements moved beside a free force at one place, from one start."""
    place, start = tried
    return approach(setting, few, place, free, start, steps)


def _spot(place: Place) -> Place:
    """Name places alike that a free force cannot tell apart: an actuator, and its node with the ground."""
    group, at = place
    return ("sensor" if group == "sensor" else "internal"), (*at, GROUND)[:2]


def _unlike(places: Sequence[Place]) -> list[Place]:
    """The first of the places that are alike."""
    first: dict[Place, Place] = {}
    for place in places:
        first.setdefault(_spot(place), place)
    return list(first.values())


def _rest(item: tuple[float, object]) -> float:
    return item[0]


def _beside_sensor(scan: Scan, name: str, free: NDArray[np.bool_]) -> Hypothesis:
    """Linear changes fitted to all nodes but one, by regression."""
    pattern = scan.view.pattern((name,), "sensor")[..., None]
    changes = scan.sums.fit_beside_free_force(pattern, free)[1]
    return Hypothesis(linear=tuple((scan.key(k), float(changes[k])) for k in np.flatnonzero(free).tolist()))


def _without_node(setting: Setting, few: Indices, aside: Indices, start: tuple[str, Hypothesis]) -> Refined:
    """Linear changes fitted to the output of all nodes but one."""
    name, hypothesis = start
    variance = setting.data.variance.copy()
    variance[:, [node.name for node in setting.rig.nodes].index(name)] *= _DEAF
    deaf = replace(setting, data=replace(setting.data, variance=variance))
    return refine(deaf, hypothesis, few, aside, _STEPS_DEAF)
