"""Every combination of laws by one matrix of products: it must say what the regressions themselves say."""

from itertools import combinations

import numpy as np
import pytest

from creak.gap.candidates import candidates_at
from creak.gap.combinations import Combinations
from creak.gap.scan import Scan
from creak.gap.several import rest
from creak.gap.view import see
from creak.mechanics.effects import Clearance, CubicStiffness, OneSidedStop
from creak.mechanics.electronics import ActuatorDeadZone, ActuatorSaturation
from gap_recordings import CHAIN, RIG, recording

PLACES = [("internal", ("2", "ground")), ("actuator", ("2",))]


@pytest.fixture(scope="module")
def scan():
    data = recording([CubicStiffness(("2", "ground"), 1e8), ActuatorSaturation(("2",), 80.0)])
    every = np.arange(len(data.u))
    return Scan(see(RIG, CHAIN, data, 400), every[:9], every[9:], data.degrees / (data.degrees - 1))


def fitted(scan, every, chosen, free):
    """What columns leave by the regression itself, and their coefficients."""
    laws = [every.laws[every.owner[i]] for i in chosen]
    columns = [
        law.column(scan.view, every.inner[i], np.arange(len(scan.view.r)))
        for law, i in zip(laws, chosen, strict=True)
    ]
    fit = scan.small.fit(columns, free)
    return fit.left, fit.own


@pytest.mark.parametrize("freed", [0, 3])
def test_pairs_and_triples_leave_what_the_regression_says(scan, freed):
    """Kills an elimination that forgets a fixed coefficient, a pattern of its own, or free linear elements."""
    free = scan.none
    free[:freed] = True
    every = Combinations(scan, PLACES, free)
    left, one, second = every.system.pairs()
    count = scan.small.counts[0]
    rng = np.random.default_rng(1)
    finite = np.argwhere(np.isfinite(left))
    for i, j in finite[rng.choice(len(finite), 40, replace=False)]:
        if every.owner[i] == every.owner[j]:
            continue
        alone, own = fitted(scan, every, (i, j), free)
        assert left[i, j] / count == pytest.approx(alone, rel=1e-6)
        assert (one[i, j], second[i, j]) == pytest.approx(tuple(own), rel=1e-5)
    for least, chosen in every._threes()[::400]:
        assert least / count == pytest.approx(fitted(scan, every, chosen, free)[0], rel=1e-5)


def test_the_best_pair_of_the_grids_is_the_best_of_all(scan):
    """Kills a table whose blocks are those of other laws."""
    every = Combinations(scan, PLACES, scan.none)
    least, chosen = every._twos()[0]
    left = every.system.pairs()[0]
    others = [(i, j) for i, j in combinations(range(len(every.owner)), 2) if every.owner[i] != every.owner[j]]
    assert least == min(left[pair] for pair in others)
    assert left[chosen] == least


def test_laws_that_hide_one_another_are_found_together():
    """Kills inner parameters searched alone: a gain stands in for the dead zone."""
    effects = ActuatorDeadZone(("2",), 8.0), ActuatorSaturation(("2",), 60.0)
    data = recording(effects)
    every = np.arange(len(data.u))
    scan = Scan(see(RIG, CHAIN, data, 400), every[:9], every[9:], data.degrees / (data.degrees - 1))
    best = Combinations(scan, PLACES, scan.none).best(2, 3)
    assert {trial.candidate.kind for trial in best[0]} == {type(effect) for effect in effects}
    assert rest(best[1]) > 3 * rest(best[0])


def test_two_gaps_at_one_place_are_searched_at_once():
    """Kills inner parameters searched in turn alone: they stop in a valley aslant to both, 50 times above this."""
    data = recording((Clearance(("2", "ground"), 1e4, 3e-3), OneSidedStop(("2", "ground"), 4e4, 4.2e-3)))
    every = np.arange(len(data.u))
    scan = Scan(see(RIG, CHAIN, data, 400), every[:9], every[9:], data.degrees / (data.degrees - 1))
    best = Combinations(scan, PLACES[:1], scan.none).best(2, 3)[0]
    assert rest(best) < 3.0
    assert {trial.candidate.kind for trial in best} == {Clearance, OneSidedStop}
    for trial, gap in ((trial, {Clearance: 3e-3, OneSidedStop: 4.2e-3}[trial.candidate.kind]) for trial in best):
        assert trial.inner == pytest.approx(gap, rel=0.01)


@pytest.mark.parametrize("coefficient", [np.nan, np.inf])
def test_a_coefficient_that_is_no_number_is_no_effect(coefficient):
    """Kills a diagnosis that ends with an error because one of all laws could not be fitted."""
    for group, at in PLACES:
        assert all(law.effect(coefficient, 0.1) is None for law in candidates_at(group, at))
