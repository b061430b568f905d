"""Recordings with one period an experiment: noise from quiet lines, and structures that must not vanish."""

from dataclasses import replace

import numpy as np
import pytest

from creak.errors import MeasurementError
from creak.gap.diagnose import diagnose
from creak.gap.hypothesis import Hypothesis, plausible
from creak.gap.periodic import gather
from creak.gap.quiet import quiet_variance
from creak.mechanics.effects import GROUND, CubicStiffness, Mass, QuadraticDamping, QuadraticStiffness, Stiffness
from creak.mechanics.steady import simulate_steady
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.records import Excitation, Frame, Node, Rig, Run
from gap_recordings import CHAIN

ODD = Rig("one", 300.0, 1024, 0, tuple(range(11, 221, 2)), (Node("1", "m", "N"),), grid="odd")
TRUTH = Lumped(
    (PointMass("1", 1.0),),
    (Link(("1", GROUND), 6e4, 30.0),),
    (CubicStiffness(("1", GROUND), 5e8), QuadraticDamping(("1", GROUND), 4.0)),
)


def test_noise_is_what_the_quiet_lines_hold():
    """White noise of known variance, on an odd grid with odd distortion beside it: within its own scatter."""
    rng = np.random.default_rng(1)
    E, L = 6, ODD.period_samples // 2 + 1
    Y = np.sqrt(0.5) * (rng.standard_normal((E, L, 1)) + 1j * rng.standard_normal((E, L, 1)))
    Y[:, 1::2] += 30.0  # excited, and odd harmonics above the band
    variance, degrees = quiet_variance(ODD, Y)
    assert np.isinf(variance[0]).all()
    assert degrees == 6 * 24
    # Each is a mean of 144 exponential variables; 512 of them, neighbours shared: within 4.5 deviations of 1.
    np.testing.assert_allclose(variance[1:], 1.0, atol=4.5 / np.sqrt(degrees))


def test_lines_of_little_noise_do_not_decide_alone():
    """A resonance in the noise: the whole is what the quiet lines hold, and no line counts twice the mean."""
    rng = np.random.default_rng(5)
    E, L = 8, ODD.period_samples // 2 + 1
    size = 0.01 + 3 * np.exp(-(((np.arange(L) - 110) / 40) ** 2))
    Y = size[:, None] * np.sqrt(0.5) * (rng.standard_normal((E, L, 1)) + 1j * rng.standard_normal((E, L, 1)))
    variance, _ = quiet_variance(ODD, Y)
    of_even = np.mean(np.abs(Y[:, 2::2]) ** 2)
    assert variance[1:].mean() == pytest.approx(of_even, rel=0.02)  # the lines at the ends are pooled with others
    assert variance[1:].min() > 0.49 * variance[1:].mean()
    assert variance[110] > 3 * variance[400]


def test_one_period_on_a_full_grid_tells_no_noise():
    full = replace(ODD, lines=tuple(range(11, 221)), grid="full")
    with pytest.raises(MeasurementError, match="1 steady period an experiment, so its noise is not known"):
        quiet_variance(full, np.ones((2, 513, 1), complex))


def test_what_is_not_periodic_is_refused_with_what_does_not_repeat():
    """Kills an answer on noise excitation, where all that is measured would pass for noise."""
    rng = np.random.default_rng(4)
    run = Run("one", ODD, 2, 0, Excitation("measured"), "import")
    frames = [Frame(0, 0, p, 0, *rng.standard_normal((2, 1, ODD.period_samples))) for p in range(2)]
    with pytest.raises(MeasurementError, match="realisation 0, experiment 0 do not repeat every 1024 samples"):
        gather(run, frames)


def test_a_structure_must_not_vanish():
    """Kills actuators and sensors that pass nothing beside a structure of nothing, which explain every motion."""
    mass, spring = (Mass, ("1", GROUND)), (Stiffness, ("1", GROUND))
    assert plausible(CHAIN, Hypothesis(linear=((mass, -0.5), (spring, 1e4))))
    assert not plausible(CHAIN, Hypothesis(linear=((mass, -0.999),)))
    assert not plausible(CHAIN, Hypothesis(linear=((spring, -2.1e4),)))


def from_the_best_linear_model(truth, noise_db):
    """Diagnose six realisations of one period, an offset in them; the model is a fit to the mean response."""
    u = np.concatenate([realisation(ODD, 40.0, 3, m) for m in range(6)])
    y = simulate_steady(assemble(truth, ODD), u, ODD.sample_rate, ODD.hold).y
    rng = np.random.default_rng(2)
    y = y + 10 ** (noise_db / 20) * y.std() * rng.standard_normal(y.shape) + 2 * y.std()
    run = Run("one", ODD, 1, 0, Excitation("multisine", rms=40.0, seed=3), "simulated")
    data = gather(run, [Frame(m, 0, 0, 0, u[m], y[m]) for m in range(6)])
    lines = list(ODD.lines)
    s = 2j * np.pi * ODD.frequencies
    stiffness = np.mean(np.fft.rfft(u)[..., lines] / np.fft.rfft(y)[..., lines], axis=(0, 1))
    terms = np.stack([np.ones(len(s)), s, s**2], axis=1) / stiffness[:, None]
    both = np.concatenate([terms.real, terms.imag])
    k, c, m = np.linalg.lstsq(both, np.repeat([1.0, 0.0], len(s)), rcond=None)[0]
    return diagnose(ODD, Lumped((PointMass("1", m),), (Link(("1", GROUND), k, c),)), data)


def test_two_effects_at_one_mass_beside_a_linear_part_that_is_off():
    """As measured on circuits and single masses: the best linear model, one period, a second effect far weaker.

    Kills a search that ends at the first law, and one that is misled by an actuator that passes nothing.
    """
    found = from_the_best_linear_model(TRUTH, -50)
    assert found.verdict == "explained"
    causes = {cause.effect: cause for cause in found.causes}
    assert set(causes) == {"cubic_stiffness", "quadratic_damping"}
    assert causes["cubic_stiffness"].parameters["coefficient"] == pytest.approx(5e8, rel=0.02)
    assert causes["quadratic_damping"].parameters["coefficient"] == pytest.approx(4.0, rel=0.1)


def test_even_distortion_that_passes_for_noise_is_still_named():
    """Kills a search that ends where noise seems to be reached: the even lines that tell it hold the law."""
    springs = (CubicStiffness(("1", GROUND), 5e8), QuadraticStiffness(("1", GROUND), 8e5))
    found = from_the_best_linear_model(replace(TRUTH, effects=springs), -60)
    causes = {cause.effect: cause for cause in found.causes}
    assert set(causes) == {"cubic_stiffness", "quadratic_stiffness"}
    assert causes["quadratic_stiffness"].parameters["coefficient"] == pytest.approx(8e5, rel=0.05)
    assert found.gap.after_db < found.gap.noise_db - 3  # which was distortion for the most part
