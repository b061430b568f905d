"""What a search ends with: hypotheses that were fitted to the output, the best first."""

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from creak.gap.hypothesis import Hypothesis
from creak.gap.refine import Refined
from creak.gap.regression import LinearKey

FEW = 2  # linear changes that are causes like any other


@dataclass(frozen=True, eq=False)
class Ranked:
    """A hypothesis that was fitted to the output, with its Bayesian information criterion."""

    refined: Refined
    score: float

    @property
    def hypothesis(self) -> Hypothesis:
        """What it supposes."""
        return self.refined.hypothesis


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search ended with.

    Parameters
    ----------
    ranked : tuple of Ranked
        Hypotheses of the last stage that was needed, the best first; empty if there was none.
    explained : bool
        The best one leaves noise.
    places : list
        Places by what a free force there leaves, the linear part as the best hypothesis has it.
    whole : bool
        The best one was fitted to all experiments that may be fitted.
    """

    ranked: tuple[Ranked, ...]
    explained: bool
    places: list[tuple[float, str, tuple[str, ...]]] = field(default_factory=list)
    whole: bool = False


def significant(refined: Refined, own: Collection[LinearKey]) -> Hypothesis:
    """Hypothesis without the linear changes that lie within four standard errors of nothing.

    Where more than a few stand, the model is off altogether and all its own numbers stay free.
    """
    linear = refined.hypothesis.linear
    errors = np.sqrt(np.maximum(np.diag(refined.covariance), 0.0))[refined.hypothesis.size - len(linear) :]
    clear = [abs(change) > 4 * error for (_, change), error in zip(linear, errors, strict=True)]
    many = sum(clear) > FEW
    kept = tuple(item for item, stands in zip(linear, clear, strict=True) if stands or (many and item[0] in own))
    return replace(refined.hypothesis, linear=kept)
