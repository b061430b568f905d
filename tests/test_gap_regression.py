"""Regression and places: the laws at which a diagnosis starts, on recordings made by the harmonic solver."""

import numpy as np
import pytest

from creak.gap.hypothesis import Hypothesis, apply, own_elements
from creak.gap.regression import Column, Sums, linear_elements, solve
from creak.gap.scan import Scan
from creak.gap.view import see
from creak.mechanics.effects import CubicStiffness, Damping, Mass, QuadraticDamping, Stiffness
from gap_recordings import CHAIN, RIG, recording


def scan_of(model, data, top=200):
    every = np.arange(len(data.u))
    floor = data.degrees / (data.degrees - 1)
    return Scan(see(RIG, model, data, top), every[:-3], every[-3:], floor)


def test_sums_give_the_least_squares_of_all_samples():
    # kills: a pattern without its conjugate, a line counted twice
    data = recording([CubicStiffness(("3", "ground"), 1e8)])
    view = see(RIG, CHAIN, data, 120)
    every = np.arange(len(data.u))
    sums = Sums(view, every, every[:0])
    rng = np.random.default_rng(1)
    q = rng.standard_normal((120, 3)) + 1j * rng.standard_normal((120, 3))
    phi = rng.standard_normal((len(every), 120)) + 1j * rng.standard_normal((len(every), 120))
    free = np.array([kind is Stiffness for kind, _ in linear_elements(view.names)])
    fit = sums.fit([Column(q, phi)], free)
    columns = [sums.q[None, :, :, k] * sums.phi[:, :, None, k] for k in np.flatnonzero(free)] + [
        q * phi[..., None]
    ]
    stack = np.array([np.concatenate([c.real.ravel(), c.imag.ravel()]) for c in columns]).T
    r = np.concatenate([view.r.real.ravel(), view.r.imag.ravel()])
    size = np.linalg.norm(stack, axis=0)
    theta = np.linalg.lstsq(stack / size, r, rcond=None)[0] / size
    assert np.append(fit.linear[free], fit.own) == pytest.approx(theta, rel=1e-6)
    assert fit.left * view.r.size == pytest.approx(np.sum((r - stack @ theta) ** 2), rel=1e-8)


@pytest.mark.parametrize("at", [("3", "ground"), ("1", "2"), ("1", "3")])
def test_a_free_force_leaves_noise_at_the_right_place_alone(at):
    # kills: an edge taken for a ground, a force of the wrong pattern
    scan = scan_of(CHAIN, recording([QuadraticDamping(at, 20.0)]))
    places = scan.places(scan.none)
    right = [rest for rest, group, names in places if names == at and group == "internal"]
    others = [rest for rest, group, names in places if names not in (at, at[:1]) and group != "sensor"]
    assert right[0] < 1.1
    assert min(others) > 2 * right[0]


def test_linear_elements_that_are_off_do_not_hide_the_place():
    # kills: a projection whose rounding is scaled up and fitted
    off = Hypothesis(linear=((((Stiffness, ("1", "2"))), 2e3), ((Mass, ("2", "ground")), 0.05)))
    scan = scan_of(apply(CHAIN, off), recording([CubicStiffness(("3", "ground"), 1e8)]))
    rest, _, at = next(place for place in scan.places(~scan.none) if place[1] == "internal")
    assert at == ("3", "ground")
    assert rest < 1.2


def test_what_columns_do_not_determine_stays_nothing():
    gram = np.array([[2.0, 2.0], [2.0, 2.0]])
    assert solve(gram, np.array([2.0, 2.0])) == pytest.approx([0.5, 0.5])
    assert solve(np.zeros((0, 0)), np.zeros(0)).size == 0


def test_a_hypothesis_changes_the_model_where_it_says():
    # kills: a change of a link's stiffness that is added as a second spring, or of the wrong sign
    own = {element.key for element in own_elements(CHAIN)}
    assert (Stiffness, ("1", "ground")) in own
    assert (Stiffness, ("1", "3")) not in own
    changed = apply(
        CHAIN,
        Hypothesis(
            (CubicStiffness(("1", "2"), 5.0),),
            (((Stiffness, ("1", "ground")), 100.0), ((Damping, ("1", "3")), 2.0)),
        ),
    )
    assert changed.links[0].stiffness == CHAIN.links[0].stiffness + 100.0
    assert changed.effects == (CubicStiffness(("1", "2"), 5.0), Damping(("1", "3"), 2.0))
    assert apply(changed, Hypothesis(dropped=(0,))).effects == (Damping(("1", "3"), 2.0),)
