"""Significance: laws of the combinations, and rates on linear structures that stay inside their bounds."""

from decimal import Decimal, localcontext

import numpy as np
import pytest
import scipy.special
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.bench_calibration import power, rates
from conftest import make_rig, random_spectra
from creak.codec import spectrum_json
from creak.significance import octaves, pooled_p_value, q_values, variance_ratio_p_values
from test_network import CHAIN, chain_spectra, chain_stiffness, run_of

P_VALUES = st.lists(st.floats(0, 1), min_size=1, max_size=40)


@settings(deadline=None)
@given(st.integers(1, 1200), st.integers(1, 1200), st.integers(1, 70), st.integers(0, 2**31))
def test_p_values_of_variance_ratios_are_those_of_scipy(free, other_free, count, seed):
    """Kills a term too many or too few, and a tile that is not full; scipy itself loses digits far out."""
    rng = np.random.default_rng(seed)
    x = free * 10 ** rng.uniform(-3, 3, count)
    y = rng.chisquare(2 * other_free, count)
    p = variance_ratio_p_values(x, y, float(free), float(other_free))
    expected = scipy.special.fdtrc(2 * free, 2 * other_free, (x / free) / (y / other_free))
    np.testing.assert_allclose(p, expected, rtol=1e-9, atol=1e-100)


@settings(deadline=None, max_examples=40)
@given(st.integers(1, 600), st.integers(1, 400), st.floats(-3, 3))
def test_p_values_of_variance_ratios_are_exact_down_to_the_smallest_numbers(free, other_free, size):
    """Kills an overflow, or an underflow, on the way to 1e-300; against sums of sixty digits."""
    x, y = free * 10**size, float(other_free)
    with localcontext(prec=60):
        a, b = Decimal(x) / (Decimal(x) + Decimal(y)), Decimal(y) / (Decimal(x) + Decimal(y))
        terms, expected = Decimal(1), Decimal(1)
        for j in range(1, free):
            terms *= a * (other_free + j - 1) / j
            expected += terms
        expected *= b**other_free
    p = variance_ratio_p_values(np.array([x]), np.array([y]), float(free), float(other_free))
    np.testing.assert_allclose(p, float(expected), rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize(("free", "other_free"), [(3, 4), (900, 400)])
def test_p_values_where_nothing_stands_against_something(free, other_free):
    """Kills a division by zero that spreads; without noise to compare with there is no test."""
    x, y = np.array([0.0, 1.0, 0.0]), np.array([1.0, 0.0, 0.0])
    np.testing.assert_array_equal(variance_ratio_p_values(x, y, float(free), float(other_free)), [1, 0, np.nan])


@settings(deadline=None)  # times are not what is tested, on a machine that others use too
@given(P_VALUES)
def test_q_values_are_those_of_scipy(p):
    """Kills a step-down for a step-up, a rank that counts from 0, a q above 1."""
    for dependent, method in ((False, "bh"), (True, "by")):
        expected = scipy.stats.false_discovery_control(p, method=method)
        np.testing.assert_allclose(q_values(np.array(p), dependent=dependent), expected, rtol=1e-12, atol=1e-300)


@settings(deadline=None)
@given(P_VALUES, st.integers(0, 5))
def test_lines_without_a_test_neither_have_nor_change_a_q_value(p, missing):
    """Kills a NaN that is counted among the tests: it would cost power, or spread to all of them."""
    wide = np.concatenate((np.full(missing, np.nan), p)).reshape(-1, 1)
    q = q_values(wide)
    assert np.isnan(q[:missing]).all()
    np.testing.assert_array_equal(q[missing:, 0], q_values(np.array(p)))


@settings(deadline=None)
@given(st.lists(st.integers(1, 5000), min_size=1, max_size=60, unique=True))
def test_octaves_are_all_lines_once_and_no_band_is_wider(lines):
    """Kills a highest line that rounding loses, and a band of nothing."""
    frequency = np.sort(np.array(lines)) * 0.61
    bands = octaves(frequency)
    np.testing.assert_array_equal(np.concatenate([frequency[band] for band in bands]), frequency)
    for band in bands:
        assert 0 < frequency[band][-1] <= 2.000001 * frequency[band][0]


@pytest.mark.parametrize(("n", "q", "network"), [(3, 3, None), (3, 2, None), (5, 2, None)])
def test_lines_of_the_classical_analysis_are_uniform_whether_square_or_tall(n, q, network):
    """Kills d = n for a tall response matrix: 5 nodes and 2 inputs fit 2 parameters at each node, not 5."""
    rng = np.random.default_rng(5)
    p = []
    for _ in range(60):
        rig = make_rig(n, q, lines=range(2, 32), network=network)
        p.append(run_of(rig, random_spectra(rng, rig, 3, 2))[1].spectra.classical_p_value)
    p = np.array(p)
    for node in range(n):
        assert scipy.stats.kstest(p[:, :, node].ravel(), "uniform").pvalue > 1e-4


def test_rates_of_linear_recordings_lie_inside_their_bounds():
    """The benchmark on a smaller scale, 220 recordings, fixed seeds.

    Kills wrong degrees of freedom anywhere. Bounds at 0.9999 of 18 rates: by chance one seed in 500 fails.
    """
    for kind, rows in rates(220).items():
        for row in rows:
            allowed = {"inside"} if kind == "white sensor noise" else {"inside", "below"}
            assert row["where"] in allowed, (kind, row)


def test_detection_grows_with_distortion_and_discoveries_stay_true():
    """Kills a test without power, and false discoveries beyond the set share (5 %, here at most 5 % + 3 sigma)."""
    found = power((-12.0, -6.0, 0.0, 6.0), recordings=40)
    node = [(row["node"] < 0.001).mean() for row in found.values()]
    line = [(row["line"] < 0.001).mean() for row in found.values()]
    assert node == sorted(node)
    assert line == sorted(line)
    assert node[2] == 1.0
    assert line[3] > 0.9
    assert found[6.0]["false discoveries"] < 0.05 + 0.015


def test_the_spectrum_says_what_is_significant(rng):
    """Kills a family of tests that is one node only, a band that is not pooled, nulls where there is a test."""
    rig, spectra = chain_spectra(rng, chain_stiffness(60, rng), 6, 2, noise=1e-3, spring=5e-3)
    estimate = run_of(rig, spectra)[1]
    shown = {name: spectrum_json(estimate, name) for name in ("1", "2", "3")}
    q = q_values(estimate.spectra.p_value)
    for i, body in enumerate(shown.values()):
        assert body["q_value"] == q[:, i].tolist()
        assert body["significant"] == (q[:, i] <= 0.05).tolist()
        assert body["bands"][0]["p_value"] == pytest.approx(estimate.nodes[i].p_value)
        assert sum(band["lines"] for band in body["bands"][1:]) == 60
        octave = body["bands"][-1]
        p = estimate.spectra.p_value[-octave["lines"] :, i]
        assert octave["p_value"] == pytest.approx(pooled_p_value(p))
    assert sum(shown["3"]["significant"]) > 20 * max(sum(shown[x]["significant"]) for x in "12") - 20
    assert sum(shown["3"]["significant"]) > 30


def test_the_spectrum_of_data_without_a_test_is_null(rng):
    rig = make_rig(3, network=CHAIN)
    body = spectrum_json(run_of(rig, random_spectra(rng, rig, 1, 3))[1], "1")
    assert set(body["p_value"]) == set(body["q_value"]) == set(body["significant"]) == {None}
    assert {band["p_value"] for band in body["bands"]} == {None}
