"""Steady state solved for: against time stepping and an independent integrator, and where there is none."""

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from creak.errors import SimulationError
from creak.mechanics import effects, laws
from creak.mechanics.electronics import (
    ActuatorHysteresis,
    ActuatorSaturation,
    SensorDelay,
    SensorQuantisation,
)
from creak.mechanics.newmark import Stepper
from creak.mechanics.steady import resampled, simulate_steady
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.mechanics.tangents import force_change
from creak.records import Node, Rig

FS = 1000.0
SIZE = 512
CHAIN = Lumped(
    masses=(PointMass("1", 1.0), PointMass("2", 0.8)),
    links=(Link(("ground", "1"), 2e4, 30.0), Link(("1", "2"), 3e4, 20.0), Link(("2", "ground"), 1e4, 10.0)),
)
EVERY_LAW = (
    effects.CubicStiffness(("2", "ground"), 5e8),
    effects.QuadraticStiffness(("1", "ground"), 1e6),
    effects.Clearance(("1", "2"), 4e4, 1e-3),
    effects.OneSidedStop(("2", "ground"), 3e4, 5e-4),
    effects.CoulombFriction(("2", "1"), 5.0, 0.05),
    effects.QuadraticDamping(("1", "ground"), 50.0),
    effects.Hysteresis(("1", "ground"), 2e4, 1e-3),
)


def make_system(*present, output="m", model=CHAIN):
    nodes = tuple(Node(mass.name, output, "N") for mass in model.masses)
    rig = Rig("chain", FS, SIZE, 1, tuple(range(3, 40)), nodes)
    return assemble(replace(model, effects=present), rig)


def multisine(experiments=1, rms=20.0, seed=1, inputs=2):
    rng = np.random.default_rng(seed)
    spectrum = np.zeros((experiments, inputs, SIZE // 2 + 1), complex)
    spectrum[..., 3:40] = np.exp(2j * np.pi * rng.random((experiments, inputs, 37)))
    u = np.fft.irfft(spectrum)
    return u * rms / np.sqrt(np.mean(u**2, axis=-1, keepdims=True))


def stepped(system, u, substeps, hold="band-limited", periods=16):
    return deque(Stepper(system, FS, substeps, hold).experiment(u, periods), maxlen=1)[0]


def distance_db(a, b):
    return 10 * np.log10(np.max(np.sum((a - b) ** 2, axis=-1) / np.sum(b**2, axis=-1)))


@pytest.mark.parametrize("present", [*((e,) for e in EVERY_LAW), EVERY_LAW], ids=lambda e: e[0].effect)
def test_agrees_with_an_independent_integrator(present):
    """The same equations by Runge-Kutta until they repeat themselves, every law alone and all seven coupled.

    A lost harmonic, a wrong sign of a velocity, a memory that is not periodic: all far above -65 dB.
    """
    u = multisine()[0]
    system = make_system(*present)
    r = len(present)
    lines = np.arange(3, 40)
    amplitude = 2 / SIZE * np.fft.rfft(u)[:, lines]

    def rate(time, state):
        x, v, z = state[:2], state[2:4], state[4:]
        drive = np.real(amplitude @ np.exp(2j * np.pi * lines * FS / SIZE * time))
        d, dv = system.incidence.T @ x, system.incidence.T @ v
        force, dz = np.empty(r), np.zeros(r)
        for e, effect in enumerate(present):
            p, q = effect.constants()
            if effect.law == laws.HYSTERESIS:
                force[e] = p * z[e]
                dz[e] = dv[e] * (1 - 0.5 * (1 + np.sign(dv[e] * z[e])) * (z[e] / q) ** 2)
            else:
                force[e] = laws.force(effect.law, p, q, d[e], dv[e], 0.0, 0.0)[0]
        a = np.linalg.solve(
            system.mass, drive - system.damping @ v - system.stiffness @ x - system.incidence @ force
        )
        return np.concatenate([v, a, dz])

    # The steady state itself as the beginning: one period later the integrator must be where it was.
    solved = simulate_steady(system, u[None], FS, "band-limited")
    assert solved.settled
    xs = [simulate_steady(make_system(*present, output=o), u[None], FS, "band-limited").y[0] for o in ("m", "m/s")]
    z0 = [
        solved.force[0, e, 0] / effect.stiffness if effect.law == laws.HYSTERESIS else 0.0
        for e, effect in enumerate(present)
    ]
    t = np.arange(SIZE + 1) / FS
    begin = np.concatenate([xs[0][:, 0], xs[1][:, 0], z0])
    solution = solve_ivp(rate, (0, t[-1]), begin, t_eval=t, rtol=1e-7, atol=1e-10, max_step=2e-3)
    assert distance_db(solved.y[0], solution.y[:2, :-1]) < -65
    linear = simulate_steady(make_system(), u[None], FS, "band-limited").y[0]
    assert distance_db(linear, solution.y[:2, :-1]) > -30  # the elements do act


@pytest.mark.parametrize("output", ["m", "m/s", "m/s^2"])
@pytest.mark.parametrize("hold", ["band-limited", "zero-order"])
@pytest.mark.parametrize("present", [(), (EVERY_LAW[0], EVERY_LAW[1])], ids=["linear", "springs"])
def test_time_stepping_approaches_it(present, hold, output):
    """Newmark's error falls with the square of its step, towards this solution and no other.

    A hold half a sample off, or a mean that displacements have and velocities have not, would leave a rest.
    """
    u = multisine()[0]
    solved = simulate_steady(make_system(*present, output=output), u[None], FS, hold, oversampling=4)
    errors = [distance_db(stepped(make_system(*present, output=output), u, s, hold), solved.y[0]) for s in (8, 32)]
    assert errors[1] < -70
    assert errors[0] - errors[1] == pytest.approx(20 * np.log10(16), abs=2.0)


def test_actuators_and_sensors_act_in_steady_state():
    """An actuator's loop that begins anew each period, or a sensor applied to refined samples, shows here."""
    there = (
        ActuatorHysteresis(("1",), 0.5, 20.0),
        ActuatorSaturation(("2",), 25.0),
        SensorDelay(("1",), 3.3e-3),
        SensorQuantisation(("2",), 1e-3),
        EVERY_LAW[0],
    )
    system = make_system(*there)
    u = multisine()
    solved = simulate_steady(system, u, FS, "band-limited")
    bare = simulate_steady(replace(system, sensors=((), ())), u, FS, "band-limited")
    np.testing.assert_array_equal(solved.y[0, 1], 1e-3 * np.round(bare.y[0, 1] / 1e-3))
    fine = replace(system, sensors=(system.sensors[0], ()))
    assert distance_db(simulate_steady(fine, u, FS, "band-limited").y[0], stepped(fine, u[0], 32)) < -70


@settings(deadline=None, max_examples=15)
@given(
    stiff=st.floats(1e3, 1e5),
    gap=st.floats(-1e-3, 3e-3),
    friction=st.floats(0.1, 10.0),
    scale=st.floats(1e-3, 1.0),
    cubic=st.floats(1e5, 1e10),
    seed=st.integers(0, 5),
)
def test_what_it_calls_settled_obeys_the_equations(stiff, gap, friction, scale, cubic, seed):
    """Whatever the elements: either the forces balance at every line, or the result says that they do not."""
    present = (
        effects.OneSidedStop(("2", "ground"), stiff, gap),
        effects.CoulombFriction(("1", "ground"), friction, scale),
        effects.CubicStiffness(("1", "2"), cubic),
    )
    system = make_system(*present)
    u = multisine(seed=seed)
    solved = simulate_steady(system, u, FS, "band-limited", oversampling=2)
    assert np.isfinite(solved.residual).all() or not solved.settled
    if not solved.settled:
        return
    Y = np.fft.rfft(solved.y[0]) / SIZE
    f = np.array([e.over_period(d, v) for e, d, v in zip(present, *_motion(solved), strict=True)])
    F = np.fft.rfft(f)[:, : SIZE // 2] / (2 * SIZE)
    jw = 2j * np.pi * np.arange(SIZE // 2) * FS / SIZE
    Z = system.stiffness + jw[:, None, None] * system.damping + jw[:, None, None] ** 2 * system.mass
    taken = np.einsum("fij,jf->if", Z, Y[:, :-1]) + system.incidence @ F
    rest = taken - np.fft.rfft(u[0])[:, :-1] / SIZE
    # At the highest lines the recorded samples hold folded harmonics too.
    assert np.abs(rest[:, : SIZE // 8]).max() < 1e-3 * np.abs(np.fft.rfft(u[0]) / SIZE).max()


def _motion(solved):
    d = solved.motion[0]
    lines = np.fft.rfft(d)
    jw = 2j * np.pi * np.arange(lines.shape[-1]) * FS / SIZE
    jw[-1] = 0.0
    return d, np.fft.irfft(jw * lines, n=d.shape[-1])


def test_a_guess_and_company_do_not_change_the_answer():
    """Experiments are solved together for speed alone; an answer that hung on the others would not repeat."""
    system = make_system(EVERY_LAW[0], EVERY_LAW[6])
    u = multisine(4)
    together = simulate_steady(system, u, FS, "band-limited", oversampling=1)
    alone = [simulate_steady(system, u[[e]], FS, "band-limited", oversampling=1).y[0] for e in range(4)]
    np.testing.assert_allclose(together.y, alone, atol=1e-7 * np.abs(together.y).max())
    again = simulate_steady(system, u, FS, "band-limited", oversampling=1, guess=together.motion)
    np.testing.assert_allclose(again.y, together.y, atol=1e-7 * np.abs(together.y).max())
    assert again.iterations.max() <= 3


@pytest.mark.parametrize("present", [EVERY_LAW[:1], EVERY_LAW[3:6]], ids=["cubic", "stop and friction"])
def test_the_number_of_threads_changes_no_bit(present):
    """Experiments are solved in threads; each must come out as if it had been solved alone after the others."""
    system, u = make_system(*present), multisine(7)
    one = simulate_steady(system, u, FS, "band-limited")
    for threads in (1, 2, 5):
        with ThreadPoolExecutor(threads) as pool:
            other = simulate_steady(system, u, FS, "band-limited", each=pool.map)
        np.testing.assert_array_equal(other.y, one.y)
        np.testing.assert_array_equal(other.iterations, one.iterations)


@pytest.mark.parametrize("effect", EVERY_LAW, ids=lambda e: e.effect)
def test_tangent_is_the_derivative_of_the_periodic_force(effect, rng):
    """Newton with a wrong slope would creep or stall; checked by differences, hysteresis with its memory."""
    t = 2 * np.pi * np.arange(SIZE) / SIZE
    d = 2e-3 * np.sin(t + 0.1) + 1e-3 * np.cos(3 * t)
    v = 0.2 * np.cos(t)
    dd, dv = 1e-9 * np.sin(2 * t + 1), 1e-7 * np.cos(2 * t)
    change = effect.over_period(d + dd, v + dv) - effect.over_period(d - dd, v - dv)
    f = effect.over_period(d, v)
    found = force_change(effect.law, *effect.constants(), d, v, f, dd, dv)
    np.testing.assert_allclose(2 * found, change, atol=2e-4 * np.abs(change).max())


def test_no_steady_state_is_said():
    """A spring that throws the masses out must come back marked, soon, and a growing structure must be refused."""
    away = make_system(effects.CubicStiffness(("1", "2"), -1e11))
    solved = simulate_steady(away, multisine(rms=200.0), FS, "band-limited")
    assert not solved.settled
    with pytest.raises(SimulationError, match=r"unstable: a motion at .* Hz grows"):
        simulate_steady(make_system(effects.Damping(("1", "ground"), -150.0)), multisine(), FS, "band-limited")


def test_a_free_structure_is_held_by_its_nonlinear_element():
    """Nothing linear holds the mean of a free mass: a cubic spring and a quadratic one between them do."""
    free = Lumped((PointMass("1", 1.0), PointMass("2", 2.0)), (Link(("1", "2"), 2e4, 20.0),))
    present = (effects.CubicStiffness(("1", "ground"), 1e7), effects.Damping(("2", "ground"), 40.0))
    system = make_system(*present, model=free)
    u = multisine()
    solved = simulate_steady(system, u, FS, "band-limited")
    assert solved.settled
    assert distance_db(solved.y[0], stepped(system, u[0], 16, periods=60)) < -60


@given(st.integers(4, 40), st.integers(4, 40), st.integers(0, 9))
def test_resampling_keeps_what_both_can_hold(old, new, seed):
    """A Nyquist line taken double or not at all is the classical slip."""
    lines = np.zeros(min(old, new) // 2 + 1, complex)
    rng = np.random.default_rng(seed)
    kept = (min(old, new) - 1) // 2 + 1
    lines[:kept] = rng.standard_normal(kept) + 1j * rng.standard_normal(kept)
    a, b = (np.fft.irfft(lines * n, n=n) for n in (old, new))
    np.testing.assert_allclose(resampled(a, new), b, atol=1e-12)
