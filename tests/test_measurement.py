"""Measured data as a source: what arrays must satisfy, the frames, and the two real recordings."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from creak.config.rig import load_rig
from creak.errors import MeasurementError
from creak.records import Frame
from creak.sources.measurement import Measurement, read_measurement
from measured import make_rig, measure, refusal, write_npz

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "deploy" / "examples"
DATA = ROOT.parent / "shared" / "data"

RIG = make_rig()
U, Y = measure(RIG, realisations=2)


def with_value(array, value):
    array = array.copy()
    array[1, 1, 5] = value
    array[3, 0, 2] = value
    return array


REFUSED_ARRAYS = {
    "missing": ({"u": U, "responses": Y}, ["no variable y", "responses"]),
    "inputs": ({"u": U[:, :1], "y": Y}, ["u: shape (4, 1, 48)", "2 inputs"]),
    "nodes": ({"u": U, "y": Y[:, :2]}, ["y: shape (4, 2, 48)", "3 nodes"]),
    "axes": ({"u": U[:, :, None], "y": Y}, ["u: shape (4, 2, 1, 48)"]),
    "apart": ({"u": U, "y": Y[:2]}, ["y: shape (2, 3, 48)", "expected (4, 3, 48)"]),
    "left over": ({"u": U[..., :40], "y": Y[..., :40]}, ["40 samples", "2 periods of 16 and 8 samples left over"]),
    "transient": ({"u": U[..., :16], "y": Y[..., :16]}, ["1 periods", "1 are transient", "one steady period"]),
    "empty": ({"u": U[..., :0], "y": Y[..., :0]}, ["0 periods"]),
    "incomplete": ({"u": U[:3], "y": Y[:3]}, ["3 experiments", "a multiple of 2"]),
    "complex": ({"u": U + 0j, "y": Y}, ["u: holds complex numbers"]),
    "text": ({"u": U, "y": np.full(Y.shape, "x")}, ["y: holds"]),
    "nan": ({"u": U, "y": with_value(Y, np.nan)}, ["y: 2 of 576", "experiment 1, channel 2, sample 5"]),
    "inf": ({"u": with_value(U, -np.inf), "y": Y}, ["u: 2 of 384", "experiment 1, channel 2, sample 5"]),
}


@pytest.mark.parametrize("form", ["npz", "mat-5", "mat-7.3"])
@pytest.mark.parametrize("case", REFUSED_ARRAYS)
def test_wrong_arrays_are_refused_in_one_line(case, form, tmp_path):
    arrays, expected = REFUSED_ARRAYS[case]
    if form == "mat-7.3":
        path = tmp_path / "m.mat"
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array.T.astype("S1") if array.dtype.kind == "U" else array.T
    elif form == "mat-5":
        path = tmp_path / "m.mat"
        scipy.io.savemat(path, arrays)
    else:
        path = tmp_path / "m.npz"
        np.savez(path, **arrays)
    text = refusal([path], RIG)
    assert text.startswith(str(path))
    for part in expected:
        assert part in text


def test_a_singular_input_matrix_is_named(tmp_path):
    # Kills a check that looks at one realisation only, forgets the transient periods, or scales with the units.
    path = tmp_path / "m.npz"

    repeated = U.copy()
    repeated[3] = 2 * repeated[2]
    text = refusal(write_npz(path, repeated, Y, RIG), RIG)
    assert "realisation 1 is singular" in text
    assert "condition number" in text

    noise = np.random.default_rng(1).standard_normal(U.shape)
    text = refusal(write_npz(path, repeated + 1e-5 * noise, Y, RIG), RIG)  # as a recorded input has it
    assert "realisation 1 is singular" in text

    one_line = U.copy()  # dependent at line 2 only: that line is the worst
    spectrum = np.fft.rfft(one_line[..., :16])
    spectrum[1, :, 2] = spectrum[0, :, 2]
    one_line = np.tile(np.fft.irfft(spectrum, 16), 3)
    one_line[..., :16] = U[..., :16]  # the transient period does not help
    assert "at line 2 (12.5 Hz)" in refusal(write_npz(path, one_line, Y, RIG), RIG)

    scale = np.array([1e-9, 1e6])[:, None]
    read_measurement(write_npz(path, scale * U, Y, RIG), RIG)  # units do not make it singular

    spectrum = np.fft.rfft(U[..., :16])
    spectrum[2:, 1, 3] = 0
    silent = np.tile(np.fft.irfft(spectrum, 16), 3)
    assert "input at node 2 is silent at line 3 (18.75 Hz) of realisation 1" in refusal(
        write_npz(path, silent, Y, RIG), RIG
    )


@given(
    shape=st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(0, 2), st.integers(1, 3)),
    start=st.integers(0, 2**61),
    rate=st.sampled_from([1.0, 100.0, 610.35, 2500.0, 44100.0]),
)
@settings(deadline=None, max_examples=50)
def test_frames_put_together_are_the_measurement(shape, start, rate):
    # Kills a wrong order of experiments, shared or shifted periods, and times that drift by rounding each period.
    q, realisations, transient, steady = shape
    rig = make_rig(q, q + 1, transient=transient, rate=rate)
    u, y = measure(rig, realisations=realisations, periods=transient + steady)
    source = Measurement(u, y, rig, start)
    assert source.run.steady_periods == steady
    frames = list(source.frames())
    assert all(isinstance(frame, Frame) for frame in frames)
    order = [(f.realisation, f.experiment, f.period) for f in frames]
    assert order == [(m, c, p) for m in range(realisations) for c in range(q) for p in range(transient + steady)]
    for name, array in (("u", u), ("y", y)):
        joined = np.concatenate([getattr(frame, name) for frame in frames], axis=-1)
        np.testing.assert_array_equal(joined, np.concatenate(list(array), axis=-1))
    for count, frame in enumerate(frames):
        assert abs(frame.time - start - count * 16 * 1_000_000_000 / rate) <= 0.5


def test_the_run_identifies_what_was_imported():
    # Kills random identities (two imports would differ), and ones that ignore the samples, the rig or the start.
    first = Measurement(U, Y, RIG, 7).run
    assert Measurement(np.asfortranarray(U), Y.copy(), RIG, 7).run == first
    others = [
        Measurement(with_value(U, 9.0), Y, RIG, 7),
        Measurement(U, with_value(Y, 9.0), RIG, 7),
        Measurement(U, Y, replace(RIG, name="other"), 7),
        Measurement(U, Y, RIG, 8),
    ]
    assert len({first.id, *(other.run.id for other in others)}) == 5
    assert Measurement(U, Y, RIG, 7, run_id="given").run.id == "given"
    assert (first.source, first.excitation.kind, first.start) == ("measurement", "measured", 7)


def test_the_rms_is_given_only_where_it_is_one_number():
    same = np.sign(U)
    assert Measurement(3 * same, Y, RIG).run.excitation.rms == pytest.approx(3)
    same[..., :16] = 100  # the transient period does not count
    assert Measurement(same, Y, RIG).run.excitation.rms == pytest.approx(1)
    assert Measurement(same * np.array([1.0, 1.02])[:, None], Y, RIG).run.excitation.rms is None


def test_close_ends_the_iteration_and_wrong_arrays_never_start():
    source = Measurement(U, Y, RIG)
    frames = source.frames()
    next(frames)
    source.close()
    source.close()
    assert list(frames) == []
    with pytest.raises(MeasurementError, match="shape"):
        Measurement(U[:, :1], Y, RIG)


def real(*names):
    files = [DATA / name for name in names]
    for file in files:
        if not file.exists():
            message = f"real data absent: {file.relative_to(ROOT.parent)}"
            if os.environ.get("CI") == "true":
                pytest.fail(message)
            pytest.skip(message)
    return files


def reordered(example, files, output):
    script = EXAMPLES / example / "reorder.py"
    subprocess.run([sys.executable, "-W", "error", script, *files, output], check=True, capture_output=True)
    rig = load_rig(EXAMPLES / example / "rig.toml")
    return rig, *read_measurement([output], rig)


def test_fine_steering_mirror_up_to_the_frames(tmp_path):
    # Kills mixed-up axes of the example: the paper's condition of orthogonal experiments would not hold.
    folder = "fine-steering-mirror"
    sources = real(f"{folder}/u_300mV_train.npy", f"{folder}/y_300mV_train.npy")
    rig, u, y = reordered(folder, sources, tmp_path / "mirror.npz")
    assert (rig.q, rig.n, rig.lines) == (3, 3, tuple(range(1, 3840)))
    source = Measurement(u, y, rig)
    assert source.run.excitation.rms == pytest.approx(0.2968, abs=1e-4)
    frames = list(source.frames())
    assert len(frames) == 12
    raw = [np.load(file) for file in sources]
    for frame in frames:
        experiment = 3 * frame.realisation + frame.experiment
        for got, array in zip((frame.u, frame.y), raw, strict=True):
            np.testing.assert_array_equal(got, array[:, :, experiment, frame.period].T)
    for m in range(2):
        U = np.stack([np.fft.rfft(f.u)[:, 1:3840] for f in frames if (f.realisation, f.period) == (m, 0)])
        assert np.linalg.cond(U.transpose(2, 1, 0)).max() < 1.01


def test_two_mass_bench_up_to_the_frames(tmp_path):
    # Kills wrong variables and lines: the input's power lies on the rig's lines, and only the first period differs
    # from the others.
    rig, u, y = reordered("two-mass-bench", real("two-mass-bench/MultisineTypeB.mat"), tmp_path / "bench.npz")
    assert (rig.q, rig.n, rig.square) == (1, 2, False)
    source = Measurement(u, y, rig)
    assert source.run.steady_periods == 19
    Y = np.stack([np.fft.rfft(frame.y) / 2500 for frame in source.frames()])[..., list(rig.lines)]
    power = np.abs(Y) ** 2
    signal = 10 * np.log10(power[1:].mean(0).sum(-1))
    np.testing.assert_allclose(signal, [6.97, 7.51], atol=0.005)
    spread = (np.abs(Y - Y[1:].mean(0)) ** 2).sum(-1)
    assert (spread[0] > 3 * spread[1:].max(0)).all()
    U = np.abs(np.fft.rfft(u[0, 0, 2500:].reshape(19, 2500)).mean(0))
    assert np.sum(U[list(rig.lines)] ** 2) > 0.98 * np.sum(U[1:] ** 2)
