"""A rig's controller and the service in two processes, over python-can's multicast bus on this machine alone.

With CREAK_TEST_BUS=vcan0 in the environment they use that interface of the kernel's SocketCAN instead.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time

import httpx
import numpy as np
import pytest

import can_rigs
import two_masses
from conftest import make_run
from creak.config.can import CanSource
from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.config.service import load_service
from creak.monitor import Monitor
from creak.records import AlarmChange, Estimate, Fault, FaultKind, Frame, FrameStatus, Scope
from creak.sources.can_controller import quantised
from creak.sources.can_mapping import map_signals
from creak.sources.dbc import Database
from creak.sources.recording import Recording
from creak.sources.simulated import SimulatedRig
from processes import free_port

CREAK = [sys.executable, "-m", "creak.cli"]
DEADLINE = 100.0  # loops may have to be compiled first, and in an emulated machine all is slow
RIG, MODEL = two_masses.rig(), two_masses.model()
SERVICE = """
data = "var"
[[rigs]]
rig = "rig.toml"
model = "model.toml"
window = 2
[rigs.source]
kind = "can"
dbc = "rig.dbc"
fd = true
silence = 0.5
"""
MULTICAST = """
interface = "udp_multicast"
channel = "239.74.163.66"
options = {{ port = {port}, hop_limit = 0 }}
"""
SOCKETCAN = os.environ.get("CREAK_TEST_BUS")


@pytest.fixture
def place(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "model.toml").write_text(MODEL)
    bus = (
        f'interface = "socketcan"\nchannel = "{SOCKETCAN}"\n' if SOCKETCAN else MULTICAST.format(port=free_port())
    )
    (tmp_path / "creak.toml").write_text(SERVICE + bus)
    (tmp_path / "rig.dbc").write_text(can_rigs.one_frame(2, scales=("0.001", "1e-07")))
    return tmp_path


@contextlib.contextmanager
def serving(place):
    """The service on a bus; gives its process and a client of its API."""
    port = free_port()
    process = subprocess.Popen(
        [*CREAK, "serve", "creak.toml"],
        cwd=place,
        env={**os.environ, "CREAK_SERVER__PORT": str(port)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=10) as client:
        try:
            wait_for(lambda: client.get("/api/v1/rigs/small").status_code == 200, process)
            yield process, client
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            process.communicate(timeout=DEADLINE)


def wait_for(until, process):
    end = time.monotonic() + DEADLINE
    while time.monotonic() < end:
        assert process.poll() is None, process.communicate()
        with contextlib.suppress(httpx.TransportError):
            if found := until():
                return found
        time.sleep(0.05)
    pytest.fail(f"waited {DEADLINE} s in vain")


def play(place, *options):
    done = subprocess.run(
        [*CREAK, "rig", "creak.toml", "--json", *map(str, options)],
        cwd=place,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def simulated(place, realisations):
    """The frames that the rig played, as they are and with the resolution of the DBC."""
    rig = load_rig(place / "rig.toml")
    source = SimulatedRig(
        rig,
        load_model(place / "model.toml"),
        steady_periods=2,
        rms=1.0,
        seed=1,
        snr_db=40.0,
        realisations=realisations,
    )
    table = load_service(place / "creak.toml").rigs[0].source
    assert isinstance(table, CanSource)
    mapping = map_signals(Database(table.dbc), table, source.run, "creak.toml", "source")
    frames = list(source.frames())
    return frames, [quantised(frame, mapping) for frame in frames]


def test_two_processes_give_the_simulation_to_the_last_bit_of_the_dbc(place):
    """Kills any sample that is lost, moved or rescaled between the simulation and the estimate."""
    with serving(place) as (process, client):
        sent = play(
            place, "--realisations", 3, "--pace", 1 if SOCKETCAN else 4, "--jitter", 0.001, "--drift-ppm", 100
        )
        assert sent["frames"] == 3 * 2 * 4 * 64
        wait_for(lambda: client.get("/api/v1/rigs/small").json()["frames"] == 12, process)
    recording = Recording(*(place / "var").glob("*.mcap"))
    recorded = list(recording.recorded())
    frames = [r for r in recorded if isinstance(r, Frame)]
    played, expected = simulated(place, 3)
    assert len(frames) == len(expected)
    for frame, other in zip(frames, expected, strict=True):
        assert (frame.realisation, frame.experiment, frame.period) == (
            other.realisation,
            other.experiment,
            other.period,
        )
        np.testing.assert_array_equal(frame.u, other.u)
        np.testing.assert_array_equal(frame.y, other.y)
    assert {r.kind for r in recorded if isinstance(r, Fault)} <= {FaultKind.SILENT}  # before and after the play
    last = [r for r in recorded if isinstance(r, Estimate) and r.scope is Scope.RUN][-1]
    monitor = Monitor(make_run(load_rig(place / "rig.toml")))
    outcomes = [outcome for frame in played for outcome in monitor.take(frame)]
    own = [o for o in outcomes if isinstance(o, Estimate) and o.scope is Scope.RUN][-1]
    for one, other in zip(last.nodes, own.nodes, strict=True):
        assert abs(one.noise_db - other.noise_db) < 0.05
        assert abs(one.total_to_noise_db - other.total_to_noise_db) < 0.05


def test_faults_on_the_way_are_named_and_cost_no_more_than_they_touch(place):
    """Kills a frame that enters damaged, and a rig that falls silent without a word."""
    with serving(place) as (process, client):
        sent = play(
            place, "--realisations", 6, "--pace", 4, "--lost", 0.002, "--doubled", 0.01, "--reordered", 0.01,
            "--corrupted", 0.001, "--bus-errors", 0.002, "--restart-at", 3.2, "--bus-off-at", 5.0,
        )  # fmt: skip
        assert sent["lost"] > 0
        wait_for(lambda: client.get("/api/v1/rigs/small").json()["faults"]["silent"] >= 1, process)
        metrics = client.get("/metrics").text
        assert 'creak_faults_total{kind="silent",rig="small"}' in metrics
    recorded = list(Recording(*(place / "var").glob("*.mcap")).recorded())
    kinds = {r.kind for r in recorded if isinstance(r, Fault)}
    assert {FaultKind.LOST, FaultKind.DOUBLED, FaultKind.CORRUPTED, FaultKind.RESTARTED} <= kinds
    assert {FaultKind.BUS_ERROR, FaultKind.BUS_OFF, FaultKind.SILENT} <= kinds
    expected = {frame.y.tobytes() for frame in simulated(place, 6)[1]}
    accepted = [r for r in recorded if isinstance(r, Frame) and r.status is FrameStatus.ACCEPTED]
    assert len(accepted) > 20
    assert all(frame.y.tobytes() in expected for frame in accepted)
    changes = [r for r in recorded if isinstance(r, AlarmChange)]
    assert {change.class_ for change in changes} == {"quality"}
    assert changes[-1].event == "raised"
    assert changes[-1].active
