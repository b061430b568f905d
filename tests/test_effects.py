"""Laws of the effects: what the contract's table says, and what the time stepping relies on."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from creak.errors import ConfigurationError
from creak.mechanics import effects, electronics, laws
from creak.mechanics.vocabulary import VOCABULARY

PLACE = ("1", "ground")
RESTORING = [
    effects.CubicStiffness(PLACE, 3.0),
    effects.QuadraticStiffness(PLACE, -2.0),
    effects.Clearance(PLACE, 5.0, 0.4),
    effects.OneSidedStop(PLACE, 5.0, -0.3),
    effects.CoulombFriction(PLACE, 2.0, 0.5),
    effects.QuadraticDamping(PLACE, 1.5),
    effects.Hysteresis(PLACE, 4.0, 0.7),
]
TABLE = {  # the contract's relations, written out again
    "cubic_stiffness": lambda d, v: 3.0 * d**3,
    "quadratic_stiffness": lambda d, v: -2.0 * d**2,
    "clearance": lambda d, v: 5.0 * np.sign(d) * np.maximum(np.abs(d) - 0.4, 0),
    "one_sided_stop": lambda d, v: 5.0 * np.maximum(d + 0.3, 0),
    "coulomb_friction": lambda d, v: 2.0 * np.tanh(v / 0.5),
    "quadratic_damping": lambda d, v: 1.5 * v * np.abs(v),
}
compiling = settings(deadline=None)  # the first call compiles
number = st.floats(-2, 2).map(lambda value: round(value, 6))


def test_names_and_parameters_are_those_of_the_contract():
    """A renamed effect or parameter would break every model file."""
    assert {name: kind.parameter_names() for name, kind in VOCABULARY.items()} == {
        "stiffness": ("coefficient",),
        "damping": ("coefficient",),
        "mass": ("coefficient",),
        "cubic_stiffness": ("coefficient",),
        "quadratic_stiffness": ("coefficient",),
        "clearance": ("stiffness", "gap"),
        "one_sided_stop": ("stiffness", "gap"),
        "coulomb_friction": ("force", "velocity"),
        "quadratic_damping": ("coefficient",),
        "hysteresis": ("stiffness", "yield_displacement"),
        "resonator": ("mass", "frequency_hz", "damping_ratio"),
        "actuator_gain": ("gain",),
        "actuator_delay": ("delay",),
        "actuator_saturation": ("limit",),
        "actuator_dead_zone": ("width",),
        "actuator_hysteresis": ("share", "yield_input"),
        "sensor_gain": ("gain",),
        "sensor_delay": ("delay",),
        "sensor_clipping": ("limit",),
        "sensor_quantisation": ("step",),
    }


@pytest.mark.parametrize("effect", [e for e in RESTORING if e.effect in TABLE], ids=lambda e: e.effect)
@compiling
@given(d=number, v=number)
def test_force_is_the_table_s(effect, d, v):
    """A wrong sign, a gap on one side only, parameters in the wrong order."""
    force = effect.over_period([d, -d], [v, -v])
    np.testing.assert_allclose(force, TABLE[effect.effect](np.array([d, -d]), np.array([v, -v])), atol=1e-12)


@pytest.mark.parametrize("effect", RESTORING, ids=lambda e: e.effect)
@compiling
@given(d=number, v=number, d0=number, z0=st.floats(-0.6, 0.6))
def test_slopes_are_derivatives(effect, d, v, d0, z0):
    """A wrong slope leaves Newton's method slow, or without an end."""
    p, q = effect.constants()
    step = 1e-6

    def force(d, v):
        return laws.force(effect.law, p, q, d, v, d0, z0)[0]

    _, by_d, by_v, z = laws.force(effect.law, p, q, d, v, d0, z0)
    kinks = [d - 0.4, d + 0.4, d + 0.3, d - d0, z]
    assume(min(map(abs, kinks)) > 1e-3)
    assert by_d == pytest.approx((force(d + step, v) - force(d - step, v)) / (2 * step), abs=1e-5)
    assert by_v == pytest.approx((force(d, v + step) - force(d, v - step)) / (2 * step), abs=1e-5)


@compiling
@given(z0=st.floats(-0.99, 0.99), path=number, share=st.floats(0, 1))
def test_bouc_wen_does_not_depend_on_how_a_path_is_cut(z0, path, share):
    """A step that is not the exact solution would make hysteresis depend on the sampling rate."""
    half = laws.bouc_wen(share * path, z0, 1.0)
    assert laws.bouc_wen(path - share * path, half, 1.0) == pytest.approx(laws.bouc_wen(path, z0, 1.0), abs=1e-12)
    assert abs(half) <= 1.0


def test_bouc_wen_solves_its_equation():
    """The closed solution against the differential equation of the contract, over a loop with reversals."""
    t = np.linspace(0, 2 * np.pi, 4001)
    d = 0.9 * np.sin(t) + 0.5 * np.sin(3 * t)

    def rate(time, z):
        v = 0.9 * np.cos(time) + 1.5 * np.cos(3 * time)
        return v * (1 - 0.5 * (1 + np.sign(v * z)) * (z / 0.7) ** 2)

    expected = solve_ivp(rate, (0, t[-1]), [0.0], t_eval=t, rtol=1e-9, atol=1e-12, max_step=0.002).y[0]
    z, _ = laws.play(d, 0.0, 0.0, 0.7)
    np.testing.assert_allclose(z, expected, atol=1e-6)


@pytest.mark.parametrize("amplitude", [0.01, 0.3, 5.0])
def test_hysteresis_over_a_period_repeats_itself(amplitude):
    """A loop that starts from rest is no steady state: small loops would drift for thousands of periods."""
    t = 2 * np.pi * np.arange(256) / 256
    d = amplitude * (np.sin(t) + 0.7 * np.cos(3 * t)) + 0.6
    once = effects.Hysteresis(PLACE, 4.0, 0.7).over_period(d, np.zeros(256))
    z, _ = laws.play(np.tile(d, 3), d[-1], once[-1] / 4.0, 0.7)
    np.testing.assert_allclose(np.tile(once, 3), 4.0 * z, atol=1e-10)


@compiling
@given(delay=st.floats(-40, 40), size=st.sampled_from([63, 64]), line=st.integers(1, 31))
def test_delay_shifts_every_line_exactly(delay, size, line):
    """Linear interpolation, or a shift the wrong way round, would show as gain and as an advance."""
    n = np.arange(size)
    x = np.cos(2 * np.pi * line * n / size + 0.3) + 0.2
    shifted = electronics.delayed(x, delay / 10.0, sample_rate=10.0)
    np.testing.assert_allclose(shifted, np.cos(2 * np.pi * line * (n - delay) / size + 0.3) + 0.2, atol=1e-9)


def test_electronics_follow_the_table():
    """Saturation against dead zone, rounding against truncation, the share of a hysteretic amplifier."""
    u = np.array([-2.0, -0.6, 0.0, 0.6, 2.0])

    def through(effect):
        return effect.apply(u, 1.0)[0]

    np.testing.assert_allclose(through(electronics.ActuatorGain(("1",), 1.1)), 1.1 * u)
    np.testing.assert_allclose(through(electronics.ActuatorSaturation(("1",), 1.0)), [-1, -0.6, 0, 0.6, 1])
    np.testing.assert_allclose(through(electronics.ActuatorDeadZone(("1",), 0.5)), [-1.5, -0.1, 0, 0.1, 1.5])
    np.testing.assert_allclose(through(electronics.SensorGain(("1",), 0.9)), 0.9 * u)
    np.testing.assert_allclose(through(electronics.SensorClipping(("1",), 0.6)), [-0.6, -0.6, 0, 0.6, 0.6])
    np.testing.assert_allclose(through(electronics.SensorQuantisation(("1",), 0.5)), [-2, -0.5, 0, 0.5, 2])
    soft = electronics.ActuatorHysteresis(("1",), 0.25, 1e9)  # never yields: all of it passes
    np.testing.assert_allclose(through(soft), u, atol=1e-9)
    first, memory = electronics.ActuatorHysteresis(("1",), 1.0, 0.5).apply(u, 1.0)
    second, _ = electronics.ActuatorHysteresis(("1",), 1.0, 0.5).apply(u, 1.0, memory)
    assert first[0] == pytest.approx(-0.5 * math.tanh(4))  # the first path leads from 0 to -2
    np.testing.assert_allclose(np.concatenate([first, second]), laws.play(np.tile(u, 2), 0, 0, 0.5)[0])


@pytest.mark.parametrize(
    ("make", "key", "shown"),
    [
        (lambda: effects.Clearance(PLACE, -1.0, 0.1), "stiffness", "-1.0"),
        (lambda: effects.Clearance(PLACE, 1.0, -0.1), "gap", "-0.1"),
        (lambda: effects.CoulombFriction(PLACE, 1.0, 0.0), "velocity", "0.0"),
        (lambda: effects.CubicStiffness(PLACE, math.nan), "coefficient", "nan"),
        (lambda: effects.CubicStiffness(("1",), 1.0), "at", "['1']"),
        (lambda: effects.CubicStiffness(("ground", "1"), 1.0), "at", "['ground', '1']"),
        (lambda: effects.Resonator(("1", "2"), 1.0, 1.0, 0.1), "at", "['1', '2']"),
        (lambda: electronics.SensorGain(PLACE, 1.0), "at", "['1', 'ground']"),
        (lambda: electronics.ActuatorHysteresis(("1",), 1.5, 1.0), "share", "1.5"),
    ],
)
def test_refuses_what_has_no_meaning(make, key, shown):
    """Each would otherwise simulate something else than the user meant."""
    with pytest.raises(ConfigurationError) as caught:
        make()
    assert caught.value.key == key
    assert shown in str(caught.value)
