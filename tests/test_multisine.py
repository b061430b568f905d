"""Excitation: the properties that the method relies on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_rig
from creak.multisine import grid_lines, realisation


@given(st.integers(1, 5), st.integers(0, 2**31), st.integers(0, 1000), st.floats(0.01, 100))
def test_experiments_are_orthogonal_flat_and_of_the_asked_rms(q, seed, index, rms):
    """Kills a rotation that is not unitary, a scale that forgets N, power on lines that are not excited."""
    rig = make_rig(q, samples=64, lines=range(3, 20))
    u = realisation(rig, rms, seed, index)
    assert u.shape == (q, q, 64)
    np.testing.assert_allclose(np.sqrt((u**2).mean(axis=-1)), rms, rtol=1e-9)
    spectrum = np.fft.rfft(u) / 64
    excited = np.zeros(33, dtype=bool)
    excited[3:20] = True
    assert np.abs(spectrum[..., ~excited]).max() < 1e-12 * rms
    U = spectrum[..., 3:20].transpose(2, 1, 0)  # (F, inputs, experiments)
    gram = U @ U.conj().swapaxes(1, 2)
    expected = q * rms**2 / (2 * 17) * np.eye(q)
    np.testing.assert_allclose(gram, np.broadcast_to(expected, gram.shape), atol=1e-9 * rms**2)


def test_realisations_differ_and_come_again():
    rig = make_rig(2)
    a, b, again = (realisation(rig, 1.0, 5, m) for m in (0, 1, 0))
    np.testing.assert_array_equal(a, again)
    assert np.abs(a - b).max() > 0.1
    assert np.abs(a - realisation(rig, 1.0, 6, 0)).max() > 0.1


def test_grids():
    assert grid_lines("full", (5.0, 100.0), 5000.0, 8192)[:1] == (9,)
    assert grid_lines("full", (5.0, 100.0), 5000.0, 8192)[-1] == 163
    assert grid_lines("full", (1.0, 3839.0), 8192.0, 8192) == tuple(range(1, 3840))  # ends included
    assert grid_lines("odd", (1.0, 9.0), 64.0, 64) == (1, 3, 5, 7, 9)
    assert grid_lines("full", (0.25, 1000.0), 64.0, 64)[-1] == 31  # never the Nyquist line


@pytest.mark.parametrize("last", [15, 40, 101])
def test_random_odd_leaves_one_line_out_in_each_group_of_four(last):
    """Kills a grid that differs from process to process, and a group without a detection line."""
    lines = grid_lines("random-odd", (1.0, float(last)), 1024.0, 1024)
    assert lines == grid_lines("random-odd", (1.0, float(last)), 1024.0, 1024)
    odd = list(range(1, last + 1, 2))
    for start in range(0, len(odd) - len(odd) % 4, 4):
        assert len(set(odd[start : start + 4]) & set(lines)) == 3
