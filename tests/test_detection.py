"""Distortion from the lines left out: which lines they are, what a known nonlinearity puts there, real data."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_frames, make_rig, make_run
from creak.cli import run
from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.detection import LineSums, detection_levels, detection_lines
from creak.mechanics.effects import CubicStiffness, QuadraticStiffness
from creak.monitor import Monitor
from creak.multisine import grid_lines
from creak.records import Estimate, Frame, Scope
from creak.sources.simulated import SimulatedRig

DATA = Path(__file__).parents[2] / "shared" / "data"
EXAMPLES = Path(__file__).parents[1] / "deploy" / "examples"


def last(outcomes):
    return [o for o in outcomes if isinstance(o, Estimate) and o.scope is Scope.RUN][-1]


def test_lines_left_out_are_told_by_parity():
    odd = detection_lines(make_rig(lines=(3, 5, 9, 11, 13)))
    assert (odd.odd, odd.even) == ((7,), (4, 6, 8, 10, 12))
    assert detection_lines(make_rig(lines=range(3, 9))).all == ()
    assert detection_lines(make_rig(lines=(3, 5, 8, 13))).all == ()  # an even line excited: parity says nothing


@pytest.mark.parametrize("noise", [1e-3, 1e-5])
def test_a_square_shows_on_even_lines_and_a_cube_on_odd_ones(rng, noise):
    """Kills exchanged parities, a factor of 2 or N, and noise that is not taken off."""
    rig = make_rig(2, samples=512, lines=[line for line in range(3, 120, 2) if line % 8 != 5], transient=0)
    plan = make_run(rig, steady=4)
    clean = make_frames(plan, 3, noise=0)
    lines = detection_lines(rig)
    for power, weight in ((2, 0.02), (3, 0.02)):
        monitor, outcomes, added = Monitor(plan), [], []
        for f in clean:
            extra = weight * f.u[0] ** power
            added.append(np.abs(np.fft.rfft(extra) / 512) ** 2)
            y = f.y + np.array([extra, 0 * extra]) + noise * rng.standard_normal(f.y.shape)
            outcomes += monitor.take(Frame(f.realisation, f.experiment, f.period, f.time, f.u, y))
        first, second = last(outcomes).detection
        expected = np.mean(added, axis=0)
        right, wrong = ("even_db", "odd_db") if power == 2 else ("odd_db", "even_db")
        at = list(lines.even if power == 2 else lines.odd)
        assert abs(getattr(first, right) - 10 * np.log10(expected[at].mean())) < 0.1
        # What is left of the noise when its own mean is taken off: one part in sqrt(lines).
        for level in (getattr(first, wrong), second.odd_db, second.even_db):
            assert level is None or level < first.noise_db
        assert abs(first.noise_db - 10 * np.log10(noise**2 / (512 * 4))) < 0.3
    assert abs(first.excited_db - last(outcomes).nodes[0].signal_db + 10 * np.log10(len(rig.lines))) < 0.1


@pytest.mark.parametrize(
    ("spring", "loud", "quiet"),
    [
        (CubicStiffness(("3", "ground"), 1e8), "odd_db", "even_db"),
        (QuadraticStiffness(("3", "ground"), 3e5), "even_db", "odd_db"),
        (None, None, "odd_db"),
    ],
)
def test_springs_of_a_simulated_structure_show_at_lines_of_their_parity(spring, loud, quiet):
    """Three masses on a random-odd grid, one realisation. Kills a grid whose excited lines are not all odd, a
    simulator that makes even lines of its own, and a transient that fills the lines left out."""
    example = EXAMPLES / "three-mass"
    rig, model = load_rig(example / "rig.toml"), load_model(example / "model-linear.toml")
    lines = grid_lines("random-odd", (5.0, 100.0), rig.sample_rate, rig.period_samples)
    rig = replace(rig, lines=lines, transient_periods=4)
    model = replace(model, effects=(spring,) if spring else ())
    source = SimulatedRig(rig, model, steady_periods=2, rms=50.0, seed=1, snr_db=60.0, realisations=1)
    monitor = Monitor(source.run)
    levels = last([o for frame in source.frames() for o in monitor.take(frame)]).detection
    assert [level.name for level in levels] == ["1", "2", "3"]
    for level in levels:
        silent = getattr(level, quiet)
        if loud is not None:
            assert getattr(level, loud) > level.noise_db + 30
            assert silent is None or silent < getattr(level, loud) - 15
        else:
            assert all(found is None or found < level.noise_db for found in (level.odd_db, level.even_db))


@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 2**31))
def test_line_sums_of_blocks_add(a, b, seed):
    rng = np.random.default_rng(seed)
    spectra = rng.standard_normal((a + b, 3, 5, 2)) + 1j * rng.standard_normal((a + b, 3, 5, 2))
    together, parts = LineSums.of(spectra), LineSums.of(spectra[:a]) + LineSums.of(spectra[a:])
    np.testing.assert_allclose(parts.power, together.power, rtol=1e-12)
    np.testing.assert_allclose(parts.noise, together.noise, rtol=1e-12)


def test_one_period_gives_levels_without_noise(rng):
    rig = make_rig(1, lines=(3, 5, 9))
    sums = [LineSums.of(rng.standard_normal((1, 1, lines, 1)) + 0j) for lines in (3, 4)]
    (level,) = detection_levels(rig, *sums)
    assert level.noise_db is None
    assert level.odd_db is not None


@pytest.fixture
def bench():
    path = DATA / "two-mass-bench" / "MultisineTypeB.mat"
    if not path.exists():
        pytest.skip(f"{path} is not there")
    return scipy.io.loadmat(path, squeeze_me=True)


def test_the_two_mass_bench_by_its_authors_measure(bench):
    """Means over lines 11-59 of 4|X|^2/N^2 of the average of periods 2 to 20: -2, -36, -46 and -68 dB."""
    periods = bench["omega_max"].reshape(20, 2500)[1:]
    X = np.fft.rfft(periods)[None, :, :, None] / 2500
    parts = {
        "excited": [k for k in range(11, 60) if k % 4 == 1 and k >= 13],
        "odd": [k for k in range(11, 60) if k % 4 == 3],
        "even": range(12, 60, 2),
        "all": range(11, 60),
    }
    sums = {name: LineSums.of(X[:, :, list(lines)]) for name, lines in parts.items()}
    level = {name: 10 * np.log10(4 * s.power.mean()) for name, s in sums.items()}
    assert abs(level["excited"] + 2) < 1
    assert abs(level["odd"] + 36) < 1
    assert abs(level["even"] + 46) < 1
    assert abs(10 * np.log10(4 * sums["all"].noise.mean()) + 68) < 1


def test_replay_of_the_two_mass_bench_tells_odd_from_even(bench, tmp_path, capsys):
    """One input, two nodes, one realisation: nothing can be located, but the lines left out speak."""
    u, y = bench["iq_adx"][None, None], np.stack([bench["omega_max"], bench["omega_may"]])[None]
    np.savez(tmp_path / "bench.npz", u=u, y=y)
    rig = str(EXAMPLES / "two-mass-bench" / "rig.toml")
    out = str(tmp_path / "bench.mcap")
    assert run(["import", str(tmp_path / "bench.npz"), "--rig", rig, "--output", out]) == 0
    capsys.readouterr()
    assert run(["replay", "--json", out]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["located"] is False
    assert [level["name"] for level in document["detection"]] == ["motor", "load"]
    for level in document["detection"]:
        assert level["excited_db"] > level["odd_db"] > level["even_db"] > level["noise_db"]
    assert run(["replay", out]) == 0
    assert "mean level of a line" in capsys.readouterr().out
