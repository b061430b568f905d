"""The compiled loops of the checks against the formulas that they stand for, written out in numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import make_rig
from creak.multisine import Design, planned_spectra, realisation
from creak.quality import orthogonality_loss_db, transient_share
from creak.quality.spectra import noise_gains, period_changes


def gauss(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def share_of(periods):
    """The transient's share of one response ``(q, P, F)``, as the rule says it."""
    q, _, F = periods.shape
    first, second = (periods[:, p] - periods[:, p + 1 :].mean(axis=1) for p in (0, 1))
    width = min(F, 2 * (int(np.ceil(15 / q)) // 2) + 1)

    def gathered(values):
        return np.convolve(values.sum(axis=0), np.ones(width), mode="same")

    cross = np.abs(gathered(second * first.conj())) ** 2
    coherence = cross / (gathered(np.abs(first) ** 2) * gathered(np.abs(second) ** 2))
    values = q * np.convolve(np.ones(F), np.ones(width), mode="same")
    found = (values - 1) * np.log1p(-np.minimum(coherence, 1 - 1e-15)) < np.log(1e-9 / F)
    return ((np.abs(second) ** 2).sum(axis=0) * coherence)[found].sum() / (np.abs(periods[:, -1]) ** 2).sum()


@settings(deadline=None, max_examples=60)
@given(
    q=st.integers(1, 16),
    steady=st.integers(2, 5),
    F=st.integers(12, 80),
    discarded=st.booleans(),
    decay=st.floats(-3, 0),
    seed=st.integers(0, 2**31),
)
def test_the_transient_is_that_of_the_rule(q, steady, F, discarded, decay, seed):
    """Kills a mean over the wrong periods, and a band of lines that is shifted or too wide at its ends."""
    steady += not discarded
    rng = np.random.default_rng(seed)
    P = steady + discarded
    ring = gauss(rng, 1, 1, F) * np.exp(decay * np.arange(P))[:, None] * (rng.random(F) > 0.5)
    periods = 10 * gauss(rng, q, 1, F) + 0.01 * gauss(rng, q, P, F) + ring
    kept = np.stack((gauss(rng, q, steady, F), periods[:, discarded:]), axis=3)
    got = transient_share(kept, 1, periods[:, 0] if discarded else None)
    expected = share_of(periods)
    assert got == (pytest.approx(expected, rel=1e-9) if expected > 1e-8 else None)


@pytest.mark.parametrize("F", [1, 32, 33, 100])
def test_changes_from_period_to_period(rng, F):
    """Kills a change across experiments, a conjugate on the wrong period, and a tile that is not full."""
    spectra = gauss(rng, 2, 3, 4, F)
    power, moved, cross = np.empty(4), np.empty(4), np.empty((4, F), dtype=complex)
    period_changes(spectra, power, moved, cross)
    np.testing.assert_allclose(power, (np.abs(spectra) ** 2).sum(axis=(0, 1, 3)), rtol=1e-12)
    change = np.diff(spectra, axis=1)
    np.testing.assert_allclose(moved, (np.abs(change) ** 2).sum(axis=(0, 1, 3)), rtol=1e-12)
    expected = (spectra[:, 1:] * spectra[:, :-1].conj()).sum(axis=(0, 1))
    np.testing.assert_allclose(cross, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("q", [1, 2, 3, 16])
def test_noise_gains_are_the_inverse_of_the_inputs_moments(rng, q):
    """Kills a transposed factor, rows scaled by the wrong experiment's power, a tile that is not full."""
    U = gauss(rng, 70, q, q) * 10 ** rng.uniform(-3, 3, (70, q, 1))
    gains = np.empty(70)
    noise_gains(np.ascontiguousarray(U.transpose(2, 1, 0)), gains)
    scaled = U / np.sqrt((np.abs(U) ** 2).mean(axis=2, keepdims=True))
    inverse = np.linalg.inv(scaled @ scaled.conj().swapaxes(1, 2) / q)
    expected = np.einsum("fii->fi", inverse).real.mean(axis=1)
    np.testing.assert_allclose(gains, expected, rtol=1e-8)
    assert orthogonality_loss_db(U) == pytest.approx(10 * np.log10(np.median(expected)), abs=1e-7)


def test_inputs_that_span_nothing_gain_without_bound():
    """Kills a NaN that hides them: no comparison with it is true."""
    assert orthogonality_loss_db(np.ones((5, 2, 2), dtype=complex)) > 100


@pytest.mark.parametrize("design", [Design(), Design("random")])
def test_planned_spectra_are_those_of_the_signals(design):
    rig = make_rig(3, lines=range(2, 14))
    expected = np.fft.rfft(realisation(rig, 2.0, 5, 7, design))[..., list(rig.lines)] / rig.period_samples
    np.testing.assert_allclose(planned_spectra(rig, 2.0, 5, 7, design), expected, rtol=1e-9, atol=1e-12)
