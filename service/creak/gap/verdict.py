"""What may be said: verdict, probabilities over the vocabulary, causes and their errors, alternatives."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from creak.gap.hypothesis import Hypothesis, own_elements
from creak.gap.levels import db, level
from creak.gap.ranking import FEW, Searched
from creak.gap.records import Cause, GapLevels, LinearCorrection, Verdict
from creak.gap.refine import Refined
from creak.gap.regression import Indices
from creak.gap.search import FLOOR, MOST_EFFECTS, Search
from creak.gap.setting import Setting
from creak.mechanics.effects import Effect

HALF: Final = 0.5
MOST_AT_ONE_PLACE: Final = 2
_ORDERED: Final = 6  # experiments by which effects are put in order of importance
ODDS: Final = 20.0  # in twice the log likelihood: what the data still cannot tell apart


def judge(gap: GapLevels, hypothesis: Hypothesis | None) -> Verdict:
    """Verdict by the rules of the contract, where there is a gap.

    Parameters
    ----------
    gap : GapLevels
        On realisations kept aside.
    hypothesis : Hypothesis or None
        What was found.
    """
    if hypothesis is None or gap.closed is None or not hypothesis.size:
        return Verdict.UNKNOWN
    places = [frozenset(effect.at) for effect in hypothesis.effects]
    if not as_corrections(hypothesis):
        places += [frozenset(at) for (_, at), _ in hypothesis.linear]
    crowded = any(places.count(place) > MOST_AT_ONE_PLACE for place in places)
    few = len(places) <= MOST_EFFECTS and not crowded
    if gap.closes and few:
        return Verdict.EXPLAINED
    if gap.closed >= HALF:
        return Verdict.PARTLY_EXPLAINED
    return Verdict.UNKNOWN


def as_corrections(hypothesis: Hypothesis) -> bool:
    """Whether linear changes are told as corrections of the model: where they are many, or of a whole beam."""
    linear = hypothesis.linear
    return len(linear) > FEW or any(isinstance(kind, str) for (kind, _), _ in linear)


def probabilities(search: Search, searched: Searched) -> tuple[list[float], float]:
    """Posterior of the ranked hypotheses, and of none of them.

    The effect outside the vocabulary is given the likelihood of a fit that just fails to be called noise.
    """
    if not searched.ranked:
        return [], 1.0
    per = search.setting.top * search.setting.rig.n
    count = (len(search.few) + (len(search.aside) if len(search.held) else 0)) * per
    scores = np.array([item.score for item in searched.ranked] + [2 * count * FLOOR])
    weights = np.exp(-0.5 * (scores - scores.min()))
    weights /= weights.sum()
    return [float(weight) for weight in weights[:-1]], float(weights[-1])


@dataclass(frozen=True)
class Named:
    """Causes, alternatives and linear corrections."""

    causes: tuple[Cause, ...]
    alternatives: tuple[Cause, ...]
    corrections: tuple[LinearCorrection, ...]


def as_causes(
    setting: Setting,
    final: Refined,
    searched: Searched,
    chances: list[float],
    fitted: Indices,
    shown: Indices,
    gap: GapLevels,
) -> Named:
    """Put a hypothesis into words: the waterfall of its effects, what else fits alike, and linear corrections."""
    hypothesis = final.hypothesis
    errors = np.sqrt(np.maximum(np.diag(final.covariance), 0.0))
    chance = chances[0] if chances else 0.0
    linear_errors = errors[len(errors) - len(hypothesis.linear) :] if hypothesis.linear else np.zeros(0)
    many = as_corrections(hypothesis)
    corrections = _corrections(setting, hypothesis, linear_errors) if many else ()
    causes = []
    stage = replace(hypothesis, effects=(), linear=hypothesis.linear if many else ())
    offset = 0
    items: list[tuple[Effect, Mapping[str, float]]] = []
    for effect in hypothesis.effects:
        names = effect.parameter_names()
        items.append((effect, dict(zip(names, (float(e) for e in errors[offset:]), strict=False))))
        offset += len(names)
    if not many:
        for ((kind, at), change), error in zip(hypothesis.linear, linear_errors, strict=True):
            if not isinstance(kind, str):
                items.append((kind(at, change), {"coefficient": float(error)}))
    few, order = shown[:_ORDERED], list(range(len(items)))
    named: list[int] = []
    while order:
        after = [gap.after_db]
        if len(items) > 1:
            after = [
                _gap_after(setting, replace(stage, effects=(*stage.effects, items[i][0])), few) for i in order
            ]
        named.append(order.pop(int(np.argmin(after))))
        effect, standard = items[named[-1]]
        stage = replace(stage, effects=(*stage.effects, effect))
        before = None
        if hypothesis.dropped and named[-1] == 0:
            before = dict(setting.model.effects[hypothesis.dropped[0]].parameters())
        left = _gap_after(setting, stage, shown) if order else gap.after_db
        causes.append(Cause(effect.effect, effect.at, dict(effect.parameters()), standard, chance, left, before))
    return Named(tuple(causes), _alternatives(searched, chances, gap, named), corrections)


def _gap_after(setting: Setting, hypothesis: Hypothesis, shown: Indices) -> float:
    steady = setting.simulate(hypothesis, shown)
    if not steady.settled:
        return np.inf
    return db(float(np.mean(level(setting.data, steady.y, shown).power)))


def _alternatives(searched: Searched, chances: list[float], gap: GapLevels, named: list[int]) -> tuple[Cause, ...]:
    """Hypotheses whose likelihood is nearly that of the best, where they differ in one effect."""
    if not searched.ranked:
        return ()
    best = searched.ranked[0]
    found = []
    for item, chance in zip(searched.ranked[1:], chances[1:], strict=True):
        if item.score - best.score > ODDS or len(item.hypothesis.effects) != len(best.hypothesis.effects):
            continue
        errors = np.sqrt(np.maximum(np.diag(item.refined.covariance), 0.0))
        offset = 0
        for i, (one, other) in enumerate(zip(best.hypothesis.effects, item.hypothesis.effects, strict=True)):
            names = other.parameter_names()
            if (one.effect, one.at) != (other.effect, other.at):
                found.append(
                    Cause(
                        other.effect,
                        other.at,
                        dict(other.parameters()),
                        dict(zip(names, (float(e) for e in errors[offset:]), strict=False)),
                        chance,
                        gap.after_db,
                        None,
                        named.index(i),
                    )
                )
            offset += len(names)
    return tuple(found[:3])


def _corrections(setting: Setting, hypothesis: Hypothesis, errors: np.ndarray) -> tuple[LinearCorrection, ...]:
    own = {item.key: item for item in own_elements(setting.model)}
    found = []
    for ((kind, at), change), error in zip(hypothesis.linear, errors, strict=True):
        item = own.get((kind, at))
        effect = kind if isinstance(kind, str) else kind.effect
        name = item.name if item else "-".join(part for part in at if effect != "mass" or part != "ground")
        parameter = item.parameter if item else effect
        value = item.value if item else 0.0
        found.append(LinearCorrection(name, parameter, value, value + change, float(error)))
    return tuple(found)
