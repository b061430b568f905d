"""Multisines for a rig's own generator: what the file holds, and what each option promises."""

import json

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

import two_masses
from conftest import make_rig
from creak.cli import run
from creak.crest import crest_factor
from creak.errors import InputError
from creak.multisine import Design, realisation
from creak.sources.recording import Recording


@pytest.fixture
def small(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(two_masses.rig(rate=256.0, transient=3, band=(2.0, 60.0)))
    (tmp_path / "model.toml").write_text(two_masses.model(20.0))
    return tmp_path


def matrices(u, lines):
    """Input matrices (F, input, experiment)."""
    return (np.fft.rfft(u)[..., lines] / u.shape[-1]).transpose(2, 1, 0)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(1, 4),
    st.integers(0, 2**31),
    st.sampled_from(["rotation", "random"]),
    st.sampled_from([0, 5]),
    st.booleans(),
)
def test_every_design_keeps_experiments_orthogonal_and_amplitudes_exact(q, seed, orthogonal, iterations, coloured):
    """Kills a crest reduction that trades amplitudes or orthogonality for its peak."""
    rig = make_rig(q, samples=128, lines=range(3, 20))
    wanted = np.random.default_rng(seed).uniform(0.1, 3, (q, 17)) if coloured else np.ones((q, 17))
    design = Design(orthogonal, wanted if coloured else None, iterations)
    u = realisation(rig, 2.0, seed, 3, design)
    np.testing.assert_allclose(np.sqrt((u**2).mean(axis=-1)), 2.0, rtol=1e-9)
    U = matrices(u, range(3, 20))
    expected = wanted / np.sqrt((wanted**2).sum(axis=1, keepdims=True)) * 2 / np.sqrt(2)
    np.testing.assert_allclose(np.abs(U), np.broadcast_to(expected.T[:, :, None], U.shape), rtol=1e-9)
    gram = U @ U.conj().swapaxes(1, 2) / (expected.T[:, :, None] * expected.T[:, None, :])
    np.testing.assert_allclose(gram, np.broadcast_to(q * np.eye(q), gram.shape), atol=1e-8)


def test_full_random_orthogonal_experiments_have_independent_distortions():
    """The paper's rotation repeats an input's odd distortion in every experiment; full random phases do not."""
    rig = make_rig(2, samples=1024, lines=range(3, 120, 2))
    alike = {}
    for orthogonal in ("rotation", "random"):
        values = []
        for m in range(20):
            u = realisation(rig, 1.0, 4, m, Design(orthogonal))
            D = np.fft.rfft(u[:, 0] ** 3 - 3 * u[:, 0])[:, list(rig.lines)]  # what is not along u, nearly
            values.append(abs((D[0] * D[1].conj()).sum()) / (np.abs(D) ** 2).sum(axis=1).mean())
        alike[orthogonal] = np.mean(values)
    assert alike["rotation"] > 0.99
    assert alike["random"] < 0.3  # 59 lines: about 1/sqrt(59)


def test_a_reduced_crest_factor_is_low_and_realisations_still_differ():
    rig = make_rig(3, samples=2048, lines=range(2, 300))
    plain = crest_factor(realisation(rig, 1.0, 1, 0))
    a, b = (realisation(rig, 1.0, 1, m, Design(crest_iterations=100)) for m in (0, 1))
    assert plain.max() > 3
    assert max(crest_factor(a).max(), crest_factor(b).max()) < 2.2
    cross = np.abs(np.fft.irfft(np.fft.rfft(a[0]) * np.fft.rfft(b[0]).conj())).max() / 2048
    assert cross < 0.5  # unit power each: at no shift are the two alike


def test_crest_factor_sees_peaks_between_samples():
    """Kills a peak that is read off the samples: a sine sampled at 45 degrees never shows its crest."""
    u = np.sin(2 * np.pi * np.arange(64) / 4 + np.pi / 4)
    assert abs(crest_factor(u) - np.sqrt(2)) < 1e-9


def read(path):
    if path.suffix == ".npz":
        with np.load(path) as file:
            return file["u"]
    if path.suffix == ".mat":
        return scipy.io.loadmat(path)["u"]
    header, *_ = path.read_text().splitlines()
    assert header == "experiment,time,u:1,u:2"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    samples = int((table[:, 0] == 0).sum())
    return table[:, 2:].reshape(-1, samples, 2).transpose(0, 2, 1)


@pytest.mark.parametrize("suffix", ["npz", "mat", "csv"])
def test_the_file_is_what_simulate_plays(small, capsys, suffix):
    """Kills another random stream, another order of experiments, or digits that a table loses."""
    common = ["--rig", "rig.toml", "--realisations", "2", "--rms", "3", "--seed", "7"]
    assert run(["excitation", *common, "--periods", "2", "--json", "--output", f"u.{suffix}"]) == 0
    document = json.loads(capsys.readouterr().out)
    u = read(small / f"u.{suffix}")
    assert u.shape == (4, 2, 512)
    assert (document["experiments"], document["inputs"], document["samples"]) == (4, 2, 512)
    assert document["crest_factor"]["lowest"] > 1
    assert run(["simulate", "--model", "model.toml", *common, "--output", "a.mcap"]) == 0
    for frame in Recording(small / "a.mcap").frames():
        played = u[2 * frame.realisation + frame.experiment]
        np.testing.assert_array_equal(played[:, :256], frame.u)
        np.testing.assert_array_equal(played[:, 256:], frame.u)


def test_the_spectrum_is_free(small, capsys):
    (small / "s.csv").write_text("# shaped\nfrequency_hz,1,2\n1,1,4\n100,1,2\n")
    arguments = ["excitation", "--rig", "rig.toml", "--realisations", "1", "--rms", "1"]
    assert run([*arguments, "--spectrum", "s.csv", "--output", "u.npz"]) == 0
    assert "crest factor" in capsys.readouterr().out.replace("\n", " ")
    U = np.abs(np.fft.rfft(read(small / "u.npz"))[..., 2:61])
    np.testing.assert_allclose(U[:, 0] / U[:, 0, :1], 1, rtol=1e-9)
    expected = 4 - 2 * (np.arange(2, 61) - 1) / 99
    np.testing.assert_allclose(U[0, 1] / U[0, 1, 0], expected / expected[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--output", "u.wav"], ["--output", "u.wav", ".npz, .mat, .csv"]),
        (["--output", "no/u.npz"], ["no/u.npz", "no directory"]),
        (["--output", "u.npz", "--rms", "-1"], ["--rms", "-1"]),
        (["--output", "u.npz", "--realisations", "0"], ["--realisations", "0"]),
        (["--output", "u.npz", "--orthogonal", "hadamard"], ["hadamard", "rotation"]),
        (["--output", "u.npz", "--spectrum", "none.csv"], ["none.csv"]),
        (["--output", "u.npz", "--spectrum", "gap.csv"], ["gap.csv", "frequency_hz", "2 to 60 Hz"]),
        (["--output", "u.npz", "--spectrum", "word.csv"], ["word.csv", "line 3", "amplitude", "'x'"]),
        (["--output", "u.npz", "--spectrum", "zero.csv"], ["zero.csv", "amplitude", "not above 0"]),
        (["--output", "u.npz", "--spectrum", "column.csv"], ["column.csv", "1", "no such column"]),
    ],
)
def test_mistakes_get_one_line_and_leave_nothing_behind(small, capsys, more, words):
    (small / "gap.csv").write_text("frequency_hz,amplitude\n5,1\n100,1\n")
    (small / "word.csv").write_text("frequency_hz,amplitude\n1,1\n100,x\n")
    (small / "zero.csv").write_text("frequency_hz,amplitude\n1,1\n30,0\n100,1\n")
    (small / "column.csv").write_text("frequency_hz,level\n1,1\n100,1\n")
    before = set(small.iterdir())
    assert run(["excitation", "--rig", "rig.toml", *more]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert all(word in said for word in words), said
    assert set(small.iterdir()) == before


def test_an_excited_line_needs_an_amplitude():
    with pytest.raises(InputError, match="above 0"):
        realisation(make_rig(1), 1.0, 1, 0, Design(amplitudes=np.zeros(12)))
