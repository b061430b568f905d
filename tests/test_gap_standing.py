"""What may be claimed where not all is explained: no law at a place where something of what is left acts."""

import numpy as np
import pytest

from creak.gap.diagnose import _silent
from creak.gap.hypothesis import Hypothesis
from creak.gap.refine import refine
from creak.gap.search import Search
from creak.gap.setting import Setting
from creak.gap.standing import standing, unsettled
from creak.mechanics.effects import CoulombFriction, CubicStiffness, Damping
from creak.mechanics.electronics import ActuatorDeadZone, ActuatorGain, ActuatorSaturation
from gap_recordings import CHAIN, RIG, recording

CUBIC = CubicStiffness(("3", "ground"), 5e7)


def stands(effects, supposed):
    """What stands of a hypothesis fitted to a recording with other effects."""
    data = recording(effects)
    every = np.arange(len(data.u))
    search = Search(Setting(RIG, CHAIN, data, 400), every[:9], every[9:12], _silent)
    fit = refine(search.setting, Hypothesis(supposed), search.few, search.aside, 3)
    return standing(search, fit)


@pytest.mark.parametrize(
    ("effects", "supposed", "kept", "gone"),
    [
        # A gain and a saturation in the stead of a dead zone and a saturation.
        (
            (CUBIC, ActuatorDeadZone(("1",), 8.0), ActuatorSaturation(("1",), 70.0)),
            (CUBIC, ActuatorGain(("1",), 0.85), ActuatorSaturation(("1",), 75.0)),
            (0,),
            ("actuator", ("1",)),
        ),
        # A damper in the stead of friction.
        (
            (CUBIC, CoulombFriction(("1", "2"), 4.0, 0.02)),
            (CUBIC, Damping(("1", "2"), 10.0)),
            (0,),
            ("internal", ("1", "2")),
        ),
        # Something that was not named at all takes nothing from what was, elsewhere.
        ((CUBIC, ActuatorSaturation(("1",), 90.0)), (CUBIC,), (0,), None),
    ],
    ids=["gain", "damper", "elsewhere"],
)
def test_a_stand_in_is_not_claimed_and_what_is_right_is(effects, supposed, kept, gone):
    """Kills a linear law that is named while distortion is left at its place, and claims given up whole."""
    found = stands(effects, supposed)
    assert [effect.effect for effect in found.refined.hypothesis.effects] == [supposed[i].effect for i in kept]
    assert found.unsettled == (() if gone is None else (gone,))
    assert found.refined.covariance.shape == (found.refined.hypothesis.size,) * 2
    words = unsettled(found.unsettled)
    assert len(words) == len(found.unsettled)
    assert all(name in words[0] for name in (gone[1] if gone else ()))


def test_an_actuator_and_a_sensor_of_one_node_are_tried_each():
    """Kills laws kept by the name of their node alone: those of the sensor took the place of the others."""
    data = recording((CUBIC,))
    every = np.arange(len(data.u))
    search = Search(Setting(RIG, CHAIN, data, 400), every[:9], every[9:12], _silent)
    scan = search.scan(search.setting)
    places = [("actuator", ("2",)), ("sensor", ("2",))]
    _, trials = search.singles(scan, [(1.0, *place) for place in places], scan.none)
    assert list(trials) == places
    assert all(item.candidate.group == group for (group, _), tried in trials.items() for item in tried)
