"""From one recording and one model to the hypothesis that explains the gap, simplest first."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from creak.gap import several
from creak.gap.beside import HOPELESS, MANY, ONE_PLACE, PLACES, BesideLinear
from creak.gap.combinations import Combinations, best_sets
from creak.gap.growth import grown
from creak.gap.hypothesis import Hypothesis, apply, own_elements, plausible
from creak.gap.ranking import Ranked, Searched, significant
from creak.gap.refine import Refined, refine, rounded
from creak.gap.regression import Indices
from creak.gap.scan import Found, Place, Scan, Trial, replacement, trials_at
from creak.gap.setting import Setting
from creak.gap.together import Together
from creak.gap.view import see
from creak.mechanics.effects import Resonator, Restoring
from creak.mechanics.electronics import Electronic
from creak.mechanics.steady import Each

Report = Callable[[str, float], None]

CLOSED = 5e-3  # of the excess over noise that an explanation may leave
FLOOR = 1.12  # times noise that it may leave
MOST_EFFECTS = 3
IDLE = 15.0  # twice the log likelihood, less what its parameters cost, that an effect must bring beside others
_FEW = 4  # experiments on which hypotheses compete
_SCANNED = 12  # experiments on which regressions are taken
_PAIRED = 8  # places among which two laws are looked for
_LAWS = 5  # pairs of them that are optimised to the end
_COMPETING = 4  # best regressions that are fitted to the output
_BENT = 0.05  # of the excess: what the right law may leave at a measured motion whose noise it bends


class Search:
    """Search on one recording.

    Parameters
    ----------
    setting : Setting
    fitted, held : array of int
        Experiments; none may be held.
    report : callable
    each : callable
        What candidates are tried by, laws at places as well as fits to the output: `map`, one after the other,
        or one that has them done elsewhere, which changes no bit.
    """

    def __init__(self, setting: Setting, fitted: Indices, held: Indices, report: Report, each: Each = map) -> None:
        self.each = each
        self.setting, self.fitted, self.held, self.report = setting, fitted, held, report
        degrees = setting.data.degrees
        self.floor = degrees / (degrees - 1)
        self.few = spread(fitted, _FEW)
        self.aside = held[: _FEW - 1] if len(held) else self.few
        self.before = self.scan(setting).rest()
        self.own: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self._stage = ("", 0.0, 0.0)

    def run(self) -> Searched:
        """Search, and leave out of what was found each effect without which the rest explains as much.

        Noise that is known from lines which are not excited holds what distortion lies there, so that less than
        the whole seems to be enough; every effect that pays for itself is taken then.
        """
        searched = self._stages()
        if not searched.explained:
            return searched
        ranked = (*self._without_idle(searched.ranked[0]), *searched.ranked)
        if self.setting.data.periods == 1:
            ranked = (*self._larger(ranked[0]), *ranked)
        return replace(searched, ranked=ranked)

    def _larger(self, best: Ranked) -> tuple[Ranked, ...]:
        """Hypotheses with further effects, each better than the one before, the largest first."""
        self.report("further effects", 0.83)
        return tuple(Ranked(refined, self.score(refined)) for refined in reversed(grown(self, best)))

    def _without_idle(self, best: Ranked) -> tuple[Ranked, ...]:
        """Hypothesis without its idle effects; nothing if every one matters."""
        found: tuple[Ranked, ...] = ()
        while len(effects := best.hypothesis.effects) > 1:
            fewer = [replace(best.hypothesis, effects=effects[:i] + effects[i + 1 :]) for i in range(len(effects))]
            fits = self.each(partial(refine, self.setting, fitted=self.few, held=self.aside, steps=3), fewer)
            ranked = sorted(
                (Ranked(item, self.score(item)) for item in fits if self.explains(item)),
                key=lambda item: item.score,
            )
            if not ranked or ranked[0].score > best.score + IDLE:
                break
            best = ranked[0]
            found = (best, *found)
        return found

    def _stages(self) -> Searched:
        """Try one effect, wrong parameters of the model's own, linear elements, both, and pairs, in this order."""
        base = self.scan(self.setting)
        places = base.places(base.none)
        many_nodes = self.setting.rig.n > 1
        one_place = many_nodes and places[0][0] < ONE_PLACE
        self._begin("one effect", 0.1, 0.25)
        singles: list[Found] = []
        trials: dict[Place, list[Trial]] = {}
        # A law leaves at least what a free force at its place leaves.
        if not many_nodes or places[0][0] < max(MANY, HOPELESS * self.before):
            singles, trials = self.singles(base, places, base.none)
        stage = self.compete([*self._replacements(), *singles])
        if self.explained(stage):
            return Searched(stage, True, places)
        together: tuple[Ranked, ...] = ()
        if not one_place:
            self._begin("effects at places of their own", 0.25, 0.3)
            together = self.compete(Together(base, self.each).run())
            if self.explained(together):
                return Searched(together, True, places)
        beside: tuple[Ranked, ...] = ()
        placed: list[tuple[float, str, tuple[str, ...]]] = []
        if not one_place:
            self._begin("linear elements", 0.3, 0.6)
            linear = BesideLinear(self)
            beside = linear.run()
            placed = linear.placed
            if self.explained(beside):
                return Searched(beside, True, self._places_after(beside[0]))
        self._begin("two effects", 0.6, 0.7)
        two = self.compete(self._pairs(base, places, trials, base.none, one_place=one_place))
        if self.explained(two):
            return Searched(two, True, places)
        more = self._several(base, one_place=one_place)
        if self.explained(more):
            return Searched(more, True, places if one_place else self._places_after(more[0]))
        two = (*together, *two, *more)
        every = tuple(sorted([*stage, *beside, *two], key=lambda item: item.score))
        if beside and every[0] in beside:
            places = self._places_after(every[0])
        elif placed and placed[0][0] < 0.5 * places[0][0]:
            places = placed
        if every and not self.explains(every[0].refined):
            every = (*self._larger(every[0]), *every)
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

    def step(self) -> None:
        """Tell that one of the stage's steps is done."""
        what, low, high = self._stage
        self._stage = (what, low + 0.1 * (high - low), high)
        self.report(what, self._stage[1])

    def explained(self, stage: Sequence[Ranked]) -> bool:
        """Whether the best hypothesis of a stage leaves noise."""
        return bool(stage) and self.explains(stage[0].refined)

    def scan(self, setting: Setting) -> Scan:
        """Regressions on as many experiments as they need; the output-error fits take more."""
        fitted, held = spread(self.fitted, _SCANNED), spread(self.held, _SCANNED // 2)
        data = setting.data.of(np.concatenate([fitted, held]))
        view = see(setting.rig, setting.model, data, setting.top)
        every = np.arange(len(data.u))
        return Scan(view, every[: len(fitted)], every[len(fitted) :], self.floor)

    def singles(
        self,
        scan: Scan,
        places: Sequence[tuple[float, str, tuple[str, ...]]],
        free: NDArray[np.bool_],
    ) -> tuple[list[Found], dict[Place, list[Trial]]]:
        """Every law at the places that are worth it, the best first, and the trials behind them by place."""
        trials = {}
        found = []
        worth = [(group, at) for _, group, at in _worth(places)]
        for place, tried in zip(worth, self.each(partial(trials_at, scan, free), worth), strict=True):
            self.step()
            trials[place] = tried
            had = {(type(effect), effect.at) for effect in self.setting.model.effects}
            found += [
                scan.hypothesis([trial], free)
                for trial in tried
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

    def _pairs(
        self,
        scan: Scan,
        places: Sequence[tuple[float, str, tuple[str, ...]]],
        trials: dict[Place, list[Trial]],
        free: NDArray[np.bool_],
        *,
        one_place: bool,
    ) -> list[Found]:
        """Two effects: at one place, and unless there is but one at the best pairs of places."""
        known = dict(trials)

        ranked = [] if one_place or self.setting.rig.n < 3 else scan.place_pairs()
        if self.setting.rig.n == 2:  # two free forces leave nothing, so every pair is as good as the better place
            ranked = [
                (first[0], first[1:], second[1:])
                for i, second in enumerate(places)
                for first in places[:i]
                if not one_place
            ]
        both = list(dict.fromkeys(place for pair in ranked for place in pair[1:]))[:_PAIRED]
        spots: list[Sequence[Place]] = [some for some in (both, _alike(places), [places[1][1:]]) if some]
        unknown = list(dict.fromkeys(place for some in spots for place in some if place not in known))
        for place, tried in zip(unknown, self.each(partial(trials_at, scan, free), unknown), strict=True):
            self.step()
            known[place] = tried
        tasks = [(some, [trial for place in some for trial in known[place]]) for some in spots]
        found = self.each(partial(best_sets, scan, free, 2, _LAWS), tasks)
        sets = [one for some in found for one in some]
        return [scan.hypothesis(item, free) for item in several.distinct(sets)]

    def _several(self, base: Scan, *, one_place: bool) -> tuple[Ranked, ...]:
        """Two or three effects at any places, two at one; alone, then beside the model's own linear elements."""
        best: tuple[Ranked, ...] = ()
        if one_place:
            return self._three_at_one_place(base)
        for free in [base.none, self.own] if self.own.any() else [base.none]:
            sets: list[several.Set] = [()]
            for size in range(1, MOST_EFFECTS + 1):
                low = 0.7 + 0.02 * size + 0.06 * bool(free.any())
                self._begin(f"{size} effects{' beside linear elements' if free.any() else ''}", low, low + 0.02)
                sets = several.grown(base, sets, free, self.each)
                if not sets or (size == 1 and not free.any()):
                    continue
                stage = self.compete(several.hypotheses(base, sets, free))
                if self.explained(stage):
                    return stage
                best = (*best, *stage)
        return tuple(sorted(best, key=lambda item: item.score))

    def _three_at_one_place(self, scan: Scan) -> tuple[Ranked, ...]:
        """Three laws where all that is missing acts at one place."""
        self._begin("three effects", 0.7, 0.8)
        alike = _alike(scan.places(scan.none))
        tried = self.each(partial(trials_at, scan, scan.none), alike)
        every = Combinations(scan, alike, scan.none, [trial for some in tried for trial in some])
        return self.compete(several.hypotheses(scan, every.best(3, 4, self.each), scan.none))

    def compete(self, found: Sequence[Found]) -> tuple[Ranked, ...]:
        """Fit the better regressions to the output and rank them by the Bayesian information criterion."""
        found = sorted((item for item in found if np.isfinite(item.rest)), key=lambda item: item.rest)
        if not found:
            return ()
        least = found[0].rest - 1
        if least > max(30.0, _BENT * (self.before - 1)):
            return ()
        close = [item for item in found[:_COMPETING] if item.rest - 1 <= max(0.3, 4 * least)]
        ranked = []
        for refined in self.each(
            partial(_fitted, self.setting, self.few, self.aside), [item.hypothesis for item in close]
        ):
            self.step()
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


def _fitted(setting: Setting, few: Indices, aside: Indices, hypothesis: Hypothesis) -> Refined:
    """A hypothesis fitted to the output, without the linear changes that are none."""
    refined = rounded(setting, refine(setting, hypothesis, few, aside, 3), few, aside)
    sharper = significant(refined, {own.key for own in own_elements(setting.model)})
    if refined.settled and sharper.size < refined.hypothesis.size:
        refined = refine(setting, sharper, few, aside, 2)
    return refined


def spread(experiments: Indices, most: int) -> Indices:
    """Choose at most so many experiments, from all over a recording."""
    if len(experiments) <= most:
        return experiments
    return np.asarray(experiments[np.linspace(0, len(experiments) - 1, most).astype(np.int64)])


def _alike(places: Sequence[tuple[float, str, tuple[str, ...]]]) -> list[Place]:
    """Places as good as the best: an actuator and an element from its node to the ground are of one pattern."""
    return [place[1:] for place in places if place[0] <= 1.02 * places[0][0] + 0.02][:3]


def _worth(
    places: Sequence[tuple[float, str, tuple[str, ...]]],
) -> list[tuple[float, str, tuple[str, ...]]]:
    """Places at which laws are tried: those as good as the best, and a few more."""
    best = places[0][0]
    good = [place for place in places if place[0] <= max(1.5 * best, 1.2)]
    return good if len(good) >= PLACES else list(places[:PLACES])
