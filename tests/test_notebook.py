"""Recordings as a notebook sees them: arrays, times, levels and alarms as recorded, also of a cut file."""

from pathlib import Path

import numpy as np
import pytest

import creak
from creak.errors import RecordingError
from creak.records import AlarmChange, Estimate, Fault, Frame, FrameStatus, Scope
from recorded import records, run, write

FRAMES = [r for r in records() if isinstance(r, Frame) and r.status is not FrameStatus.REJECTED]
WINDOWS = [r for r in records() if isinstance(r, Estimate) and r.scope is Scope.WINDOW]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("notebook") / "bench.mcap"
    write(path, records())
    return path


def test_samples_have_the_axes_of_the_house(path: Path) -> None:
    """Catches transient periods among the steady ones, exchanged experiments, a refused frame that counts."""
    recording = creak.open_recording(path)
    steady = [frame for frame in FRAMES if frame.status is FrameStatus.ACCEPTED]
    assert recording.y.shape == (12, 2, 2, 64)  # E, P, n, N
    for frame in steady:
        at = 2 * frame.realisation + frame.experiment, frame.period - 1
        np.testing.assert_array_equal(recording.u[at], frame.u)
        np.testing.assert_array_equal(recording.y[at], frame.y)
        assert recording.times[at] == np.datetime64(frame.time, "ns")
    assert len(steady) == recording.times.size


def test_axes_have_their_units(path: Path) -> None:
    """A line of the rig is a bin of the DFT at its frequency: catches Hz for rad/s and a factor of the period."""
    recording = creak.open_recording(str(path))
    assert recording.rig == run().rig
    step = np.fft.rfftfreq(len(recording.time), recording.time[1] - recording.time[0])
    np.testing.assert_allclose(step[list(recording.rig.lines)], recording.frequencies, rtol=1e-12)


def test_levels_alarms_and_faults_are_those_recorded(path: Path) -> None:
    recording = creak.open_recording(path)
    levels = recording.levels
    assert levels.nodes == ("left", "right side")
    assert levels.times.astype(np.int64).tolist() == [window.time for window in WINDOWS]
    assert levels.realisations.tolist() == [window.realisation for window in WINDOWS]
    wanted = [[node.total_to_noise_db for node in window.nodes] for window in WINDOWS]
    assert levels["total_to_noise_db"].tolist() == wanted
    assert np.isnan(levels["nonlinear_db"]).all()  # it was not available
    assert recording.alarms == tuple(r for r in records() if isinstance(r, AlarmChange))
    assert recording.faults == tuple(r for r in records() if isinstance(r, Fault))
    assert recording.estimate is not None
    assert recording.estimate.realisations == 6
    assert (recording.truncated, recording.damage) == (False, ())


def test_opening_reads_nothing_but_the_head(path: Path, tmp_path: Path) -> None:
    """Catches a reader that is not lazy: what comes behind the head is broken only after it was opened."""
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(path.read_bytes())
    recording = creak.open_recording(copy)
    copy.write_bytes(path.read_bytes()[: len(path.read_bytes()) // 2])
    assert repr(recording) == "<recording of 'bench': copy.mcap>"
    assert recording.truncated


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.999])
def test_a_cut_file_gives_what_is_whole(path: Path, tmp_path: Path, share: float) -> None:
    """Whole realisations, from the first, each as in the whole file; catches a realisation that is half there."""
    data = path.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: int(share * len(data))])
    whole, recording = creak.open_recording(path), creak.open_recording(cut)
    count = len(recording.y)
    assert recording.truncated
    assert count % 2 == 0
    assert 12 * share - 6 < count <= 12 or share == 0.2
    np.testing.assert_array_equal(recording.y, whole.y[:count])
    np.testing.assert_array_equal(
        recording.levels["p_value"], whole.levels["p_value"][: len(recording.levels.times)]
    )


def test_a_stretch_of_realisations_is_chosen(path: Path) -> None:
    found = creak.open_recording(path).experiments(first=2, last=3)
    assert [(e.realisation, e.experiment) for e in found] == [(2, 0), (2, 1), (3, 0), (3, 1)]


def test_a_lost_transient_period_does_not_cost_the_realisation(tmp_path: Path) -> None:
    """The monitor needs steady periods only; catches a shifted period, and numbers that were never measured."""
    lost = [r for r in records() if not (isinstance(r, Frame) and (r.realisation, r.period) == (1, 0))]
    write(tmp_path / "lost.mcap", lost)
    recording = creak.open_recording(tmp_path / "lost.mcap")
    assert len(recording.y) == 12
    assert np.isfinite(recording.y).all()
    torn = [e for e in recording.experiments() if np.isnat(e.times[0])]
    assert [e.realisation for e in torn] == [1, 1]
    assert all(np.isnan(e.y[0]).all() and np.isfinite(e.y[1:]).all() for e in torn)


def test_a_late_copy_of_a_transient_period_costs_nothing(path: Path, tmp_path: Path) -> None:
    """It counts for nothing and is kept; catches a realisation that is thought over when it comes."""
    taken = list(records())
    last = next(i for i, r in enumerate(taken) if isinstance(r, Frame) and (r.realisation, r.experiment) == (3, 1))
    late = next(r for r in taken if isinstance(r, Frame) and r.realisation == 2)
    write(tmp_path / "late.mcap", [*taken[:last], late, *taken[last:]])
    np.testing.assert_array_equal(creak.open_recording(tmp_path / "late.mcap").y, creak.open_recording(path).y)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no recording is given"):
        creak.open_recording()
    with pytest.raises(RecordingError, match=r"nowhere\.mcap: cannot be read"):
        creak.open_recording(tmp_path / "nowhere.mcap")
    with pytest.raises(AttributeError, match="no attribute 'open_recordings'"):
        _ = creak.open_recordings
