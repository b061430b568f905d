"""The paper's SISO method and its network of masses: against the equations, and against the service itself."""

import doctest
from functools import reduce

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import creak.mechanics.networked
import creak.robust
from conftest import make_rig, random_spectra
from creak.errors import MeasurementError
from creak.mechanics.networked import networked
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.network import estimate
from creak.records import Scope
from creak.robust import robust_bla
from creak.statistics import Sums


@pytest.mark.parametrize("module", [creak.robust, creak.mechanics.networked])
def test_the_examples_in_the_docstrings_hold(module):
    assert doctest.testmod(module).failed == 0


def test_streaming_sums_of_one_input_give_the_robust_method(rng):
    """Kills a wrong factor among M, M - 1, P and P - 1: two independent roads to the same variances."""
    rig = make_rig(1)
    M, P = 7, 3
    spectra = random_spectra(rng, rig, M, P, noise=0.1, distortion=0.2)
    bla = robust_bla(spectra[:, 0, :, :, 0], spectra[:, 0, :, :, 1])
    sums = reduce(lambda a, b: a + b, (Sums.of(s, 1) for s in spectra))
    got = estimate(rig, sums, Scope.RUN, 0, M - 1).spectra
    np.testing.assert_allclose(bla.G, sums.S[:, 0, 0], rtol=1e-12)
    np.testing.assert_allclose(bla.output_noise, got.noise[:, 0], rtol=1e-9)
    np.testing.assert_allclose(bla.total, sums.spread[:, 0, 0] / (M * (M - 1)), rtol=1e-9)


@given(st.integers(2, 5), st.integers(2, 5), st.integers(0, 2**31), st.floats(0.1, 10))
def test_laws_of_the_robust_method(M, P, seed, gain):
    """Kills a variance that depends on the order, the mean response, or forgets the square of a gain."""
    rng = np.random.default_rng(seed)
    U = np.exp(2j * np.pi * rng.random((M, 6)))
    Y = rng.standard_normal((M, P, 6)) + 1j * rng.standard_normal((M, P, 6))
    base = robust_bla(U, Y)
    shuffled = robust_bla(U[::-1], Y[::-1, ::-1])
    scaled = robust_bla(U, gain * (Y + 3 * U[:, None]))
    np.testing.assert_allclose(scaled.G, gain * (base.G + 3), rtol=1e-9)
    for name in ("total", "noise", "output_noise", "nonlinear"):
        np.testing.assert_allclose(getattr(shuffled, name), getattr(base, name), rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(getattr(scaled, name), gain**2 * getattr(base, name), rtol=1e-6, atol=1e-12)


def test_a_linear_system_has_as_much_total_as_noise_variance(rng):
    """Kills a factor 1/(M P (P - 1)) in (21), the noise of one G[m] and not of G: M times too high."""
    M, P, F = 20, 4, 2000
    U = np.exp(2j * np.pi * rng.random((M, F)))
    noise = (rng.standard_normal((M, P, F)) + 1j * rng.standard_normal((M, P, F))) / np.sqrt(2)
    bla = robust_bla(U, 2 * U[:, None] + 0.1 * noise)
    assert abs(bla.total.mean() / bla.noise.mean() - 1) < 0.02  # its deviation is 0.6 %
    assert abs(bla.output_noise.mean() / 0.01 - 1) < 0.02


def test_what_one_realisation_or_period_does_not_carry_is_nan():
    U = np.ones((1, 3))
    alone = robust_bla(U, np.ones((1, 2, 3)))
    assert np.isnan(alone.total).all()
    assert not np.isnan(alone.noise).any()
    once = robust_bla(np.ones((2, 3)), np.ones((2, 1, 3)))
    assert np.isnan(once.noise).all()
    assert not np.isnan(once.total).any()


@pytest.mark.parametrize(
    ("U", "Y", "words"),
    [
        (np.ones((2, 3)), np.ones((2, 3)), ["Y", "(2, 3)"]),
        (np.ones((2, 4)), np.ones((2, 2, 3)), ["U", "(2, 4)", "(2, 3)"]),
        (np.zeros((2, 3)), np.ones((2, 2, 3)), ["U", "line 0", "realisation 0"]),
    ],
)
def test_arrays_that_do_not_fit_are_named(U, Y, words):
    with pytest.raises(MeasurementError) as caught:
        robust_bla(U, Y)
    assert all(word in str(caught.value) for word in words)


def test_the_papers_three_masses_as_a_network():
    """(3a)-(3c) written out as the paper has them, and S as the inverse of Z."""
    m, k, c = (1.0, 0.8, 1.2), (2e4, 3.5e4, 5e4, 8e4), (8.0, 7.0, 6.0, 5.0)
    names = ("ground", "1", "2", "3", "ground")
    links = tuple(Link((names[i], names[i + 1]), k[i], c[i]) for i in range(4))
    body = Lumped(tuple(PointMass(str(i + 1), m[i]) for i in range(3)), links).body()
    f = np.array([0.0, 5.0, 20.0, 99.0])
    got = networked(body.mass, body.damping, body.stiffness, f)
    p = 2j * np.pi * f
    below = [m[i] * p**2 + (c[i] + c[i + 1]) * p + k[i] + k[i + 1] for i in range(3)]
    zero = np.zeros(4)
    expected = np.array(
        [
            [zero, (k[1] + c[1] * p) / below[0], zero],
            [(k[1] + c[1] * p) / below[1], zero, (k[2] + c[2] * p) / below[1]],
            [zero, (k[2] + c[2] * p) / below[2], zero],
        ]
    ).transpose(2, 0, 1)
    np.testing.assert_allclose(got.G_y, expected, rtol=1e-12)
    for i in range(3):
        np.testing.assert_allclose(got.G_u[:, i, i], 1 / below[i], rtol=1e-12)
    w = 2 * np.pi * f[:, None, None]
    Z = body.stiffness + 1j * w * body.damping - w**2 * body.mass
    np.testing.assert_allclose(got.S, np.linalg.inv(Z), rtol=1e-10)


def test_matrices_that_do_not_fit_are_named():
    with pytest.raises(MeasurementError, match="damping: shape"):
        networked(np.eye(2), np.eye(3), np.eye(2), np.array([1.0]))
    with pytest.raises(MeasurementError, match=r"frequencies\[0\]"):
        networked(np.eye(1), np.zeros((1, 1)), np.zeros((1, 1)), np.array([0.0]))
