"""The diagnosis on a beam whose modulus, density, damping ratio, masses and suspensions are all off."""

from dataclasses import replace

import numpy as np

from creak.gap.diagnose import diagnose
from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.periodic import gather
from creak.gap.properties import PROPERTIES, stiffness_change
from creak.gap.records import Verdict
from creak.mechanics.beam import Beam, Station
from creak.mechanics.effects import QuadraticDamping, Stiffness
from creak.mechanics.steady import simulate_steady
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.records import Excitation, Frame, Node, Rig, Run

RIG = Rig(
    name="beam",
    sample_rate=1000.0,
    period_samples=2048,
    transient_periods=0,
    lines=tuple(range(6, 307)),
    nodes=tuple(Node(name, "m", "N") for name in "123"),
    hold="band-limited",
)
TRUE = Beam(
    0.5,
    0.02,
    0.002,
    2e11,
    7800.0,
    0.015,
    12,
    tuple(
        Station(name, position, 0.045, stiffness, 1.1, actuator=True, sensor=True)
        for name, position, stiffness in (("1", 0.0, 250.0), ("2", 1 / 6, 400.0), ("3", 0.5, 300.0))
    ),
)
OFF = (0.93, 1.08, 0.91, 1.07, 0.94, 1.06, 0.92, 1.05, 1.09, 0.95, 0.96, 1.04)


def wrong(model):
    """All numbers of a beam off by up to 9 %."""
    factors = iter(OFF)
    stations = tuple(
        replace(
            station,
            moving_mass=station.moving_mass * next(factors),
            suspension_stiffness=station.suspension_stiffness * next(factors),
            suspension_damping=station.suspension_damping * next(factors),
        )
        for station in model.stations
    )
    own = {name: getattr(model, name) * next(factors) for name in PROPERTIES}
    return replace(model, stations=stations, **own)


def recorded(model, snr_db=45.0, realisations=4):
    """Recording of a beam."""
    u = np.concatenate([realisation(RIG, 1.0, 3, m) for m in range(realisations)])
    steady = simulate_steady(assemble(model, RIG), u, RIG.sample_rate, RIG.hold)
    assert steady.settled
    rng = np.random.default_rng(5)
    sigma = np.sqrt(np.mean(steady.y**2, axis=(0, 2)))[:, None] * 10 ** (-snr_db / 20)
    run = Run("beam", RIG, 3, 0, Excitation("multisine", rms=1.0, seed=3), "simulated")
    frames = [
        Frame(e // 3, e % 3, p, 0, u[e], steady.y[e] + sigma * rng.standard_normal(steady.y[e].shape))
        for e in range(len(u))
        for p in range(3)
    ]
    return gather(run, frames)


def test_the_derivative_of_the_dynamic_stiffness_tells_what_a_small_change_moves():
    # kills: a wrong sign, a step that hits another set of modes, a station's share that is missing
    frequencies = np.array([3.0, 17.0, 60.0, 140.0])
    s = 2j * np.pi * frequencies

    def receptance(model):
        system = assemble(model, RIG)
        return system.outputs @ system.motion(frequencies, system.outputs.T)

    S = receptance(TRUE)
    for name in PROPERTIES:
        value = getattr(TRUE, name)
        moved = receptance(replace(TRUE, **{name: value * 1.0001})) - S
        told = -S @ stiffness_change(RIG, TRUE, name, s) @ S * 1e-4 * value
        assert np.abs(moved - told).max() < 5e-3 * np.abs(told).max()


def test_changes_of_a_beam_enter_its_own_numbers():
    # kills: a correction put beside the beam as a spring, or into the wrong station
    hypothesis = Hypothesis(linear=((("density", ()), 100.0), ((Stiffness, ("2", "ground")), -50.0)))
    changed = apply(TRUE, hypothesis)
    assert changed.density == 7900.0
    assert changed.stations[1].suspension_stiffness == 350.0
    assert not changed.effects
    below = apply(TRUE, Hypothesis(linear=(((Stiffness, ("2", "ground")), -500.0),)))
    assert [effect.parameters()["coefficient"] for effect in below.effects] == [-500.0]


def test_a_beam_that_is_off_altogether_is_corrected_and_the_effect_beside_it_is_named():
    # kills: freeing springs at stations alone, a single linear step, the effect taken for a linear error
    truth = replace(TRUE, effects=(QuadraticDamping(("3", "ground"), 8.0),))
    diagnosis = diagnose(RIG, wrong(TRUE), recorded(truth))
    assert diagnosis.verdict is Verdict.EXPLAINED
    (cause,) = diagnosis.causes
    assert (cause.effect, cause.at) == ("quadratic_damping", ("3", "ground"))
    assert abs(cause.parameters["coefficient"] - 8.0) < 0.01 * 8.0
    for name in PROPERTIES:
        assert abs(getattr(diagnosis.corrected, name) / getattr(TRUE, name) - 1) < 0.01
    assert {"youngs_modulus", "density", "damping_ratio"} <= {
        moved.parameter for moved in diagnosis.linear_corrections
    }
    assert 0.9 < diagnosis.where[0].residual < 1.2


def test_linear_errors_of_a_beam_alone_name_no_effect():
    # kills: a nonlinear law that takes up what the modulus does
    diagnosis = diagnose(RIG, wrong(TRUE), recorded(TRUE))
    assert diagnosis.verdict is Verdict.EXPLAINED
    assert not diagnosis.causes
    assert abs(diagnosis.corrected.youngs_modulus / TRUE.youngs_modulus - 1) < 0.01
