"""Time stepping: against other solutions of the same equations, and where it must stop."""

import sys
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from creak.errors import SimulationError
from creak.mechanics import effects, laws, newmark, newton
from creak.mechanics.electronics import ActuatorHysteresis
from creak.mechanics.newmark import Stepper, choose_substeps
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.records import Node, Rig

sys.path.insert(0, str(Path(__file__).parent / "bench"))
import bench_simulation

FS = 1000.0
SIZE = 512
CHAIN = Lumped(
    masses=(PointMass("1", 1.0), PointMass("2", 0.8)),
    links=(Link(("ground", "1"), 2e4, 30.0), Link(("1", "2"), 3e4, 20.0), Link(("2", "ground"), 1e4, 10.0)),
)


def make_rig(output="m"):
    return Rig("two", FS, SIZE, 1, tuple(range(3, 40)), tuple(Node(name, output, "N") for name in "12"))


def multisine(seed=1, rms=20.0):
    rng = np.random.default_rng(seed)
    spectrum = np.zeros((2, SIZE // 2 + 1), complex)
    spectrum[:, 3:40] = np.exp(2j * np.pi * rng.random((2, 37)))
    u = np.fft.irfft(spectrum)
    return u * rms / np.sqrt(np.mean(u**2, axis=1, keepdims=True))


def last_period(system, u, substeps=1, hold="band-limited", periods=12):
    return deque(Stepper(system, FS, substeps, hold).experiment(u, periods), maxlen=1)[0]


def distance_db(a, b):
    return 10 * np.log10(np.max(np.sum((a - b) ** 2, axis=-1) / np.sum(b**2, axis=-1)))


@pytest.mark.parametrize("output", ["m", "m/s", "m/s^2"])
@pytest.mark.parametrize("substeps", [1, 3])
def test_steady_state_is_the_linear_response_at_the_warped_frequency(output, substeps):
    """Average acceleration turns jw into 2j/h tan(wh/2), exactly; any slip in the recursion breaks this.

    The responses of a displacement sensor follow ``S(w')`` with the warped frequency ``w'``; so do velocity
    and acceleration, which are derived within the same rule.
    """
    u = multisine()
    h = 1 / (FS * substeps)
    w = 2 * np.pi * np.fft.rfftfreq(SIZE, 1 / FS)[:-1]
    system = assemble(CHAIN, make_rig(output))
    S = system.response(np.tan(w * h / 2) * 2 / h / (2 * np.pi))
    expected = np.zeros((2, SIZE // 2 + 1), complex)
    expected[:, :-1] = np.einsum("fij,jf->if", S, np.fft.rfft(u)[:, :-1])
    y = last_period(system, u, substeps)
    np.testing.assert_allclose(y, np.fft.irfft(expected), atol=1e-9 * np.abs(y).max())


@pytest.mark.parametrize("output", ["m", "m/s"])
def test_held_input_is_that_of_the_exact_discretisation(output):
    """A ramp between samples, a hold a sample late, a first jump taken twice: all 10 dB and more away."""
    u = multisine()
    system = assemble(CHAIN, make_rig(output))
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-system.stiffness, -system.damping]])
    A[2:] = np.linalg.solve(system.mass, A[2:])
    B = np.vstack([np.zeros((2, 2)), np.linalg.solve(system.mass, system.inputs)])
    Ad, Bd, *_ = cont2discrete((A, B, np.eye(4), np.zeros((4, 2))), 1 / FS, method="zoh")
    state, expected = np.zeros(4), np.empty((2, 12 * SIZE))
    for i in range(12 * SIZE):
        expected[:, i] = state[:2] if output == "m" else state[2:]
        state = Ad @ state + Bd @ u[:, i % SIZE]
    y = np.hstack(list(Stepper(system, FS, 16, "zero-order").experiment(u, 12)))
    assert distance_db(y, expected) < -75
    np.testing.assert_allclose(y[:, :5], expected[:, :5], atol=1e-3 * np.abs(expected[:, :5]).max())


EVERY_LAW = (
    effects.CubicStiffness(("2", "ground"), 5e8),
    effects.QuadraticStiffness(("1", "ground"), 1e6),
    effects.Clearance(("1", "2"), 4e4, 1e-3),
    effects.OneSidedStop(("2", "ground"), 3e4, 5e-4),
    effects.CoulombFriction(("2", "1"), 5.0, 0.05),
    effects.QuadraticDamping(("1", "ground"), 50.0),
    effects.Hysteresis(("1", "ground"), 2e4, 1e-3),
)


@pytest.mark.parametrize("present", [*((effect,) for effect in EVERY_LAW), EVERY_LAW], ids=lambda e: e[0].effect)
def test_agrees_with_an_independent_integrator(present):
    """The same equations by Runge-Kutta from rest, every law alone and all seven coupled."""
    u = multisine()
    system = assemble(replace(CHAIN, effects=tuple(present)), make_rig())
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

    t = np.arange(SIZE // 2) / FS
    solution = solve_ivp(rate, (0, t[-1]), np.zeros(4 + r), t_eval=t, rtol=1e-7, atol=1e-10, max_step=2e-3)
    y = next(Stepper(system, FS, 32, "band-limited").experiment(u, 1))
    assert distance_db(y[:, : t.size], solution.y[:2]) < -70
    linear = next(Stepper(assemble(CHAIN, make_rig()), FS, 32, "band-limited").experiment(u, 1))
    assert distance_db(linear[:, : t.size], solution.y[:2]) > -30  # the elements do act


@settings(deadline=None, max_examples=60)
@given(
    stiff=st.floats(1e3, 1e9),
    gap=st.floats(-1e-3, 3e-3),
    friction=st.floats(0.1, 1e3),
    scale=st.floats(1e-7, 1.0),
    cubic=st.floats(1e5, 1e13),
    bound=st.floats(1e-6, 1e-2),
    seed=st.integers(0, 5),
)
def test_newton_always_converges_on_dissipative_elements(stiff, gap, friction, scale, cubic, bound, seed):
    """Hard stops and nearly discontinuous friction make a plain Newton iteration jump to and fro for ever."""
    hard = (
        effects.OneSidedStop(("2", "ground"), stiff, gap),
        effects.Clearance(("1", "2"), stiff, abs(gap)),
        effects.CoulombFriction(("1", "ground"), friction, scale),
        effects.CoulombFriction(("2", "1"), friction, scale),
        effects.CubicStiffness(("1", "2"), cubic),
        effects.Hysteresis(("2", "ground"), stiff, bound),
    )
    system = assemble(replace(CHAIN, effects=hard), make_rig())
    y = last_period(system, multisine(seed), periods=1)
    assert np.isfinite(y).all()


def test_step_satisfies_the_equation_of_motion():
    """Newton left early would leave forces that do not balance; checked from the outside, at every sample."""
    element = effects.CubicStiffness(("2", "ground"), 1e10)
    u = multisine()
    x, v, a = (
        last_period(assemble(replace(CHAIN, effects=(element,)), make_rig(unit)), u, periods=2)
        for unit in ("m", "m/s", "m/s^2")
    )
    system = assemble(CHAIN, make_rig())
    force = np.vstack([np.zeros(SIZE), 1e10 * x[1] ** 3])
    rest = system.mass @ a + system.damping @ v + system.stiffness @ x + force - u
    assert np.abs(rest).max() < 1e-8 * np.abs(u).max()
    assert np.abs(force).max() > np.abs(u).max()


@pytest.mark.parametrize(
    ("effect", "named"),
    [
        (effects.QuadraticStiffness(("2", "ground"), -1e9), "quadratic_stiffness at 2-ground"),
        (effects.CubicStiffness(("1", "2"), -1e11), "cubic_stiffness at 1-2"),
    ],
)
def test_failure_names_time_and_element(effect, named):
    """A spring that pushes away must end in an error, not in a recording of infinities or a hang."""
    system = assemble(replace(CHAIN, effects=(effect,)), make_rig())
    with pytest.raises(SimulationError, match=rf"(does not converge|without bound) at \d.* s, {named}"):
        last_period(system, multisine(rms=200.0))


def test_linear_growth_is_found_too():
    """Negative damping has no Newton step that could fail."""
    system = assemble(replace(CHAIN, effects=(effects.Damping(("1", "ground"), -150.0),)), make_rig())
    with pytest.raises(SimulationError, match="grows without bound"):
        last_period(system, multisine())


@pytest.mark.parametrize("noise_db", [-30.0, -50.0, None])
def test_chosen_steps_undercut_the_noise_by_ten_decibels(noise_db):
    """One step a sample would itself be a visible gap; far more than needed would only cost time."""
    system = assemble(replace(CHAIN, effects=(effects.CubicStiffness(("2", "ground"), 1e8),)), make_rig())
    u = multisine()
    choice = choose_substeps(system, FS, "band-limited", u, 8, noise_db)
    reference = last_period(system, u, 256, periods=8)
    limit = (-60.0 if noise_db is None else noise_db) - 10
    assert distance_db(last_period(system, u, choice.substeps, periods=8), reference) < limit
    assert distance_db(last_period(system, u, choice.substeps // 2, periods=8), reference) > limit
    assert choice.error_db == pytest.approx(
        distance_db(last_period(system, u, choice.substeps, periods=8), reference), abs=1.0
    )


def test_actuator_hysteresis_goes_on_from_period_to_period():
    """Begun anew with every period, the loop would never close and the steady periods would repeat a transient."""
    element = ActuatorHysteresis(("1",), 0.5, 20.0)
    system = assemble(replace(CHAIN, effects=(element,)), make_rig())
    u = multisine()
    periods = list(Stepper(system, FS, 1, "band-limited").experiment(u, 14))
    np.testing.assert_allclose(periods[-1], periods[-2], atol=1e-9 * np.abs(periods[-1]).max())
    z, _ = laws.play(np.tile(u[0], 14), 0.0, 0.0, 20.0)
    acting = np.vstack([0.5 * u[0] + 0.5 * z[-SIZE:], u[1]])
    expected = last_period(assemble(CHAIN, make_rig()), acting, periods=14)
    np.testing.assert_allclose(periods[-1], expected, atol=1e-9 * np.abs(expected).max())


def test_cached_code_is_out_of_date_when_a_callee_s_file_is():
    """numba alone would go on with an old law inside the cached time stepping after the law was changed."""
    law, solve, march = (
        kernel._cache._cache_file._source_stamp for kernel in (laws.force, newton.solve, newmark._march)
    )
    assert len(law) == 1
    assert set(law) < set(solve) < set(march)


def test_steps_as_a_newmark_in_plain_numpy_does():
    """Newton on the forces of the elements alone, against Newton on all coordinates, as the benchmark times it."""
    rig, system, u = bench_simulation.study(1e9)
    samples = 600
    forces = (system.inputs @ u[0]).T[:samples]
    args = system.mass, system.damping, system.stiffness, system.incidence[:, 0], 1e9, forces, 1 / rig.sample_rate
    x = bench_simulation.numpy_newmark(*args)
    y = next(Stepper(system, rig.sample_rate, 1, rig.hold).experiment(u[0], 1))
    # The peer stops at a rest of 1e-10 N, of some 100 N.
    np.testing.assert_allclose(y[:, :samples], (x @ system.outputs.T).T, atol=1e-9 * np.abs(x).max())
