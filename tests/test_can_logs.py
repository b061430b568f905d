"""Logs of a bus are sources like the bus."""

import subprocess
import sys
from pathlib import Path

import can
import numpy as np
import pytest

import can_rigs
from conftest import make_frames, make_rig, make_run
from creak.cli import run as creak
from creak.config.rig import rig_toml
from creak.records import Fault, FaultKind, Frame
from creak.sources.can_controller import Controller, quantised
from creak.sources.can_frames import EXTENDED, CanFrames
from creak.sources.can_log import CanLog, read_log, survey
from creak.sources.dbc import Database
from creak.sources.recording import Recording

VEHICLE = Path(__file__).parents[2] / "shared" / "data" / "vehicle-can"
FORMATS = [
    (".blf", "one frame"),
    (".asc", "one frame"),
    (".log", "one frame"),
    (".mf4", "one frame"),
    (".trc", "sync"),
]


def messages(frames):
    for i in range(len(frames)):
        identifier, length = int(frames.identifiers[i]), int(frames.lengths[i])
        yield can.Message(
            timestamp=frames.times[i] * 1e-9,
            arbitration_id=identifier & ~EXTENDED,
            is_extended_id=bool(identifier & EXTENDED),
            data=frames.data[i, :length].tobytes(),
            is_fd=length > 8,
            bitrate_switch=length > 8,
            channel=1,
        )


def written(path, frames):
    with can.Logger(path) as logger:
        for message in messages(frames):
            logger.on_message_received(message)
    return path


def sent(run, mapping, frames):
    controller = Controller(run, mapping)
    out = CanFrames.none()
    for index, frame in enumerate(frames):
        out = out + controller.frames(frame, index)
    return out


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize(("suffix", "layout"), FORMATS)
def test_every_format_gives_the_samples_that_were_sent(suffix, layout, tmp_path):
    """Kills a format that drops CAN FD payloads, long identifiers, or the order of frames."""
    run = make_run(make_rig(2, samples=64, lines=range(2, 10)), start=1_790_000_000_000_000_000)
    frames = make_frames(run, 2)
    text, signals = can_rigs.LAYOUTS[layout]
    mapping = can_rigs.mapping(tmp_path, run, text(2), signals)
    path = written(tmp_path / f"log{suffix}", sent(run, mapping, frames))
    out = list(CanLog(run, mapping, [path]).frames())
    assert [o for o in out if isinstance(o, Fault)] == []
    for one, other in zip(out, [quantised(f, mapping) for f in frames], strict=True):
        assert (one.realisation, one.experiment, one.period) == (other.realisation, other.experiment, other.period)
        np.testing.assert_array_equal(one.u, other.u)
        np.testing.assert_array_equal(one.y, other.y)


def test_a_log_that_ends_in_a_frame_is_read_up_to_there(tmp_path):
    """Kills a damaged log that is taken for a whole one."""
    run = make_run(make_rig(2, samples=64, lines=range(2, 10)))
    mapping = can_rigs.mapping(tmp_path, run, can_rigs.one_frame(2))
    path = written(tmp_path / "log.log", sent(run, mapping, make_frames(run, 2)))
    text = path.read_text()
    path.write_text(text[: 2 * len(text) // 3] + "\n(12")
    out = list(CanLog(run, mapping, [path]).frames())
    assert sum(isinstance(o, Frame) for o in out) > 3
    assert FaultKind.DAMAGED in {o.kind for o in out if isinstance(o, Fault)}


def test_import_from_the_command_line(tmp_path, capsys):
    run = make_run(make_rig(2, samples=64, lines=range(2, 10)), start=1_790_000_000_000_000_000)
    frames = make_frames(run, 3)
    mapping = can_rigs.mapping(tmp_path, run, can_rigs.one_frame(2))
    log = written(tmp_path / "rig.blf", sent(run, mapping, frames))
    (tmp_path / "rig.toml").write_text(rig_toml(run.rig))
    common = ["import", str(log), "--rig", str(tmp_path / "rig.toml"), "--dbc", str(tmp_path / "rig.dbc")]
    for name in ("a.mcap", "b.mcap"):
        assert creak([*common, "--output", str(tmp_path / name)]) == 0
    recording = Recording(tmp_path / "a.mcap")
    assert sum(isinstance(r, Frame) for r in recording.frames()) == len(frames)
    assert recording.run.id == Recording(tmp_path / "b.mcap").run.id
    assert "3 realisations" in capsys.readouterr().err


needs_vehicle = pytest.mark.skipif(not VEHICLE.exists(), reason=f"{VEHICLE} is not here")


@needs_vehicle
def test_the_vehicle_log_has_its_own_rate_and_its_invalid_samples_flagged():
    """Kills a rate that is taken from the data sheet (100 Hz) instead of the log."""
    lines = survey(VEHICLE / "00000005.MF4", Database(VEHICLE / "canmod-gps.dbc"))
    (imu,) = [line for line in lines if line.startswith("gnss_imu")]
    assert imu.startswith("gnss_imu: 4518 frames at 101.30 Hz")
    assert len(list(read_log(VEHICLE / "00000005.MF4"))) == 5477


@needs_vehicle
def test_samples_that_the_vehicle_flags_invalid_are_counted(tmp_path):
    """Kills a flag that is not looked at. In the log itself all are valid, so the first second is made invalid."""
    frames = CanFrames.of(list(read_log(VEHICLE / "00000005.MF4")))
    (imu,) = np.nonzero(frames.identifiers == 9)
    data = frames.data.copy()
    data[imu[:101], 0] &= 0xFE
    changed = CanFrames(frames.identifiers, frames.times, frames.lengths, data)
    path = written(tmp_path / "changed.blf", changed[imu])
    (line,) = survey(path, Database(VEHICLE / "canmod-gps.dbc"))
    assert line == "gnss_imu: 4518 frames at 101.30 Hz, 101 flagged invalid by ImuValid"


@needs_vehicle
def test_the_vehicle_log_cannot_be_analysed_and_the_service_says_why(tmp_path):
    (tmp_path / "rig.toml").write_text(
        'name = "car"\nsample_rate = 101.3\nperiod_samples = 256\ntransient_periods = 1\nband = [1.0, 40.0]\n'
        '[[nodes]]\nname = "body"\ninput = "N"\noutput = "m/s^2"\n'
    )
    (tmp_path / "signals.toml").write_text('responses = {body = "gnss_imu.AccelerationX"}\n')
    done = subprocess.run(
        [sys.executable, "-m", "creak.cli", "import", VEHICLE / "00000005.MF4", "--output", "car.mcap",
         "--dbc", VEHICLE / "canmod-gps.dbc", "--rig", "rig.toml", "--signals", "signals.toml"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot be analysed: no signal is an input" in done.stderr
    assert "gnss_imu: 4518 frames at 101.30 Hz" in done.stdout
    assert not (tmp_path / "car.mcap").exists()
