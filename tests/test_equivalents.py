"""Actuators and sensors: told from the structure where that can be, and said to be alike where it cannot."""

import numpy as np
import pytest

from creak.gap.diagnose import diagnose
from creak.gap.equivalents import cannot_tell, equivalents
from creak.gap.periodic import gather
from creak.gap.records import Cause
from creak.mechanics.effects import GROUND, CubicStiffness
from creak.mechanics.electronics import (
    ActuatorDelay,
    ActuatorGain,
    SensorClipping,
    SensorDelay,
    SensorGain,
    SensorQuantisation,
)
from creak.mechanics.steady import simulate_steady
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.records import Excitation, Frame, Node, Rig, Run
from gap_recordings import CHAIN, RIG, recording

ONE = Rig("one", 512.0, 1024, 0, tuple(range(4, 120)), (Node("1", "m", "N"),))


def of_one_mass(*effects):
    """Data of a mass on a spring, and the model that lacks the effects."""
    linear = Lumped((PointMass("1", 1.0),), (Link(("1", GROUND), 1e4, 12.0),))
    truth = Lumped(linear.masses, linear.links, effects)
    u = np.concatenate([realisation(ONE, 20.0, 5, m) for m in range(4)])
    y = simulate_steady(assemble(truth, ONE), u, ONE.sample_rate, ONE.hold).y
    rng = np.random.default_rng(6)
    run = Run("one", ONE, 2, 0, Excitation("multisine", rms=20.0, seed=5), "simulated")
    noise = 10 ** (-45 / 20) * y.std()
    frames = [
        Frame(m, 0, p, 0, u[m], y[m] + noise * rng.standard_normal(y[m].shape)) for m in range(4) for p in range(2)
    ]
    return linear, gather(run, frames)


def names(causes):
    return {cause.effect for cause in causes}


@pytest.mark.parametrize("effect", [ActuatorGain(("1",), 1.1), SensorDelay(("1",), 0.3 / 512)])
def test_of_one_node_actuator_and_sensor_are_alternatives(effect):
    """With one input and one response a delay, or a gain of a linear structure, lies before or behind it."""
    found = diagnose(ONE, *of_one_mass(effect))
    kind = effect.effect.split("_")[1]
    both = {f"actuator_{kind}", f"sensor_{kind}"}
    assert found.verdict == "explained"
    assert names(found.causes) | names(found.alternatives) >= both
    for other in found.alternatives:
        if other.effect in both:
            assert found.causes[other.instead_of].effect in both
            (value,) = effect.parameters().values()
            assert next(iter(other.parameters.values())) == pytest.approx(value, rel=0.01)
    said = any("hang on that node" in sentence for sentence in found.not_claimed)
    assert said == (kind == "gain")


@pytest.mark.parametrize(
    "effect",
    [
        ActuatorGain(("2",), 1.05),
        SensorGain(("2",), 1.05),
        ActuatorDelay(("1",), 0.1 / RIG.sample_rate),
        SensorDelay(("3",), 0.1 / RIG.sample_rate),
        SensorClipping(("1",), 4e-3),
        SensorQuantisation(
            ("1",), 4e-4
        ),  # told by its step alone: no law beside it, as a fit of few steps is rough
    ],
    ids=lambda effect: effect.effect,
)
def test_of_driven_nodes_actuator_sensor_and_structure_are_told_apart(effect):
    """A tenth of a sample and five per cent, each at its own node and of its own kind, without an alternative."""
    found = diagnose(RIG, CHAIN, recording((effect,), realisations=4))
    (cause,) = found.causes
    assert (cause.effect, cause.at) == (effect.effect, effect.at)
    assert not found.alternatives
    for name, value in effect.parameters().items():
        assert abs(cause.parameters[name] - value) < 5 * cause.standard_errors[name] + 1e-3 * abs(value)


def test_a_gain_of_a_structure_that_is_not_linear_has_no_equivalent():
    """The amplitude tells: a spring that is stiffer by g^2 is no gain of the input. A delay stays one."""
    linear, _ = of_one_mass()
    bent = Lumped(linear.masses, linear.links, (CubicStiffness(("1", GROUND), 3e7),))
    gain, delay = (
        Cause(name, ("1",), {name.split("_")[1]: 1.1}, {name.split("_")[1]: 0.1}, 0.9, -40.0)
        for name in ("sensor_gain", "actuator_delay")
    )
    found = equivalents(ONE, bent, [gain, delay], [])
    assert [(other.effect, other.instead_of) for other in found] == [("sensor_delay", 1)]
    found = equivalents(ONE, linear, [gain, delay], list(found))
    assert [(other.effect, other.instead_of) for other in found] == [("sensor_delay", 1), ("actuator_gain", 0)]
    assert equivalents(RIG, CHAIN, [gain], []) == ()


def test_a_node_that_is_not_driven_may_be_measured_in_other_units():
    still = Rig(**{**vars(RIG), "nodes": (*RIG.nodes[:2], Node("3", "m"))})
    gains = [Cause("sensor_gain", (name,), {"gain": 1.1}, {"gain": 0.1}, 0.9, -40.0) for name in "13"]
    (sentence,) = cannot_tell(still, gains)
    assert "sensor gain at 3 is the same, in these data, as a change of all masses, springs" in sentence
