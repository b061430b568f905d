"""Structures: matrices, points, units, linear effects."""

from dataclasses import replace

import numpy as np
import pytest

from creak.errors import ConfigurationError
from creak.mechanics.effects import CubicStiffness, Damping, Mass, Resonator, Stiffness
from creak.mechanics.electronics import ActuatorGain, SensorDelay
from creak.mechanics.structure import Link, Lumped, Matrices, MeasuredResponse, PointMass
from creak.mechanics.system import assemble
from creak.records import Node, Rig

CHAIN = Lumped(
    masses=(PointMass("1", 1.0), PointMass("2", 0.8), PointMass("3", 1.2)),
    links=(
        Link(("ground", "1"), 2e4, 8.0),
        Link(("1", "2"), 3.5e4, 8.0),
        Link(("2", "3"), 5e4, 8.0),
        Link(("3", "ground"), 8e4, 8.0),
    ),
)
MASS = np.diag([1.0, 0.8, 1.2])
STIFFNESS = 1e4 * np.array([[5.5, -3.5, 0], [-3.5, 8.5, -5], [0, -5, 13]])
DAMPING = 8.0 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]])
UNDRIVEN = Matrices(MASS, DAMPING, STIFFNESS, inputs={"1": 0}, outputs={"1": 0, "2": 1})
FREQUENCIES = np.array([0.0, 5.0, 30.0, 80.0, 300.0])


def make_rig(output="m", names=("1", "2", "3"), driven=("1", "2", "3")):
    nodes = tuple(Node(name, output, "N" if name in driven else None) for name in names)
    return Rig("test", 5000.0, 1024, 1, (5, 6, 7), nodes)


def response(mass, damping, stiffness, frequencies=FREQUENCIES):
    """(2), frequency by frequency."""
    return np.array(
        [np.linalg.inv(stiffness + 1j * w * damping - w**2 * mass) for w in 2 * np.pi * np.asarray(frequencies)]
    )


def test_chain_has_the_paper_s_response_in_every_unit():
    """A wrong sign off the diagonal, ground counted as a mass, or jw in the wrong place."""
    expected = response(MASS, DAMPING, STIFFNESS)
    s = 2j * np.pi * FREQUENCIES[:, None, None]
    for order, unit in enumerate(("m", "m/s", "m/s^2")):
        found = assemble(CHAIN, make_rig(unit)).response(FREQUENCIES)
        np.testing.assert_allclose(found, s**order * expected, rtol=1e-10)


def test_rig_picks_nodes_by_name():
    """Nodes in another order, and one without input, must select rows and columns, not positions."""
    found = assemble(CHAIN, make_rig(names=("3", "1"), driven=("1",))).response(FREQUENCIES)
    np.testing.assert_allclose(found, response(MASS, DAMPING, STIFFNESS)[:, [2, 0], :][:, :, [0]], rtol=1e-10)


def test_matrices_are_the_same_structure():
    """Degrees of freedom by name: a table transposed or an index shifted."""
    turn = [2, 0, 1]
    inputs = {"3": 0, "1": 1, "2": 2}
    pick = np.ix_(turn, turn)
    spring = (CubicStiffness(("3", "1"), 1.0),)
    model = Matrices(MASS[pick], DAMPING[pick], STIFFNESS[pick], inputs, inputs, spring)
    system = assemble(model, make_rig())
    np.testing.assert_allclose(system.response(FREQUENCIES), response(MASS, DAMPING, STIFFNESS), rtol=1e-10)
    np.testing.assert_array_equal(system.incidence.T @ system.outputs.T, [[-1, 0, 1]])


def test_linear_effects_change_the_matrices():
    """Each adds its rank-one term, an internal mass as an inerter."""
    effects = (
        Stiffness(("1", "3"), 1e3),
        Damping(("2", "ground"), -2.0),
        Mass(("3", "ground"), 0.1),
        Mass(("1", "2"), 0.05),
    )
    system = assemble(replace(CHAIN, effects=effects), make_rig())
    expected = response(
        MASS + np.array([[0.05, -0.05, 0], [-0.05, 0.05, 0], [0, 0, 0.1]]),
        DAMPING + np.diag([0, -2.0, 0]),
        STIFFNESS + 1e3 * np.array([[1, 0, -1], [0, 0, 0], [-1, 0, 1]]),
    )
    np.testing.assert_allclose(system.response(FREQUENCIES), expected, rtol=1e-10)


def test_resonator_is_a_dynamic_stiffness_at_its_node():
    """Condensed to its node it is w-dependent: mass at low, nothing at high frequency, a peak at its own."""
    ratio, frequency, mass = 0.02, 40.0, 0.3
    system = assemble(replace(CHAIN, effects=(Resonator(("2",), mass, frequency, ratio),)), make_rig())
    frequencies = np.array([1.0, 20.0, 40.0, 41.0, 200.0])
    s, w0 = 2j * np.pi * frequencies, 2 * np.pi * frequency
    passed = (w0**2 + 2 * ratio * w0 * s) / (s**2 + 2 * ratio * w0 * s + w0**2)
    added = np.linalg.inv(system.response(frequencies)) - np.linalg.inv(
        response(MASS, DAMPING, STIFFNESS, frequencies)
    )
    expected = np.zeros_like(added)
    expected[:, 1, 1] = mass * s**2 * passed
    np.testing.assert_allclose(added, expected, atol=1e-6 * np.abs(expected).max())


def test_electronics_find_their_channel():
    """An effect of node 3 must not land on the first channel of a rig that has only node 3 and 1."""
    effects = (ActuatorGain(("3",), 2.0), SensorDelay(("1",), 1e-3))
    system = assemble(replace(CHAIN, effects=effects), make_rig(names=("1", "3")))
    assert system.actuators == ((), (effects[0],))
    assert system.sensors == ((effects[1],), ())


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: assemble(CHAIN, make_rig(names=("1", "4"))), "rig test: nodes[1].name: '4' is not in the model"),
        (lambda: assemble(CHAIN, make_rig("V")), "'V' cannot be simulated; allowed are m, m/s, m/s^2"),
        (lambda: assemble(MeasuredResponse("x.mcap"), make_rig()), "kind: 'frf' cannot be simulated"),
        (lambda: assemble(UNDRIVEN, make_rig(names=("1", "2"))),
         "nodes[1].input: the model has no actuator at '2'; '1' have one"),
        (lambda: replace(CHAIN, masses=(PointMass("1", 0.0),)), "masses[0].mass: 0.0, must be"),
        (lambda: replace(CHAIN, masses=CHAIN.masses * 2), "the name '1' is given 2 times"),
        (lambda: replace(CHAIN, links=(Link(("1", "7"), 1.0),)), "links[0].between: '7' is no mass"),
        (lambda: replace(CHAIN, effects=(CubicStiffness(("1", "9"), 1.0),)), "effects[0].at: '9' is no node"),
        (lambda: Matrices(MASS, DAMPING, STIFFNESS[:2], {}, {}), "stiffness: shape (2, 3), must be that of mass"),
        (lambda: Matrices(MASS, DAMPING, STIFFNESS, {"1": 3}, {}), "inputs.1: 3, must be a degree of freedom"),
        (lambda: Matrices(-MASS, DAMPING, STIFFNESS, {}, {}), "mass: must be positive definite"),
        (lambda: assemble(replace(CHAIN, effects=(Mass(("1", "ground"), -1.0),)), make_rig()),
         "effects: must be positive definite"),
    ],
)  # fmt: skip
def test_refuses_with_one_clear_line(make, message):
    """What does not fit is named with its key, not met as an index error later."""
    with pytest.raises(ConfigurationError, match=r".") as caught:
        make()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
