"""Any measurement: amplitudes that differ, noisy inputs, given edges that are wrong, thirty-two nodes."""

from dataclasses import replace
from functools import reduce
from operator import add

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_rig, random_spectra
from creak.edges import edge_remarks, edge_tests, reference
from creak.network import estimate
from creak.records import Scope
from creak.statistics import Sums
from test_network import CHAIN, chain_spectra, chain_stiffness


def sums_of(spectra, q):
    return reduce(add, (Sums.of(s, q) for s in spectra))


def with_amplitudes(spectra, q, rng, noise):
    """Scale the realisations of noise-free spectra by amplitudes over a decade, then add noise."""
    scale = rng.permutation(10 ** np.linspace(-0.5, 0.5, len(spectra)))
    spectra = spectra * scale[:, None, None, None, None]
    shape = spectra[..., q:].shape
    spectra[..., q:] += noise * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    return spectra


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 6), st.integers(1, 3), st.integers(1, 3), st.integers(0, 2**31))
def test_least_squares_is_a_shear_away(M, q, P, seed):
    """Kills a cross moment that is transposed, or left out of the moments that move with S."""
    rng = np.random.default_rng(seed)
    rig = make_rig(q + 1, q, lines=range(2, 5))
    spectra = with_amplitudes(random_spectra(rng, rig, M, P, noise=0), q, rng, 0.1)
    got = sums_of(spectra, q).about_least_squares()
    mean = spectra.mean(axis=2).transpose(2, 3, 0, 1).reshape(3, 2 * q + 1, M * q)  # (F, channel, experiment)
    U, Y = mean[:, :q], mean[:, q:]
    adjoint = U.conj().swapaxes(1, 2)
    S = Y @ adjoint @ np.linalg.inv(U @ adjoint)
    np.testing.assert_allclose(got.S, S, rtol=1e-8, atol=1e-9)
    R = Y - S @ U
    rest = P * R @ R.conj().swapaxes(1, 2)
    np.testing.assert_allclose(got.between[:, q:, q:], rest, rtol=1e-7, atol=1e-9 * np.abs(rest).max())
    np.testing.assert_allclose(got.between[:, q:, :q], 0, atol=1e-8 * np.abs(got.between).max())


def test_where_amplitudes_are_equal_the_papers_mean_is_kept(rng):
    rig = make_rig(3)
    sums = sums_of(random_spectra(rng, rig, 5, 2, noise=0.1), 3)
    chosen = reference(sums, ("1", "2", "3"))
    assert chosen.sums is sums
    assert chosen.remarks == ()
    np.testing.assert_allclose(sums.about_least_squares().S, sums.S, rtol=1e-9)


def p_values(make, count=300):
    return np.array([[node.p_value for node in make().nodes] for _ in range(count)])


def test_p_values_hold_where_amplitudes_differ(rng):
    """With (28) alone most linear recordings look nonlinear; kills a reference that is not least squares."""
    rig = make_rig(2, lines=range(2, 12))

    def both():
        spectra = with_amplitudes(random_spectra(rng, rig, 5, 3, noise=0), 2, rng, 1e-2)
        sums = sums_of(spectra, 2)
        chosen = reference(sums, ("1", "2"))
        assert "28" in chosen.remarks[0]
        return estimate(rig, chosen.sums, Scope.RUN, 0, 4), estimate(rig, sums, Scope.RUN, 0, 4)

    pairs = [both() for _ in range(300)]
    right, wrong = (np.array([[n.p_value for n in pair[i].nodes] for pair in pairs]) for i in (0, 1))
    assert scipy.stats.kstest(right[:, 0], "uniform").pvalue > 1e-3
    assert (wrong < 0.05).mean() > 0.6


def test_p_values_hold_with_noise_on_the_inputs(rng):
    """Measured inputs, not identical in every period: their noise belongs to the residual and is counted there."""
    rig = make_rig(3, lines=range(2, 12))

    def one():
        spectra = random_spectra(rng, rig, 4, 3, noise=1e-2)
        noise = 2e-3 * (
            rng.standard_normal(spectra[..., :3].shape) + 1j * rng.standard_normal(spectra[..., :3].shape)
        )
        spectra[..., :3] += noise
        return estimate(rig, sums_of(spectra, 3), Scope.RUN, 0, 3)

    p = p_values(one)
    assert scipy.stats.kstest(p[:, 1], "uniform").pvalue > 1e-3


@pytest.mark.parametrize("spring", [0.0, 2e-2])
def test_right_edges_are_not_contradicted(spring):
    """The p-value is uniform for right edges, also where a node distorts; kills wrong degrees of freedom."""
    rng = np.random.default_rng(11)
    p = []
    for _ in range(250):
        rig, spectra = chain_spectra(rng, chain_stiffness(12, rng), 4, 2, noise=1e-3, spring=spring)
        tests = edge_tests(replace(rig, network=CHAIN), sums_of(spectra, 3))
        assert tests[1].p_value == 1  # the middle of a chain of three has every other node as neighbour
        p.append([tests[0].p_value, tests[2].p_value])
    p = np.array(p)
    for i in range(2):
        assert scipy.stats.kstest(p[:, i], "uniform").pvalue > 1e-3
        assert abs((p[:, i] < 0.05).mean() - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 250)


def test_a_missing_edge_is_found_and_named(rng):
    Z = chain_stiffness(30, rng)
    rig, spectra = chain_spectra(rng, Z, 4, 2, noise=1e-3)
    wrong = replace(rig, network=(("1", "2"), ("1", "3")))  # the chain is 1-2-3
    tests = {test.node: test for test in edge_tests(wrong, sums_of(spectra, 3))}
    assert tests["2"].p_value < 1e-6
    assert tests["2"].missing == "3"
    assert tests["3"].missing == "2"
    remarks = edge_remarks(tuple(tests.values()))
    assert len(remarks) == 2
    assert "node 2" in remarks[0]
    assert "edge to 3" in remarks[0]


def test_there_is_nothing_to_test_in_a_dense_network_or_one_realisation(rng):
    rig, spectra = chain_spectra(rng, chain_stiffness(4, rng), 2, 2, noise=1e-3)
    assert edge_tests(rig, sums_of(spectra, 3)) == ()
    assert edge_tests(replace(rig, network=CHAIN), Sums.of(spectra[0], 3)) == ()


def test_thirty_two_nodes(rng):
    rig = make_rig(32, lines=range(2, 12))
    got = estimate(rig, sums_of(random_spectra(rng, rig, 3, 2, noise=1e-3), 32), Scope.RUN, 0, 2)
    assert got.located
    ratios = [node.total_to_noise_db for node in got.nodes]
    assert abs(np.mean(ratios) - 10 * np.log10(1 - 0.5 * 31 / 95)) < 0.3  # (39) lacks what the fit took
    assert min(node.p_value for node in got.nodes) > 1e-4
