"""Laws of the streaming sums: split, order, zero, and agreement with the paper's batch formulas."""

from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import oracle
from conftest import make_rig, random_spectra
from creak.network import estimate
from creak.records import Scope
from creak.statistics import Sums

LEVELS = ("signal", "total", "noise", "nonlinear", "classical_total", "classical_noise", "classical_nonlinear")


def sums_of(spectra, q):
    return reduce(lambda a, b: a + b, (Sums.of(block, q) for block in spectra))


def assert_same(a, b, rtol):
    """All statistics equal relative to their own size, line by line."""
    assert (a.realisations, a.periods) == (b.realisations, b.periods)
    for name in ("S", "packed_between", "packed_within", "period_sums"):
        x, y = getattr(a, name), getattr(b, name)
        np.testing.assert_allclose(x, y, rtol=rtol, atol=rtol * np.abs(y).max(), err_msg=name)


@pytest.mark.parametrize(
    ("noise_db", "tolerance"),
    # Rounding of the sums, relative to the variances themselves; raw sums would be 2e-6 at 80 dB, 4e-2 at 120.
    [(0, 1e-9), (40, 1e-9), (80, 1e-9), (100, 1e-9), (120, 1e-8)],
)
@pytest.mark.parametrize(("n", "q", "M", "P"), [(3, 3, 4, 3), (2, 2, 2, 2), (3, 1, 5, 2), (1, 1, 6, 4)])
def test_stream_agrees_with_the_batch_oracle(rng, n, q, M, P, noise_db, tolerance):
    """Kills a wrong divisor, a conjugate in the wrong place, cancellation at high signal-to-noise ratio."""
    rig = make_rig(n, q, lines=range(2, 8))
    amplitude = 10 ** (-noise_db / 20)
    spectra = random_spectra(rng, rig, M, P, noise=amplitude, distortion=0.5 * amplitude)
    want = oracle.analysis(spectra, q)
    got = estimate(rig, sums_of(spectra, q), Scope.RUN, 0, M - 1)
    for name in LEVELS:
        if q < n and not name.startswith(("signal", "classical")):
            continue
        reference = want[name]
        if "nonlinear" in name:  # a difference of the two others, and as exact as they are
            scale = want[name.replace("nonlinear", "total")]
        else:
            scale = reference
        error = np.abs(getattr(got.spectra, name) - reference) / scale
        assert error.max() < tolerance, name
    for i, level in enumerate(got.nodes):
        assert level.classical_total_db == pytest.approx(
            10 * np.log10(want["classical_total"][:, i].sum()), abs=1e-7
        )


def test_given_edges_that_are_all_edges_are_the_dense_network(rng):
    """Kills a least-squares solution that is not the exact one where it must be."""
    dense = make_rig(3, lines=range(2, 8))
    given_edges = make_rig(3, lines=range(2, 8), network=(("1", "2"), ("2", "3"), ("1", "3")))
    sums = sums_of(random_spectra(rng, dense, 4, 3), 3)
    a, b = (estimate(rig, sums, Scope.RUN, 0, 3).spectra for rig in (dense, given_edges))
    np.testing.assert_allclose(a.total, b.total, rtol=1e-9)
    np.testing.assert_allclose(a.noise, b.noise, rtol=1e-9)


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_split_and_order_merges_to_the_same_sums(data):
    """Kills an accumulator that depends on arrival, or a merge that forgets a term of the change of S."""
    M, P = data.draw(st.integers(2, 6)), data.draw(st.integers(1, 3))
    q = data.draw(st.integers(1, 3))
    n = data.draw(st.integers(q, 3))
    rig = make_rig(n, q, lines=range(2, 5))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    spectra = random_spectra(rng, rig, M, P, noise=10 ** data.draw(st.floats(-5, 0)))
    blocks = [Sums.of(s, q) for s in spectra]
    straight = reduce(lambda a, b: a + b, blocks)
    order = data.draw(st.permutations(range(M)))
    cut = data.draw(st.integers(1, M - 1))
    left = reduce(lambda a, b: a + b, [blocks[i] for i in order[:cut]])
    right = reduce(lambda a, b: a + b, [blocks[i] for i in order[cut:]], Sums.zero(P, len(rig.lines), n, q))
    assert_same(left + right, straight, 1e-10)
    commuted = right + left
    for name in ("S", "spread", "packed_between", "packed_within", "period_sums"):
        np.testing.assert_array_equal(getattr(left + right, name), getattr(commuted, name))


def test_zero_is_neutral_and_operands_are_not_changed(rng):
    """Kills an in-place merge, and a zero that divides by nothing."""
    rig = make_rig(2)
    a, b = (Sums.of(s, 2) for s in random_spectra(rng, rig, 2, 2))
    zero = Sums.zero(2, len(rig.lines), 2, 2)
    before = {name: getattr(a, name).copy() for name in ("S", "packed_between", "packed_within", "period_sums")}
    assert_same(zero + a, a, 0)
    assert_same(a + zero, a, 0)
    assert (zero + zero).realisations == 0
    _ = a + b
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(a, name), value)


@pytest.mark.parametrize(("n", "q", "P"), [(3, 3, 3), (2, 1, 1), (16, 16, 2)])
def test_moments_are_those_of_the_residuals_about_any_matrix(rng, n, q, P):
    """Kills a wrong place in the packed half, a conjugate in the wrong half, a wrong edge of a tile of lines."""
    rig = make_rig(n, q, lines=range(1, 131))  # two tiles and a bit
    spectra = random_spectra(rng, rig, 1, P, noise=0.1)[0]
    about = rng.standard_normal((130, n, q)) + 1j * rng.standard_normal((130, n, q))
    got = Sums.of(spectra, q, S=about)
    V = spectra.copy()
    V[..., q:] -= np.einsum("fnq,epfq->epfn", about, V[..., :q])
    mean = V.mean(axis=1)
    change = V - mean[:, None]
    size = np.abs(V).max() ** 2 * V.shape[0] * P
    for found, wanted in (
        (got.between, P * np.einsum("efi,efj->fij", mean, mean.conj())),
        (got.within, np.einsum("epfi,epfj->fij", change, change.conj())),
        (got.period_sums, V.sum(axis=0)),
        (Sums.of(spectra, q).moved(about).between, got.between),
        (Sums.of(spectra, q).moved(about).within, got.within),
    ):
        np.testing.assert_allclose(found, wanted, atol=1e-13 * size)  # rounding, a few operations an entry
    for own, matrices in zip(got.powers, (got.between, got.within), strict=True):
        np.testing.assert_array_equal(own, np.einsum("fii->fi", matrices).real)


def test_sums_of_different_measurements_do_not_add(rng):
    rig = make_rig(2)
    two, three = (Sums.of(random_spectra(rng, rig, 1, p)[0], 2) for p in (2, 3))
    with pytest.raises(ValueError, match="different measurements"):
        _ = two + three


def test_the_spread_of_S_is_the_variance_over_realisations(rng):
    """Kills a Welford merge with the wrong weight."""
    rig = make_rig(3)
    spectra = random_spectra(rng, rig, 7, 2, noise=0.1)
    each = np.array([Sums.of(s, 3).S for s in spectra])
    np.testing.assert_allclose(
        sums_of(spectra, 3).spread, (np.abs(each - each.mean(axis=0)) ** 2).sum(axis=0), rtol=1e-9
    )
