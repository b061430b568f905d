"""Effects at places of their own, and two at one: places by free forces, laws one at a time."""

from dataclasses import replace

import numpy as np
import pytest

from creak.gap.chains import chained
from creak.gap.diagnose import diagnose
from creak.gap.records import Verdict
from creak.gap.scan import Scan
from creak.gap.together import Together, _spots, moved, opened, spot_sets
from creak.gap.view import see
from creak.mechanics.effects import (
    Clearance,
    CoulombFriction,
    CubicStiffness,
    Hysteresis,
    OneSidedStop,
    QuadraticDamping,
)
from creak.mechanics.electronics import (
    ActuatorDeadZone,
    ActuatorDelay,
    ActuatorSaturation,
    SensorClipping,
    SensorDelay,
)
from creak.mechanics.structure import Link
from creak.report.words import summary
from gap_recordings import CHAIN, RIG, recording

CUBIC = CubicStiffness(("2", "ground"), 2e8)
CLIPPED = SensorClipping(("2",), 1e-3)


def scanned(*effects):
    """Regressions on a recording with effects that the model lacks."""
    data = recording(effects)
    every = np.arange(len(data.u))
    return Scan(see(RIG, CHAIN, data, 400), every[:9], every[9:], data.degrees / (data.degrees - 1))


def test_motion_behind_a_clipping_sensor_is_restored():
    """Kills laws that are tried on a motion that a sensor has spoilt: it comes back to 1 % of what was cut off."""
    places = [("internal", ("2", "ground")), ("sensor", ("2",))]
    whole, cut = scanned(CUBIC).view, scanned(CUBIC, CLIPPED).view
    lost = np.sum((cut.d[:, 1] - whole.d[:, 1]) ** 2)
    back = np.sum((moved(cut, places).d[:, 1] - whole.d[:, 1]) ** 2)
    assert lost > 0.01 * np.sum(whole.d[:, 1] ** 2)
    assert back < 1e-2 * lost


def test_a_law_is_told_beside_free_forces_elsewhere():
    """Kills patterns from which the free force was not taken out: it leaves noise, other laws do not."""
    scan = scanned(CUBIC, ActuatorSaturation(("1",), 70.0))
    view = opened(scan.view, [("actuator", ("1",))])
    beside = Scan(view, *scan.sums.sets, scan.floor * 2 / 3)
    trials = beside.trials("internal", ("2", "ground"), beside.none)
    assert trials[0].candidate.kind is CubicStiffness
    assert trials[0].rest == pytest.approx(1.0, abs=0.1)
    assert trials[1].rest > 3.0


def test_places_that_make_the_same_forces_all_compete():
    """Kills a search that keeps one side pair of a closed triangle and drops the true one."""
    scan = scanned(CubicStiffness(("1", "2"), 3e8), CoulombFriction(("2", "ground"), 5.0, 0.02))
    sets = [{spot[0][1] for spot in spots} for spots in spot_sets(scan)]
    for wanted in (
        {("1", "2"), ("2", "ground")},
        {("1", "2"), ("1", "ground")},
        {("1", "ground"), ("2", "ground")},
    ):
        assert wanted in sets
    best = Together(scan).run()[0].hypothesis
    assert {effect.effect for effect in best.effects} == {"cubic_stiffness", "coulomb_friction"}


@pytest.mark.parametrize(
    "effects",
    [
        (CUBIC, CLIPPED),
        (Hysteresis(("3", "ground"), 4e4, 3e-4), SensorClipping(("3",), 7e-4)),
        (OneSidedStop(("3", "ground"), 3e4, 1e-4), Hysteresis(("3", "ground"), 2e4, 3e-4)),
        (
            Clearance(("2", "ground"), 4e4, 3e-4),
            CubicStiffness(("2", "ground"), 3e8),
            ActuatorSaturation(("1",), 70.0),
        ),
        (
            CubicStiffness(("1", "ground"), 1e7),
            ActuatorDeadZone(("2",), 6.0),
            ActuatorSaturation(("2",), 60.0),
        ),
    ],
    ids=lambda effects: "-".join(effect.effect for effect in effects),
)
def test_all_are_named_and_none_is_invented(effects):
    """Kills a search that a spoilt sensor misleads, or that drops a pair whose laws fit badly alone."""
    found = diagnose(RIG, CHAIN, recording(effects))
    assert found.verdict is Verdict.EXPLAINED
    assert {(cause.effect, frozenset(cause.at)) for cause in found.causes} == {
        (effect.effect, frozenset(effect.at)) for effect in effects
    }


def test_a_sensor_at_a_node_that_moves_alone_is_a_place_of_its_own():
    """Kills laws that are tried on a motion which the sensor has spoilt, as it passed for a force at its node."""
    loose = (*CHAIN.links[:2], Link(("2", "3"), 50.0, 0.01), CHAIN.links[3])
    data = recording([CUBIC])
    every = np.arange(len(data.u))
    scan = Scan(see(RIG, replace(CHAIN, links=loose), data, 400), every[:9], every[9:], 2.0)
    spots = {spot for some in spot_sets(scan) for spot in some} | set(_spots(scan))
    assert (("sensor", ("3",)),) in spots
    assert (("internal", ("3", "ground")), ("actuator", ("3",))) in spots


@pytest.mark.parametrize(
    "effects",
    [
        (SensorDelay(("2",), 2.3e-3), SensorClipping(("2",), 1e-2)),
        (ActuatorDelay(("2",), 2.3e-3), ActuatorDeadZone(("2",), 12.0)),
    ],
    ids=["sensor", "actuator"],
)
def test_a_delay_and_a_law_that_bends_the_same_signal_are_told(effects):
    """Kills two effects of one channel that are taken for a sum: what is bent is late as well."""
    scan = scanned(*effects)
    (late, bent), (first, second) = chained(scan, (effects[0].effect.partition("_")[0], ("2",)))[:2]
    assert (first, second) == (bent, late)
    assert bent.candidate.kind is type(effects[1])
    assert bent.rest < 3.0  # the samples fold what a kink makes beyond half the rate, in another way if it is late
    assert late.inner == pytest.approx(effects[0].delay, rel=1e-2)
    assert bent.inner == pytest.approx(next(iter(effects[1].parameters().values())), rel=1e-2)


def test_three_laws_at_one_place_are_named_though_not_called_explained():
    """Kills a damper in the stead of friction beside two other laws, and the search that stops at two."""
    effects = (
        CoulombFriction(("1", "ground"), 5.0, 0.02),
        Hysteresis(("1", "ground"), 2e4, 3e-4),
        QuadraticDamping(("1", "ground"), 20.0),
    )
    found = diagnose(RIG, CHAIN, recording(effects))
    assert found.verdict is Verdict.PARTLY_EXPLAINED
    assert found.gap.after_db == pytest.approx(found.gap.noise_db, abs=1.0)
    assert {cause.effect for cause in found.causes} == {effect.effect for effect in effects}
    assert any("two at one place" in line for line in summary(found))
