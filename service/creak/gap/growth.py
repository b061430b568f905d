"""Further effects, looked for in what the best hypothesis leaves."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from creak.errors import ConfigurationError
from creak.gap.hypothesis import Hypothesis, apply, plausible
from creak.gap.refine import Refined, refine

if TYPE_CHECKING:
    from creak.gap.ranking import Ranked
    from creak.gap.search import Search

MOST: Final = 3
"""Effects that a hypothesis may have."""

_PLACES = 3  # at which a further effect is looked for
_TRIED = 3  # laws that are fitted to the output
_MATTERS = (
    40.0  # by which the score of a larger hypothesis must be better: twice the log likelihood, less what it costs
)


def grown(search: Search, best: Ranked) -> list[Refined]:
    """Add effects one at a time as long as each pays for itself.

    Parameters
    ----------
    search : Search
    best : Ranked
        Where to begin.

    Returns
    -------
    list of Refined
        Ever larger hypotheses, each better than the one before; empty if nothing was found.
    """
    found: list[Refined] = []
    refined, score = best.refined, best.score
    while len(refined.hypothesis.effects) < MOST:
        larger = [item for item in _larger(search, refined.hypothesis) if item.settled]
        if not larger:
            break
        refined = min(larger, key=search.score)
        if search.score(refined) > score - _MATTERS:
            break
        score = search.score(refined)
        found.append(refined)
    return found


def _larger(search: Search, hypothesis: Hypothesis) -> list[Refined]:
    """Hypotheses with one effect more, fitted to the output."""
    setting = search.setting
    try:
        scan = search.scan(replace(setting, model=apply(setting.model, hypothesis)))
    except ConfigurationError:
        return []
    keys = [key for key, _ in hypothesis.linear]
    free = np.array([element in keys for element in scan.sums.elements])
    there = {(type(effect), effect.at) for effect in hypothesis.effects}
    trials = [
        trial
        for _, group, at in scan.places(free)[:_PLACES]
        for trial in scan.trials(group, at, free)
        if np.isfinite(trial.rest) and (trial.candidate.kind, trial.candidate.at) not in there
    ]
    trials.sort(key=lambda item: item.rest)
    larger: list[Hypothesis] = []
    for trial in trials[:_TRIED]:
        law = scan.hypothesis([trial], free).hypothesis
        moved = dict(law.linear)
        linear = tuple((key, change + moved.get(key, 0.0)) for key, change in hypothesis.linear)
        together = replace(hypothesis, effects=(*hypothesis.effects, *law.effects), linear=linear)
        if law.effects and plausible(setting.model, together):
            larger.append(together)
    task = partial(refine, setting, fitted=search.few, held=search.aside, steps=4)
    return list(search.each(task, larger))
