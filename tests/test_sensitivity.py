"""Derivatives of steady states to parameters, against difference quotients of steady states solved anew."""

from dataclasses import replace

import numpy as np
import pytest

from creak.mechanics.effects import (
    Clearance,
    CoulombFriction,
    CubicStiffness,
    Hysteresis,
    OneSidedStop,
    Resonator,
    Stiffness,
)
from creak.mechanics.electronics import ActuatorSaturation, SensorClipping, SensorGain
from creak.mechanics.sensitivity import Neighbours, sensitivities, solve_rows
from creak.mechanics.steady import simulate_steady
from creak.mechanics.system import assemble
from creak.multisine import realisation
from gap_recordings import CHAIN, RIG, rig_of


def moved(effect, name, change):
    values = {**effect.parameters()}
    values[name] *= 1 + change
    return type(effect)(effect.at, **values)


@pytest.mark.parametrize(
    ("effects", "rig"),
    [
        ([CubicStiffness(("3", "ground"), 1e8), SensorGain(("2",), 1.1)], RIG),
        ([Clearance(("2", "3"), 5e4, 2e-4), Stiffness(("1", "ground"), 3e3)], rig_of("m/s", "zero-order")),
        ([OneSidedStop(("2", "1"), 4e4, 2e-4), CoulombFriction(("3", "ground"), 5.0, 0.05)], rig_of("m/s^2")),
        ([Hysteresis(("3", "ground"), 4e4, 3e-4), ActuatorSaturation(("1",), 90.0)], RIG),
        (
            [Resonator(("2",), 0.05, 40.0, 0.02), SensorClipping(("1",), 1e-3), CubicStiffness(("1", "2"), 1e8)],
            RIG,
        ),
    ],
    ids=lambda value: "-".join(e.effect for e in value) if isinstance(value, list) else value.nodes[0].output,
)
def test_derivatives_are_those_of_steady_states_solved_anew(effects, rig):
    # kills: a tangent without memory, a sign, a velocity that jumps with held inputs and is left out
    u = realisation(rig, 50.0, 3, 0)[:2]

    def system(i, name, change):
        own = list(effects)
        own[i] = moved(own[i], name, change)
        return assemble(replace(CHAIN, effects=tuple(own)), rig)

    def solved(at, guess=None):
        return simulate_steady(at, u, rig.sample_rate, rig.hold, oversampling=4, tolerance=1e-11, guess=guess)

    here = assemble(replace(CHAIN, effects=tuple(effects)), rig)
    steady = solved(here)
    assert steady.settled
    wanted = [(i, name) for i, effect in enumerate(effects) for name in effect.parameters()]
    pairs = [Neighbours(system(i, name, 1e-4), system(i, name, -1e-4), 2e-4) for i, name in wanted]
    found = list(sensitivities(here, steady, u, rig.sample_rate, rig.hold, pairs))
    for (i, name), derivative in zip(wanted, found, strict=True):
        ends = [solved(system(i, name, change), steady.motion).y for change in (1e-4, -1e-4)]
        quotient = (ends[0] - ends[1]) / 2e-4
        size = np.sqrt(np.mean(quotient**2, axis=(0, 2), keepdims=True))
        size = np.maximum(size, 1e-9 * size.max())  # a sensor moves its own node alone
        # Corners are crossed by a few samples within the quotient's width, which bounds what the two share.
        assert np.sqrt(np.mean(((derivative - quotient) / size) ** 2)) < 0.02, name


def test_rows_are_solved_each_for_itself():
    rng = np.random.default_rng(1)
    matrices = np.eye(12) + 0.3 * rng.standard_normal((5, 12, 12))
    right = rng.standard_normal((5, 12)) * np.geomspace(1e-6, 1e6, 5)[:, None]
    found = solve_rows(lambda rows: np.einsum("rij,rj->ri", matrices, rows), right, 1e-9, 12)
    np.testing.assert_allclose(found, np.linalg.solve(matrices, right[..., None])[..., 0], rtol=1e-6)
