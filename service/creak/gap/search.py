"""From one recording and one model to the hypothesis that explains the gap, simplest first."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from creak.errors import ConfigurationError
from creak.gap import several
from creak.gap.approach import approach
from creak.gap.growth import grown
from creak.gap.hypothesis import Hypothesis, apply, own_elements, plausible
from creak.gap.properties import properties_of
from creak.gap.ranking import FEW, Ranked, Searched, significant
from creak.gap.refine import Refined, refine
from creak.gap.regression import Indices
from creak.gap.scan import Found, Scan, Trial, combos, replacement
from creak.gap.setting import Setting
from creak.gap.view import see
from creak.mechanics.effects import GROUND, Resonator, Restoring
from creak.mechanics.electronics import Electronic

Report = Callable[[str, float], None]

CLOSED = 5e-3  # of the excess over noise that an explanation may leave
FLOOR = 1.12  # times noise that it may leave
MOST_EFFECTS = 3
_FEW = 4  # experiments on which hypotheses compete
_PLACES = 4  # best places at which laws are tried
_HOPELESS = 5e-3  # of the excess: what a regression may leave and its output-error fit still reach noise
_MATTERS = 25.0  # twice the log likelihood that a linear element must bring
_ONE_PLACE = 1.15  # what a free force leaves at most at the only place where something acts
_MANY = 4.0  # and beyond which no single place is worth a law
_SCANNED = 12  # experiments on which regressions are taken
_DEAF = 1e12  # by which the noise of a node is raised that is not to count
_STEPS_DEAF = 8
_COMPETING = 4  # best regressions that are fitted to the output


class Search:
    """Search on one recording.

    Parameters
    ----------
    setting : Setting
    fitted, held : array of int
        Experiments; none may be held.
    report : callable
    """

    def __init__(self, setting: Setting, fitted: Indices, held: Indices, report: Report) -> None:
        self.setting, self.fitted, self.held, self.report = setting, fitted, held, report
        degrees = setting.data.degrees
        self.floor = degrees / (degrees - 1)
        self.few = spread(fitted, _FEW)
        self.aside = held[: _FEW - 1] if len(held) else self.few
        self.before = self.scan(setting).rest()
        self.own: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self._stage = ("", 0.0, 0.0)
        self._placed_beside_linear: list[tuple[float, str, tuple[str, ...]]] = []

    def run(self) -> Searched:
        """Try one effect, wrong parameters of the model's own, linear elements, both, and pairs, in this order."""
        base = self.scan(self.setting)
        places = base.places(base.none)
        many_nodes = self.setting.rig.n > 1
        one_place = many_nodes and places[0][0] < _ONE_PLACE
        self._begin("one effect", 0.1, 0.3)
        singles: list[Found] = []
        trials: dict[tuple[str, ...], list[Trial]] = {}
        # A law leaves at least what a free force at its place leaves.
        if not many_nodes or places[0][0] < max(_MANY, _HOPELESS * self.before):
            singles, trials = self._singles(base, places, base.none)
        stage = self._compete([*self._replacements(), *singles])
        if self._explains(stage):
            return Searched(stage, True, places)
        beside: tuple[Ranked, ...] = ()
        if not one_place:
            self._begin("linear elements", 0.3, 0.6)
            beside = self._beside_linear()
            if self._explains(beside):
                return Searched(beside, True, self._places_after(beside[0]))
        self._begin("two effects", 0.6, 0.7)
        two = self._compete(self._pairs(base, places, trials, base.none, one_place=one_place))
        if self._explains(two):
            return Searched(two, True, places)
        more = self._several(base, one_place=one_place)
        if self._explains(more):
            return Searched(more, True, places if one_place else self._places_after(more[0]))
        two = (*two, *more)
        every = tuple(sorted([*stage, *beside, *two], key=lambda item: item.score))
        if beside and every[0] in beside:
            places = self._places_after(every[0])
        elif self._placed_beside_linear and self._placed_beside_linear[0][0] < 0.5 * places[0][0]:
            places = self._placed_beside_linear
        if every and not self.explains(every[0].refined):
            self.report("further effects", 0.83)
            larger = [Ranked(refined, self.score(refined)) for refined in grown(self, every[0])]
            every = (*reversed(larger), *every)
        return Searched(every, bool(every) and self.explains(every[0].refined), places)

    def explains(self, refined: Refined) -> bool:
        """Whether what is left is noise, by the experiments kept aside."""
        if not refined.settled:
            return False
        rest = refined.held / self.floor - 1
        count = len(self.aside) * self.setting.top * self.setting.rig.n
        chance = 3 / np.sqrt(count)
        return bool(rest <= max(FLOOR - 1, chance)) and bool(rest <= max(CLOSED * (self.before - 1), chance))

    def _begin(self, what: str, low: float, high: float) -> None:
        """Enter a stage, whose steps take the progress from `low` towards `high`; how many come is not known."""
        self._stage = (what, low, high)
        self.report(what, low)

    def _step(self) -> None:
        what, low, high = self._stage
        self._stage = (what, low + 0.1 * (high - low), high)
        self.report(what, self._stage[1])

    def _explains(self, stage: Sequence[Ranked]) -> bool:
        return bool(stage) and self.explains(stage[0].refined)

    def scan(self, setting: Setting) -> Scan:
        """Regressions on as many experiments as they need; the output-error fits take more."""
        fitted, held = spread(self.fitted, _SCANNED), spread(self.held, _SCANNED // 2)
        data = setting.data.of(np.concatenate([fitted, held]))
        view = see(setting.rig, setting.model, data, setting.top)
        every = np.arange(len(data.u))
        return Scan(view, every[: len(fitted)], every[len(fitted) :], self.floor)

    def _singles(
        self,
        scan: Scan,
        places: Sequence[tuple[float, str, tuple[str, ...]]],
        free: NDArray[np.bool_],
    ) -> tuple[list[Found], dict[tuple[str, ...], list[Trial]]]:
        trials = {}
        found = []
        for _, group, at in _worth(places):
            self._step()
            trials[at] = scan.trials(group, at, free)
            had = {(type(effect), effect.at) for effect in self.setting.model.effects}
            found += [
                scan.hypothesis([trial], free)
                for trial in trials[at]
                if np.isfinite(trial.rest) and (trial.candidate.kind, trial.candidate.at) not in had
            ]
        found = [item for item in found if plausible(self.setting.model, item.hypothesis)]
        return sorted(found, key=lambda item: item.rest), trials

    def _replacements(self) -> list[Found]:
        """Effects that the model has, with other parameters."""
        found = []
        for i, effect in enumerate(self.setting.model.effects):
            if isinstance(effect, Restoring | Electronic) and not isinstance(effect, Resonator):
                without = replace(self.setting, model=apply(self.setting.model, Hypothesis(dropped=(i,))))
                found.append(replacement(self.scan(without), effect, i))
        return found

    def _beside_linear(self) -> tuple[Ranked, ...]:
        """Linear elements alone, and one effect beside them; whitened anew with the corrected linear part."""
        scan = self.scan(self.setting)
        keys = {own.key for own in own_elements(self.setting.model) if own.value > 0}
        own = self.own = np.array([element in keys for element in scan.sums.elements])
        every: list[Ranked] = []
        for free in [own, ~scan.none] if own.any() else [~scan.none]:
            stage = (
                self._approached(scan, free) if properties_of(self.setting.model) else self._corrected(scan, free)
            )
            if free is own and not self._explains(stage):
                stage = tuple(
                    sorted([*stage, *self._sensor_beside_linear(scan, own)], key=lambda item: item.score)
                )
            if self._explains(stage):
                return stage
            every += stage
        return tuple(sorted(every, key=lambda item: item.score))

    def _corrected(self, scan: Scan, free: NDArray[np.bool_]) -> tuple[Ranked, ...]:
        """Linear elements of a lumped model alone, then beside the laws at the places that leave least."""
        stage = self._compete(self._again(scan.hypothesis([], free), free))
        if not self._explains(stage):
            places = scan.places(free)
            if not self._placed_beside_linear or places[0][0] < 0.7 * self._placed_beside_linear[0][0]:
                self._placed_beside_linear = places
            singles, _ = self._singles(scan, places, free)
            found = [again for first in singles[:1] for again in self._again(first, free)]
            stage = (*stage, *self._compete(found))
        return tuple(sorted(stage, key=lambda item: item.score))

    def _sensor_beside_linear(self, scan: Scan, own: NDArray[np.bool_]) -> tuple[Ranked, ...]:
        """Linear numbers fitted to all nodes but one, then the laws of that one's sensor.

        The regressions take the motion as it was measured; what a sensor has spoilt misleads them.
        """
        if self.setting.rig.n == 1 or not own.any():
            return ()
        fits: list[tuple[float, tuple[str, ...], Refined]] = []
        for _, group, at in scan.places(own):
            if group != "sensor" or len(fits) == _PLACES:
                continue
            i = scan.view.names.index(at[0])
            variance = self.setting.data.variance.copy()
            variance[:, i] *= _DEAF
            deaf = replace(self.setting, data=replace(self.setting.data, variance=variance))
            changes = scan.sums.fit_beside_free_force(scan.view.pattern(at, group)[..., None], own)[1]
            start = tuple((scan.key(k), float(changes[k])) for k in np.flatnonzero(own).tolist())
            refined = refine(deaf, Hypothesis(linear=start), self.few, self.aside, _STEPS_DEAF)
            fits.append((refined.left * self.setting.rig.n / (self.setting.rig.n - 1) / self.floor, at, refined))
            if fits[-1][0] < _ONE_PLACE:
                break
        fits.sort(key=lambda item: item[0])
        placed = [(rest, "sensor", at) for rest, at, _ in fits]
        if not placed or placed[0][0] > _MANY:
            return ()
        if not self._placed_beside_linear or placed[0][0] < 0.7 * self._placed_beside_linear[0][0]:
            others = [place for place in self._placed_beside_linear if place[1:] not in {p[1:] for p in placed}]
            self._placed_beside_linear = [*placed, *others]
        _, at, refined = fits[0]
        linear = refined.hypothesis.linear
        seen = self.scan(replace(self.setting, model=apply(self.setting.model, Hypothesis(linear=linear))))
        found = []
        for trial in seen.trials("sensor", at, seen.none):
            law = seen.hypothesis([trial], seen.none)
            if np.isfinite(law.rest):
                found.append(Found(replace(law.hypothesis, linear=linear), law.rest))
        return self._compete(found)

    def _approached(self, scan: Scan, free: NDArray[np.bool_]) -> tuple[Ranked, ...]:
        """Linear elements of a beam alone, then beside a free force at one place, then beside the laws there."""
        none = Hypothesis()
        left, alone = approach(self.setting, self.few, None, free, none)
        stage = self._compete([Found(alone, left / self.floor)])
        if self._explains(stage) or self.setting.rig.n == 1:
            return stage
        near = []
        alike: dict[tuple[bool, tuple[str, ...]], tuple[float, Hypothesis]] = {}
        for _, group, at in scan.places(free):
            # A free force at an actuator is one between its node and the ground.
            where = group == "sensor", (*at, GROUND)[:2]
            if where not in alike:
                self._step()
                starts = [approach(self.setting, self.few, (group, at), free, start, 3) for start in (none, alone)]
                alike[where] = min(starts, key=lambda item: item[0])
            near.append((alike[where][0] / self.floor, (group, at), where))
        near.sort(key=lambda item: item[0])
        found, placed, ended = [], [], {}
        for _, place, where in near[:_PLACES]:
            self._step()
            if where not in ended:
                ended[where] = approach(self.setting, self.few, place, free, alike[where][1])
            left, linear = ended[where]
            placed.append((left / self.floor, *place))
            if left / self.floor > max(_MANY, _HOPELESS * self.before):
                continue
            changed = replace(self.setting, model=apply(self.setting.model, linear))
            seen = self.scan(changed)
            changes = dict(linear.linear)
            for trial in seen.trials(*place, free)[:2]:
                if np.isfinite(trial.rest):
                    law = seen.hypothesis([trial], free)
                    total = tuple((key, changes.get(key, 0.0) + c) for key, c in law.hypothesis.linear)
                    found.append(Found(replace(law.hypothesis, linear=total), law.rest))
        rest = [(left, *place) for left, place, _ in near[_PLACES:]]
        placed = sorted([*placed, *rest], key=lambda item: item[0])
        if not self._placed_beside_linear or placed[0][0] < 0.7 * self._placed_beside_linear[0][0]:
            self._placed_beside_linear = placed
        return tuple(sorted([*stage, *self._compete(found)], key=lambda item: item.score))

    def _again(self, first: Found, free: NDArray[np.bool_]) -> list[Found]:
        """Rank once more, seen through the corrected linear part; then drop what does not matter."""
        linear = dict(first.hypothesis.linear)
        corrected = replace(
            self.setting, model=apply(self.setting.model, Hypothesis(linear=first.hypothesis.linear))
        )
        try:
            scan = self.scan(corrected)
        except ConfigurationError:  # corrected beyond what a structure can be
            return []
        found = []
        if first.hypothesis.effects:
            places = scan.places(free)
            _, trials = self._singles(scan, places, free)
            chosen = [[trial] for at in trials.values() for trial in at if np.isfinite(trial.rest)]
            chosen.sort(key=lambda item: item[0].rest)
            chosen = chosen[:3]
        else:
            chosen = [[]]
        whole = self.scan(self.setting)
        for trials_ in chosen:
            fit = scan.sums.fit([trial.column for trial in trials_], free)
            # What matters is judged from the model as it was, where a correction stands whole.
            again = [whole.trial(trial.candidate, free) for trial in trials_]
            kept = whole.pruned(again, free, _MATTERS)
            if kept.sum() > FEW:
                kept |= free & self.own
            total = tuple(
                (key, linear.get(key, 0.0) + float(fit.linear[i]))
                for i, key in enumerate(scan.sums.elements)
                if kept[i]
            )
            together = scan.hypothesis(trials_, free).hypothesis
            found.append(Found(replace(together, linear=total), fit.held / self.floor))
        return found

    def _pairs(
        self,
        scan: Scan,
        places: Sequence[tuple[float, str, tuple[str, ...]]],
        trials: dict[tuple[str, ...], list[Trial]],
        free: NDArray[np.bool_],
        *,
        one_place: bool,
    ) -> list[Found]:
        """Two effects: at one place, and unless there is but one at the best pairs of places."""
        found: list[Found] = []
        known = dict(trials)

        def at_place(group: str, at: tuple[str, ...]) -> list[Trial]:
            if at not in known:
                self._step()
                known[at] = scan.trials(group, at, free)
            return known[at]

        ranked = [] if one_place or self.setting.rig.n < 3 else scan.place_pairs()
        if self.setting.rig.n == 2:  # two free forces leave nothing, so every pair is as good as the better place
            ranked = [
                (first[0], first[1:], second[1:])
                for i, second in enumerate(places)
                for first in places[:i]
                if not one_place
            ]
        pairs: list[tuple[Trial, Trial]] = []
        for _, first, second in ranked[:6]:
            pairs += combos(at_place(*first), at_place(*second), 20)
        for _, group, at in places[:2]:
            own = at_place(group, at)
            pairs += combos(own, own, 20)
        # An actuator and an element between its node and the ground are two places of one pattern.
        alike = [(group, at) for rest, group, at in places if rest <= 1.02 * places[0][0] + 0.02][:3]
        for i, first in enumerate(alike):
            for second in alike[:i]:
                pairs += combos(at_place(*first), at_place(*second), 20)
        found += scan.pairs(pairs, free, 5)
        return found

    def _several(self, base: Scan, *, one_place: bool) -> tuple[Ranked, ...]:
        """Two or three effects at any places, two at one; alone, then beside the model's own linear elements."""
        best: tuple[Ranked, ...] = ()
        for free in [base.none, self.own] if self.own.any() and not one_place else [base.none]:
            sets: list[several.Set] = [()]
            for size in range(1, (2 if one_place else MOST_EFFECTS) + 1):
                low = 0.7 + 0.02 * size + 0.06 * bool(free.any())
                self._begin(f"{size} effects{' beside linear elements' if free.any() else ''}", low, low + 0.02)
                sets = several.grown(base, sets, free)
                if not sets or (size == 1 and not free.any()):
                    continue
                stage = self._compete(several.hypotheses(base, sets, free))
                if self._explains(stage):
                    return stage
                best = (*best, *stage)
        return tuple(sorted(best, key=lambda item: item.score))

    def _compete(self, found: Sequence[Found]) -> tuple[Ranked, ...]:
        """Fit the better regressions to the output and rank them by the Bayesian information criterion."""
        found = sorted((item for item in found if np.isfinite(item.rest)), key=lambda item: item.rest)
        if not found:
            return ()
        least = found[0].rest - 1
        if least > max(30.0, _HOPELESS * (self.before - 1)):
            return ()
        close = [item for item in found[:_COMPETING] if item.rest - 1 <= max(0.3, 4 * least)]
        ranked = []
        for item in close:
            self._step()
            refined = refine(self.setting, item.hypothesis, self.few, self.aside, 3)
            sharper = significant(refined, {own.key for own in own_elements(self.setting.model)})
            if refined.settled and sharper.size < refined.hypothesis.size:
                refined = refine(self.setting, sharper, self.few, self.aside, 2)
            if refined.settled:
                ranked.append(Ranked(refined, self.score(refined)))
        return tuple(sorted(ranked, key=lambda item: item.score))

    def score(self, refined: Refined) -> float:
        """Bayesian information criterion of a fit to the output."""
        per = self.setting.top * self.setting.rig.n
        counts = len(self.few) * per, len(self.aside) * per * bool(len(self.held))
        power = refined.left * counts[0] + refined.held * counts[1]
        return 2 * power / self.floor + refined.hypothesis.size * float(np.log(2 * counts[0]))

    def _places_after(self, best: Ranked) -> list[tuple[float, str, tuple[str, ...]]]:
        linear = Hypothesis(linear=best.hypothesis.linear)
        scan = self.scan(replace(self.setting, model=apply(self.setting.model, linear)))
        return scan.places(scan.none)


def spread(experiments: Indices, most: int) -> Indices:
    """Choose at most so many experiments, from all over a recording."""
    if len(experiments) <= most:
        return experiments
    return np.asarray(experiments[np.linspace(0, len(experiments) - 1, most).astype(np.int64)])


def _worth(
    places: Sequence[tuple[float, str, tuple[str, ...]]],
) -> list[tuple[float, str, tuple[str, ...]]]:
    """Places at which laws are tried: those as good as the best, and a few more."""
    best = places[0][0]
    good = [place for place in places if place[0] <= max(1.5 * best, 1.2)]
    return good if len(good) >= _PLACES else list(places[:_PLACES])
