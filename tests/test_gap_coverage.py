"""Standard errors that a diagnosis states, over a few draws of the noise; hundreds are in the benchmarks."""

import numpy as np
import pytest

from creak.gap.hypothesis import own_elements
from creak.mechanics.effects import CubicStiffness, OneSidedStop
from creak.mechanics.electronics import SensorQuantisation
from gap_recordings import CHAIN
from repetitions import repeat


@pytest.mark.parametrize(
    ("effect", "snr_db", "count"),
    [
        (CubicStiffness(("3", "ground"), 1e8), 12.0, 24),
        (OneSidedStop(("2", "1"), 4e4, 3e-4), 50.0, 5),
    ],
    ids=lambda value: getattr(value, "effect", value),
)
def test_errors_are_as_large_as_stated(effect, snr_db, count):
    # kills: a bias of the regression or of folded harmonics, noise that is counted half, a slope of a staircase
    found = repeat([effect], count, snr_db, realisations=2)
    # The mean square of n normal deviates lies within these bounds but for one in 10^4 sets.
    squares = np.mean(found.deviates**2, axis=0)
    assert np.all(squares < 1 + 4.5 * np.sqrt(2 / count) + 6 / count)
    assert np.all(np.abs(found.bias) < 3.9 * np.sqrt(squares / count) + 1e-3)
    assert np.all(found.stated > 0)


def test_the_step_of_a_quantiser_is_known_between_the_cliffs_of_its_likelihood():
    # kills: an error from the slope of a staircase, a step at the edge of its plateau
    found = [repeat([SensorQuantisation(("3",), 2e-4)], 2, 45.0, realisations=2, seed=seed) for seed in range(8)]
    # Noise hardly moves it within its plateau: the truth lies anywhere there, evenly, which is another place for
    # every excitation.
    deviates = np.array([one.deviates for one in found])
    assert np.all(np.abs(deviates) < 3)
    assert 0.3 < np.sqrt(np.mean(deviates**2)) < 1.5
    assert all(np.all(one.stated < 1e-4 * 2e-4) for one in found)


def test_all_linear_numbers_share_in_the_uncertainty():
    # kills: standard errors with the numbers that nearly fitted held where they were
    shares = (0.05, -0.04, 0.03, -0.06, 0.02)
    off = tuple((own.key, own.value * shares[i % 5]) for i, own in enumerate(own_elements(CHAIN)))
    found = repeat([CubicStiffness(("3", "ground"), 1e8)], 5, 40.0, linear=off)
    deviates = found.deviates  # 12 parameters, 5 times
    assert np.mean(deviates**2) < 1.9
    assert np.mean(np.abs(deviates) < 1.96) > 0.8
