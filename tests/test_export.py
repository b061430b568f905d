"""What is exported is read back by ``creak import``, bit for bit."""

import csv
import json
from itertools import count
from pathlib import Path

import numpy as np
import pytest
import pyuff
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from creak.cli import run
from creak.export import write_csv, write_mat, write_uff
from creak.notebook import open_recording
from creak.records import Frame, Node, Rig
from creak.sinks.recorder import Recorder
from creak.sources.measurement import Measurement, read_measurement
from creak.worker import drive
from measured import measure
from recorded import records, write
from test_cli import THREE

NAMES = st.text(st.sampled_from("abZ019 ,\"'[]:.µé-+"), min_size=1, max_size=12).map(str.strip).filter(bool)
UNITS = st.sampled_from(["m", "m/s", "m/s^2", "V", "µstrain", "a unit of more than twenty letters"])
FORMATS = (".mat", ".csv", ".uff")


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    names = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    q = draw(st.integers(1, len(names)))
    nodes = tuple(
        Node(name, draw(UNITS), draw(st.sampled_from(["N", "A"])) if i < q else None)
        for i, name in enumerate(names)
    )
    return Rig("rig", draw(st.sampled_from([100.0, 8192.0, 1 / 3])), 16, draw(st.integers(0, 2)), (1, 2, 3), nodes)


def recorded(path: Path, u: np.ndarray, y: np.ndarray, rig: Rig, start: int = 0) -> Path:
    drive(Measurement(u, y, rig, start), [Recorder(path)])
    return path


@pytest.mark.parametrize("suffix", FORMATS)
@settings(deadline=None, max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rig=rigs(), realisations=st.integers(1, 2), steady=st.integers(2, 3), seed=st.integers(0, 99))
def test_import_reads_what_export_wrote(suffix, tmp_path, rig, realisations, steady, seed):
    """Kills lost digits, lost transient periods, names that a delimiter tears, exchanged channels and axes."""
    u, y = measure(rig, realisations=realisations, periods=rig.transient_periods + steady, seed=seed)
    u, y = u * 1e-9, y * 1e5  # digits after the point are not digits
    recording = open_recording(recorded(tmp_path / "m.mcap", u, y, rig))
    found = list(recording.experiments())
    assert len(found) == len(u)
    if suffix == ".mat":
        files = [tmp_path / "m.mat"]
        write_mat(files[0], found, recording)
    else:
        files = [tmp_path / f"m-{e}{suffix}" for e in range(len(found))]
        for file, experiment in zip(files, found, strict=True):
            (write_csv if suffix == ".csv" else write_uff)(file, experiment, recording)
    got_u, got_y = read_measurement(files, rig)
    np.testing.assert_array_equal(got_u, u)
    np.testing.assert_array_equal(got_y, y)


@pytest.mark.parametrize("suffix", [".mat", ".csv"])  # universal files have no NaN
def test_a_transient_period_that_never_came_is_read_back_as_such(suffix, tmp_path):
    """Kills an export that import refuses: what counts for nothing may lack."""
    rig = Rig("rig", 100.0, 16, 2, (1, 2, 3), (Node("1", "m", "N"), Node("2", "m", "N")))
    u, y = measure(rig, realisations=2, periods=4)
    for array in (u, y):
        array[2, :, 16:32] = np.nan
    recording = open_recording(recorded(tmp_path / "m.mcap", u, y, rig))
    found = list(recording.experiments())
    assert [len(found), np.isnan(found[2].y).all(axis=(1, 2)).tolist()] == [4, [False, True, False, False]]
    if suffix == ".mat":
        files = [tmp_path / "m.mat"]
        write_mat(files[0], found, recording)
    else:
        files = [tmp_path / f"m-{e}{suffix}" for e in range(len(found))]
        for file, experiment in zip(files, found, strict=True):
            write_csv(file, experiment, recording)
    for got, sent in zip(read_measurement(files, rig), (u, y), strict=True):
        np.testing.assert_array_equal(got, sent)


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """A recording of three masses, and what its replay says."""
    path = tmp_path_factory.mktemp("export") / "three.mcap"
    common = ["--rig", str(THREE / "rig.toml"), "--output", str(path), "--realisations", "2", "--rms", "50"]
    assert run(["simulate", "--model", str(THREE / "model.toml"), *common, "--snr-db", "40"]) == 0
    return path


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_command_there_and_back_gives_the_same_figures(three, suffix, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(["export", str(three), "--output", f"three{suffix}"]) == 0
    files = sorted(map(str, Path().iterdir()))
    numbered = [f"three-{e:04d}{suffix}" for e in range(1, 7)]
    assert files == ([f"three{suffix}"] if suffix == ".mat" else numbered)
    assert run(["import", *files, "--rig", str(THREE / "rig.toml"), "--output", "again.mcap"]) == 0
    capsys.readouterr()
    documents = []
    for path in (three, "again.mcap"):
        assert run(["replay", str(path), "--json"]) == 0
        documents.append(json.loads(capsys.readouterr().out))
    for document in documents:
        del document["recordings"]  # which files they were
    assert documents[0] == documents[1]


def test_a_matlab_file_tells_the_rest(three, tmp_path):
    assert run(["export", str(three), "--output", str(tmp_path / "m.mat"), "--last-realisation", "0"]) == 0
    found = scipy.io.loadmat(tmp_path / "m.mat", simplify_cells=True)
    recording = open_recording(three)
    assert found["y"].shape == (3, 3, recording.run.periods * 8192)
    assert found["nodes"].tolist() == ["1", "2", "3"]
    assert found["sample_rate"] == recording.rig.sample_rate
    np.testing.assert_array_equal(found["levels"]["signal_db"], recording.levels["signal_db"])
    np.testing.assert_array_equal(found["frequencies"], recording.frequencies)


def test_the_time_of_a_period_that_never_came_is_not_a_number(tmp_path):
    """Kills a recording of the year 1677."""
    taken = list(records())
    lost = next(i for i, r in enumerate(taken) if isinstance(r, Frame) and r.realisation == 1)
    write(tmp_path / "lost.mcap", taken[:lost] + taken[lost + 1 :])
    recording = open_recording(tmp_path / "lost.mcap")
    write_mat(tmp_path / "out.mat", list(recording.experiments(1, 1)), recording)
    times = scipy.io.loadmat(tmp_path / "out.mat", squeeze_me=True)["times"]
    assert np.isnan(times[0])
    assert np.isfinite(times[1:]).all()


def test_a_universal_file_is_understood_without_our_labels(three, tmp_path):
    """Type, unit, rate and degree of freedom stand where other programs look for them."""
    assert run(["export", str(three), "--output", str(tmp_path / "m.uff")]) == 0
    sets = pyuff.UFF(str(tmp_path / "m-0001.uff")).read_sets()
    assert [s["type"] for s in sets] == [164, *[58] * 6]
    assert [s["ordinate_spec_data_type"] for s in sets[1:]] == [13, 13, 13, 8, 8, 8]
    assert [s["rsp_node"] for s in sets[1:]] == [1, 2, 3, 1, 2, 3]
    assert sets[1]["abscissa_inc"] == pytest.approx(1 / 5000, rel=1e-5)
    assert sets[0]["length"] == 1.0


def test_trends_as_a_table(tmp_path):
    write(tmp_path / "bench.mcap", records())
    assert run(["export", str(tmp_path / "bench.mcap"), "--levels", "--output", str(tmp_path / "trend.csv")]) == 0
    with (tmp_path / "trend.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    levels = open_recording(tmp_path / "bench.mcap").levels
    assert [row["node"] for row in rows] == ["left", "right side"] * 6
    wanted = levels["total_to_noise_db"].ravel().tolist()
    assert [float(row["total_to_noise_db"]) for row in rows] == wanted
    assert rows[0]["nonlinear_db"] == ""
    assert rows[0]["time"].startswith("2026-01-01T00:00:01.2")


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--output", "x.txt"], "--output: x.txt: should end in one of .csv, .mat, .uff, .unv"),
        (["--output", "x.mat", "--levels"], "--output: x.mat: levels are written as .csv"),
        (["--output", "nowhere/x.csv"], "there is no directory nowhere"),
        (["--output", "x.csv", "--first-realisation", "7"], "no realisation is complete among those that count"),
    ],
)
def test_bad_wishes_get_one_line_and_leave_nothing(arguments, line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write(Path("bench.mcap"), records(1))
    assert run(["export", "bench.mcap", *arguments]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert [path.name for path in Path().iterdir()] == ["bench.mcap"]


def test_a_failure_in_the_middle_leaves_no_file(tmp_path, monkeypatch):
    """Kills six files of which three are of an older export."""
    write(tmp_path / "bench.mcap", records(2))
    calls = count()

    def failing(*arguments):
        if next(calls) == 2:
            raise OSError(28, "No space left on device")
        write_csv(*arguments)

    monkeypatch.setattr("creak.export.write_csv", failing)
    assert run(["export", str(tmp_path / "bench.mcap"), "--output", str(tmp_path / "m.csv")]) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["bench.mcap"]
