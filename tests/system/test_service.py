"""The service as a process: demo, serve, Ctrl-C, kill -9, a port in use."""

import contextlib
import json
import os
import shlex
import signal
import socket
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta

import httpx
import pytest

import two_masses
from creak.records import AlarmChange, Frame
from creak.sources.recording import Recording
from processes import children, free_port

CREAK = [sys.executable, "-m", "creak.cli"]
DEADLINE = 120.0  # seconds after which something hangs; not a figure


def wait_for(what, until, process=None):
    """Poll until something is true; what it gave."""
    end = time.monotonic() + DEADLINE
    while time.monotonic() < end:
        if process is not None and process.poll() is not None:
            pytest.fail(f"the process ended with {process.returncode} before: {what}; {process.communicate()}")
        try:
            found = until()
        except httpx.TransportError:
            found = None
        if found:
            return found
        time.sleep(0.1)
    return pytest.fail(f"timed out: {what}")


@pytest.fixture
def started():
    """Starts commands; ends by its process id whatever a failed test has left."""
    processes = []

    def start(*arguments, cwd, **environment):
        process = subprocess.Popen(
            [*CREAK, *map(str, arguments)],
            cwd=cwd,
            env={**os.environ, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            process.kill()
        process.communicate()


RIG, MODEL = two_masses.rig(), two_masses.model()
SERVICE = """
[[rigs]]
rig = "rig.toml"
model = "model.toml"
window = 2
[rigs.source]
kind = "simulated"
pace = {pace}
"""


AGAIN = """
data = "again"
[[rigs]]
rig = "rig.toml"
[rigs.source]
kind = "recording"
files = ["{file}"]
"""


@pytest.fixture
def place(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "model.toml").write_text(MODEL)
    return tmp_path


@pytest.fixture
def connect():
    """Clients of an API on loopback, closed at the end."""
    with contextlib.ExitStack() as clients:
        yield lambda port, path="": clients.enter_context(
            httpx.Client(base_url=f"http://127.0.0.1:{port}{path}", timeout=10)
        )


@pytest.fixture
def serve(started, place, connect):
    """Starts a service; gives its process and a client of its API."""

    def start(pace):
        (place / "creak.toml").write_text(SERVICE.format(pace=pace))
        port = free_port()
        process = started("serve", "creak.toml", cwd=place, CREAK_SERVER__PORT=str(port))
        client = connect(port)
        wait_for("the service is ready", lambda: client.get("/readyz").status_code == 200, process)
        return process, client

    return start


def test_the_demo_from_start_to_alarm_to_replay(started, connect, tmp_path):
    """What a new user sees: healthy nodes, then the alarm of node 3 alone, and the same from the recording."""
    port = free_port()
    process = started("demo", "--port", port, "--output", "out", cwd=tmp_path)
    client = connect(port, "/api/v1")

    def healthy():
        nodes = client.get("/rigs/beam/nodes").raise_for_status().json()["items"]
        return all(node["p_value"] is not None for node in nodes) and nodes

    def alarms():
        return client.get("/alarms").raise_for_status().json()["items"]

    wait_for("the API answers", lambda: client.get("/rigs/beam").status_code == 200, process)
    nodes = wait_for("a window of two realisations", healthy, process)
    assert [node["alarm"] for node in nodes] == ["normal"] * 3
    assert max(node["total_to_noise_db"] for node in nodes) < 1.5
    assert alarms() == []
    (alarm,) = wait_for("an alarm", alarms, process)
    assert (alarm["node"], alarm["state"], alarm["active"], alarm["class"]) == (
        "3",
        "unacknowledged",
        True,
        "process",
    )
    nodes = client.get("/rigs/beam/nodes").json()["items"]
    assert [node["alarm"] for node in nodes] == ["normal", "normal", "unacknowledged"]
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0, err
    line = out.strip().splitlines()[-1]
    assert line.startswith("creak replay ")
    replay = subprocess.run(
        [*CREAK, *shlex.split(line)[1:], "--json"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    document = json.loads(replay.stdout)
    assert document["truncated"] is False
    assert [node["alarm"] for node in document["nodes"]] == ["normal", "normal", "unacknowledged"]
    recorded = [r for r in Recording(*(tmp_path / "out").glob("*.mcap")).recorded() if isinstance(r, AlarmChange)]
    assert [(change.id, change.node, change.event) for change in recorded] == [(alarm["id"], "3", "raised")]


def test_serve_ends_on_a_signal_with_a_complete_recording(serve, place):
    """Kills a shutdown that leaves the recording without its end, for either signal."""
    for number in (signal.SIGINT, signal.SIGTERM):
        process, client = serve(pace=20.0)
        wait_for("realisations", lambda c=client: c.get("/api/v1/rigs/small").json()["frames"] > 8, process)
        process.send_signal(number)
        out, err = process.communicate(timeout=DEADLINE)
        assert process.returncode == 0, err
        recording = Recording(place / shlex.split(out.strip().splitlines()[-1])[-1])
        assert sum(isinstance(r, Frame) for r in recording.recorded()) > 8
        assert recording.truncated is False
        assert recording.end is not None


def test_the_store_lists_what_was_recorded_and_keeps_history_and_state_over_a_restart(serve):
    """Kills a monitor that begins afresh because a quick simulation had run ahead of the wall clock."""
    process, client = serve(pace=1000.0)
    wait_for("history", lambda: len(client.get("/api/v1/rigs/small/history").json()["items"]) > 2, process)
    assert [r["status"] for r in client.get("/api/v1/recordings").json()["items"]] == ["writing"]
    client.post("/api/v1/rigs/small/nodes/2/retire", json={"by": "ada"}).raise_for_status()
    out = {"2": "out_of_service"}
    wait_for("node 2 out of service", lambda: client.get("/api/v1/rigs/small").json()["alarms"] == out, process)
    far = (datetime.now(UTC) + timedelta(minutes=2)).isoformat()
    wait_for("recorded time far ahead", lambda: client.get("/api/v1/rigs/small").json()["last"] > far, process)
    before = client.get("/api/v1/rigs/small").json()
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=DEADLINE)
    process, client = serve(pace=1000.0)
    after = client.get("/api/v1/rigs/small").json()
    assert after["start"] > before["last"]
    assert after["alarms"] == out
    wait_for("a second recording", lambda: len(client.get("/api/v1/recordings").json()["items"]) == 2, process)
    recordings = client.get("/api/v1/recordings").json()["items"]
    assert sorted(r["status"] for r in recordings) == ["complete", "writing"]


def test_kill_9_loses_at_most_the_open_period_and_one_second(serve, place):
    """In real time the recorded time of a frame's end is the wall time at which it came."""
    process, client = serve(pace=1.0)
    wait_for("some frames", lambda: client.get("/api/v1/rigs/small").json()["frames"] >= 8, process)
    time.sleep(0.63)
    killed = time.time_ns()
    process.kill()
    process.communicate()
    (path,) = (place / "var").glob("*.mcap")
    recording = Recording(path)
    frames = [f for f in recording.frames() if isinstance(f, Frame)]
    assert recording.truncated is True
    period = recording.run.rig.period_ns
    # The second of the flush, the open period, and what a loaded machine may be late in simulating.
    assert killed - (frames[-1].time + period) < 1e9 + period + 1e9
    numbers = [(f.realisation, f.experiment, f.period) for f in frames]
    assert numbers == [(i // 8, i // 4 % 2, i % 4) for i in range(len(frames))]  # none is missing before


def test_an_api_that_dies_comes_back_and_one_whose_service_dies_goes(serve):
    """Kills an API that takes the measuring with it, and one that keeps the address of a killed service."""
    process, client = serve(pace=20.0)
    before = client.get("/api/v1/rigs/small").json()
    (api,) = children(process.pid)
    os.kill(api, signal.SIGKILL)
    client.close()
    with httpx.Client(base_url=client.base_url, timeout=10) as client:
        after = wait_for("the API answers again", lambda: client.get("/api/v1/rigs/small").json(), process)
        assert after["run"] == before["run"]
        assert after["frames"] > before["frames"]
        (api,) = children(process.pid)
    process.kill()
    process.communicate()
    wait_for("the API's end", lambda: not os.path.exists(f"/proc/{api}"))
    with socket.create_server(("127.0.0.1", client.base_url.port)):
        pass


def test_beyond_loopback_nothing_is_answered_without_a_key(started, connect, place):
    """Kills a service that a network can read, and a key that is good only in its own process."""
    (place / "creak.toml").write_text(SERVICE.format(pace=20.0))
    port = free_port()
    process = started("serve", "creak.toml", cwd=place, CREAK_SERVER__PORT=str(port), CREAK_SERVER__HOST="0.0.0.0")
    client = connect(port)
    wait_for("the service is ready", lambda: client.get("/readyz").status_code == 200, process)
    refused = client.get("/api/v1/rigs")
    assert (refused.status_code, refused.headers["www-authenticate"]) == (401, "Bearer")
    made = started("key", "add", "wall", "--config", "creak.toml", cwd=place)
    token, err = made.communicate(timeout=DEADLINE)
    assert made.returncode == 0, err
    allowed = client.get("/api/v1/rigs", headers={"Authorization": f"Bearer {token.strip()}"})
    assert [rig["name"] for rig in allowed.json()["items"]] == ["small"]
    process.send_signal(signal.SIGTERM)
    assert "no keys yet" in process.communicate(timeout=DEADLINE)[1]


def test_a_port_in_use_is_one_line_and_touches_nothing(started, place):
    (place / "creak.toml").write_text(SERVICE.format(pace=1.0))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        for command in (["serve", "creak.toml"], ["demo"]):
            process = started(*command, cwd=place, CREAK_SERVER__PORT=str(port))
            out, err = process.communicate(timeout=DEADLINE)
            assert process.returncode == 1
            assert out == ""
            assert err.count("\n") == 1
            assert str(port) in err
    assert {path.name for path in place.iterdir()} == {"rig.toml", "model.toml", "creak.toml"}


def test_a_recording_is_a_source_and_gives_the_same_alarm_list(started, serve, connect, place):
    """Serving a recording again fills a store like the live run did."""
    process, client = serve(pace=20.0)
    wait_for("realisations", lambda: client.get("/api/v1/rigs/small").json()["frames"] >= 12, process)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=DEADLINE)
    recorded = shlex.split(out.strip().splitlines()[-1])[-1]
    text = (
        f'data = "again"\n[[rigs]]\nrig = "rig.toml"\n[rigs.source]\nkind = "recording"\nfiles = ["{recorded}"]\n'
    )
    (place / "again.toml").write_text(text)
    port = free_port()
    process = started("serve", "again.toml", cwd=place, CREAK_SERVER__PORT=str(port))
    client = connect(port, "/api/v1")
    expected = subprocess.run([*CREAK, "replay", "--json", recorded], cwd=place, capture_output=True, check=True)
    frames = json.loads(expected.stdout)["frames"]
    wait_for("the whole recording", lambda: client.get("/rigs/small").json().get("frames") == frames, process)
    nodes = client.get("/rigs/small/nodes", params={"scope": "run"}).json()["items"]
    for node, level in zip(nodes, json.loads(expected.stdout)["nodes"], strict=True):
        assert node["total_to_noise_db"] == level["total_to_noise_db"]
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=DEADLINE)


def test_a_recording_of_another_rig_is_refused(started, serve, place):
    process, client = serve(pace=20.0)
    wait_for("a frame", lambda: client.get("/api/v1/rigs/small").json()["transient_frames"] > 0, process)
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=DEADLINE)
    recorded = shlex.split(out.strip().splitlines()[-1])[-1]
    (place / "rig.toml").write_text(RIG.replace("1024.0", "2048.0"))
    text = (
        f'data = "again"\n[[rigs]]\nrig = "rig.toml"\n[rigs.source]\nkind = "recording"\nfiles = ["{recorded}"]\n'
    )
    (place / "again.toml").write_text(text)
    process = started("serve", "again.toml", cwd=place)
    out, err = process.communicate(timeout=DEADLINE)
    assert process.returncode == 2
    assert "another rig" in err
    assert err.count("\n") == 1
    assert not (place / "again").exists()
