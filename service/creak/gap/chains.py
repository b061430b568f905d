"""Two effects of one amplifier or one sensor: a delay, and a law that bends the signal.

They act one after the other, so that what they do is no sum: the bent part is late as well. A delay turns every
line by its phase; whether it comes before or after a law without memory matters by what the samples fold alone, as
the output-error fit shows.
"""

from typing import Final

import numpy as np
from scipy.optimize import minimize

from creak.gap.candidates import Candidate
from creak.gap.regression import Column, Indices
from creak.gap.scan import Place, Scan, Trial
from creak.mechanics.effects import Effect
from creak.mechanics.electronics import (
    ActuatorDeadZone,
    ActuatorDelay,
    ActuatorGain,
    ActuatorSaturation,
    SensorClipping,
    SensorDelay,
    SensorGain,
)
from creak.records import Complex, Real

_CHAINS: Final[dict[str, tuple[type[Effect], type[Effect], tuple[type[Effect], ...]]]] = {
    "actuator": (ActuatorDelay, ActuatorGain, (ActuatorSaturation, ActuatorDeadZone)),
    "sensor": (SensorDelay, SensorGain, (SensorClipping,)),
}


def chained(scan: Scan, place: Place) -> list[tuple[Trial, Trial]]:
    """Delay and every bending law at a place, in both orders, their parameters optimised; none at internal places.

    Parameters
    ----------
    scan : Scan
    place : Place

    Returns
    -------
    list of (Trial, Trial)
        The best first; the columns of two add up to what they do together.
    """
    group, at = place
    if group not in _CHAINS:
        return []
    delay, gain, bends = _CHAINS[group]
    late, whole = Candidate(delay, at, group), Candidate(gain, at, group)
    pairs = [_optimised(scan, late, whole, Candidate(bend, at, group)) for bend in bends]
    return [order for pair in sorted(pairs, key=lambda pair: pair[1].rest) for order in (pair, pair[::-1])]


def _optimised(scan: Scan, late: Candidate, whole: Candidate, bend: Candidate) -> tuple[Trial, Trial]:
    view, few = scan.view, scan.few
    along = scan.small.along(late.pattern(view), scan.none)

    def left(values: Real) -> float:
        if values[1] <= 0:
            return np.inf
        return along.left(_lines(scan, whole, bend, few, values), fixed=True)

    grid = [np.array((time, bound)) for bound in bend.grid(view, few) for time in late.grid(view, few)]
    scores = [left(point) for point in grid]
    start = grid[int(np.argmin(scores))]
    # Steps of a simplex in proportion to the parameters, which are of very unlike size.
    found = minimize(lambda x: left(x * start), np.ones(2), method="Nelder-Mead", options={"maxfev": 80})
    best = found.x * start
    every = np.arange(len(view.r))
    both = _lines(scan, whole, bend, every, best)
    first = late.column(view, float(best[0]), every)
    second = Column(first.q, both - first.phi, True)
    rest = scan.sums.fit([first, second]).held / scan.floor
    return Trial(late, float(best[0]), first, rest), Trial(bend, float(best[1]), second, rest)


def _lines(scan: Scan, whole: Candidate, bend: Candidate, experiments: Indices, values: Real) -> Complex:
    """Lines ``(E, L)`` that a delay and a bound, `values`, make together."""
    signal = whole.forces(scan.view, experiments)(0.0)[0]
    bent = bend.forces(scan.view, experiments)(float(values[1]))[0]
    return np.asarray(np.exp(-scan.view.s * values[0]) * (signal + bent) - signal)
