"""Which of the laws that were found may be claimed where they do not explain all that is missing.

What is left acts somewhere, and a free force tells where, without a law. A law that was found at such a place is
not the whole of what acts there and may stand in for it: a gain for a dead zone, a damper for friction. So none is
claimed there; the place stands. A law elsewhere leaves noise beside that free force and is claimed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from creak.errors import ConfigurationError
from creak.gap.candidates import group_of, places
from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.periodic import PeriodicData
from creak.gap.refine import Refined
from creak.gap.scan import Place, Scan
from creak.gap.search import Search
from creak.gap.setting import Setting
from creak.gap.together import NOISE
from creak.gap.verdict import as_corrections
from creak.gap.view import lines_of
from creak.mechanics.effects import GROUND
from creak.records import Complex

_TAKEN: Final = 0.5  # of what is left above noise, that a free force must take to be what acts
_ALIKE: Final = 1.3  # times what noise in the measured motion makes the laws leave
_PARALLEL: Final = 1 - 1e-6  # cosine of patterns that are one


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands of a fit, and why the rest does not.

    Parameters
    ----------
    refined : Refined
    unsettled : tuple of Place
        Places at which laws were found that are not claimed.
    """

    refined: Refined
    unsettled: tuple[Place, ...]


def standing(search: Search, final: Refined) -> Standing:
    """Laws at places where nothing of what is left acts.

    Places are freed one after another, each the one that takes most of what is left, as long as it takes half (or
    two that take three quarters, to begin with) and noise is not reached; one fewer than there are nodes, since as
    many free forces leave nothing. The laws are taken at the measured motion, whose noise they bend: how much they
    leave by that alone is seen in a recording that the fit itself makes.

    Parameters
    ----------
    search : Search
    final : Refined
        A fit that leaves more than noise.

    Returns
    -------
    Standing
        The fit itself if the rig has one node.
    """
    setting, n = search.setting, search.setting.rig.n
    if n == 1:
        return Standing(final, ())
    kept, freed = final.hypothesis, list[Place]()
    again = replace(setting, data=_repeated(setting, final.hypothesis))
    while len(freed) < n - 1:
        try:
            model = apply(setting.model, kept)
            scan, null = search.scan(replace(setting, model=model)), search.scan(replace(again, model=model))
        except ConfigurationError:
            break
        left = _left(scan, freed)
        if left - 1 <= _ALIKE * (_left(null, freed) - 1) + NOISE - 1:
            break
        singles = [(rest, ((group, at),)) for rest, group, at in scan.places(scan.none, freed)]
        pairs = [] if freed or n < 3 else [(rest, (one, other)) for rest, one, other in scan.place_pairs()]
        if singles[0][0] - 1 <= _TAKEN * (left - 1):
            best = _blamed(singles, kept)
        elif pairs and pairs[0][0] - 1 <= _TAKEN**2 * (left - 1):
            best = _blamed(pairs, kept)
        else:
            break
        for place in best:
            freed.append(place)
            kept = _without(kept, _of_pattern(scan, place))
    gone = tuple(place for place in places_of(final.hypothesis) if place not in places_of(kept))
    return Standing(_part(final, kept), gone)


def _blamed(ranked: Sequence[tuple[float, tuple[Place, ...]]], kept: Hypothesis) -> tuple[Place, ...]:
    """Of the places that take as much as the best, those at which most laws were found."""
    named = {(group, frozenset(at)) for group, at in places_of(kept)}
    alike = [some for rest, some in ranked if rest <= 1.02 * ranked[0][0] + 0.02]
    return max(alike, key=lambda some: sum((group, frozenset(at)) in named for group, at in some))


def _repeated(setting: Setting, hypothesis: Hypothesis) -> PeriodicData:
    """The recording as it would be if a hypothesis were all: what noise does to its laws is seen in it."""
    every = np.arange(len(setting.data.u))
    Y = lines_of(setting.simulate(hypothesis, every).y)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(Y.shape) + 1j * rng.standard_normal(Y.shape)
    return replace(setting.data, Y=Y + noise * np.sqrt(setting.data.variance / 2))


def _of_pattern(scan: Scan, place: Place) -> set[Place]:
    """Places whose force moves the nodes as that at a place does."""

    def unit(group: str, at: tuple[str, ...]) -> Complex:
        q = scan.view.pattern(at, group)
        return np.asarray(q / np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-300))

    own = unit(*place)
    alike = (np.abs(np.sum(own.conj() * unit(*other), axis=1)) for other in places(scan.view))
    return {other for other, share in zip(places(scan.view), alike, strict=True) if np.median(share) > _PARALLEL}


def unsettled(places: Sequence[Place]) -> list[str]:
    """What is said about places whose laws are not claimed, a sentence each."""
    found = []
    for group, at in places:
        where = f"at the {group} of {at[0]}" if group != "internal" else f"between {at[0]} and {at[1]}"
        found.append(
            f"which effect acts {where} is not claimed: what is left acts there, so that the laws which fit best "
            "stand in for another, or for more than they are"
        )
    return found


def places_of(hypothesis: Hypothesis) -> list[Place]:
    """Places of the effects, and of linear changes that are causes like any other; each once."""
    found = [_place(effect.at, group_of(effect.at, type(effect))) for effect in hypothesis.effects]
    if not as_corrections(hypothesis):
        found += [_place(at, "internal") for (_, at), _ in hypothesis.linear]
    return list(dict.fromkeys(found))


def _place(at: tuple[str, ...], group: str) -> Place:
    """Place as a scan names it."""
    return group, (*at, GROUND) if group == "internal" and len(at) == 1 else at


def _left(scan: Scan, freed: Sequence[Place]) -> float:
    """What free forces leave relative to noise."""
    if not freed:
        return scan.sums.fit().left / scan.floor
    patterns = np.stack([scan.view.pattern(at, group) for group, at in freed], axis=-1)
    return scan.sums.beside_free_force(patterns, scan.none) / scan.floor


def _without(hypothesis: Hypothesis, places: set[Place]) -> Hypothesis:
    """Hypothesis without the laws at places."""
    there = {(group, frozenset(at)) for group, at in places}

    def stays(at: tuple[str, ...], group: str) -> bool:
        group, at = _place(at, group)
        return (group, frozenset(at)) not in there

    effects = tuple(effect for effect in hypothesis.effects if stays(effect.at, group_of(effect.at, type(effect))))
    linear = hypothesis.linear
    if not as_corrections(hypothesis):
        linear = tuple(item for item in linear if stays(item[0][1], "internal"))
    # What took the place of an effect of the model is the first; where it is not claimed, the model's own stays.
    dropped = hypothesis.dropped if effects[:1] == hypothesis.effects[:1] else ()
    return replace(hypothesis, effects=effects, linear=linear, dropped=dropped)


def _part(refined: Refined, kept: Hypothesis) -> Refined:
    """The same fit, its numbers and errors of some of its parts alone."""
    chosen: list[int] = []
    i = 0
    for effect in refined.hypothesis.effects:
        size = len(effect.parameter_names())
        if effect in kept.effects:
            chosen += range(i, i + size)
        i += size
    for item in refined.hypothesis.linear:
        if item in kept.linear:
            chosen.append(i)
        i += 1
    covariance = refined.covariance[np.ix_(chosen, chosen)]
    return replace(refined, hypothesis=kept, covariance=covariance, guess=None, jacobian=None)
