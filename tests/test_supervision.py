"""What systemd is told, on a real socket: ready, and alive as long as all loops that measure are."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest
from test_service import MODEL, RIG, SERVICE

from creak.cli.supervision import Supervisor
from creak.errors import RigError
from creak.records import RunStatus
from creak.worker import Worker, drive
from test_worker import Frames, Keeper, finished, make_frames, make_rig, make_run

PATIENCE = 1.0  # of the watchdog, s; a loop ticks every 0.2 s at least


class Manager:
    """The socket of a service manager."""

    def __init__(self, name):
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind("\0" + name[1:] if name.startswith("@") else name)
        self.name = name

    def environment(self, **more):
        return {"NOTIFY_SOCKET": self.name, "WATCHDOG_USEC": str(round(PATIENCE * 1e6))} | more

    def heard(self, seconds=0.0):
        """All that comes within a time."""
        found, end = [], time.monotonic() + seconds
        while True:
            self.socket.settimeout(max(0.001, end - time.monotonic()))
            try:
                found.append(self.socket.recv(4096).decode())
            except TimeoutError:
                if time.monotonic() >= end:
                    return found


@pytest.fixture
def manager(tmp_path):
    made = Manager(str(tmp_path / "notify"))
    yield made
    made.socket.close()


class Open(Frames):
    """A source that stays open after its frames, as a rig that has fallen silent."""

    live = True

    def __init__(self, run, frames):
        super().__init__(run, frames)
        self.over = False

    def frames(self):
        yield from super().frames()
        while not self.over:
            time.sleep(0.01)

    def close(self):
        self.over = True


class Breaking(Frames):
    """A source that fails after its frames."""

    def frames(self):
        yield from super().frames()
        raise RigError("the interface is gone")


class Hanging(Keeper):
    """A sink that does not come back, as a write to a file server that is gone."""

    def __init__(self, after):
        super().__init__()
        self.after, self.free = after, False

    def take(self, record):
        super().take(record)
        while len(self.records) > self.after and not self.free:
            time.sleep(0.01)


@pytest.fixture(scope="module")
def run():
    made = make_run(make_rig(1, samples=32, lines=range(2, 6)), steady=2)
    drive(Frames(made, make_frames(made, 4)), [])  # kernels are compiled before anything is timed
    return made


def fed(messages):
    return messages.count("WATCHDOG=1")


def test_a_loop_feeds_also_where_the_rig_is_silent(run, manager):
    """Kills a watchdog that takes a machine at rest for a dead service."""
    supervisor = Supervisor(manager.environment())
    worker = Worker(Open(run, make_frames(run, 2)), [supervisor.watch("rig")])
    worker.start()
    supervisor.ready()
    heard = manager.heard(3 * PATIENCE)
    assert 3 <= fed(heard) <= 13  # at least once in the watchdog's time, and not at every tick
    assert "READY=1" in heard
    assert "STATUS=rig: 2 realisations" in heard
    supervisor.stopping()
    worker.stop()
    assert "STOPPING=1" in manager.heard(0.1)


@pytest.mark.parametrize("death", ["failed", "hung"])
def test_a_dead_acquisition_is_not_covered_by_one_that_lives(run, manager, death):
    """Kills a watchdog fed by a timer, by the API's thread, or by any one of several rigs."""
    supervisor = Supervisor(manager.environment())
    alive = Worker(Open(run, []), [supervisor.watch("alive")])
    hanging = Hanging(after=4 if death == "hung" else 10**9)
    kind = Breaking if death == "failed" else Open
    dead = Worker(kind(run, make_frames(run, 4)), [hanging, supervisor.watch("dead")])
    alive.start()
    dead.start()
    manager.heard(PATIENCE)  # what was fed until then
    heard = manager.heard(2 * PATIENCE)
    assert alive.running
    assert fed(heard) == 0
    assert not [message for message in heard if message.startswith("WATCHDOG")]  # nor is it switched off
    hanging.free = True
    for worker in (alive, dead):
        worker.stop()


def test_runs_that_are_complete_leave_no_watchdog(run, manager):
    """A service that has played its recordings goes on to answer; kills one that is restarted for ever."""
    supervisor = Supervisor(manager.environment())
    worker = Worker(Frames(run, make_frames(run, 1)), [supervisor.watch("rig")])
    worker.start()
    assert finished(worker).status is RunStatus.COMPLETED
    assert manager.heard(0.1)[-1] == "WATCHDOG_USEC=0"


def test_an_abstract_address_is_understood():
    manager = Manager(f"@creak-test-{os.getpid()}")
    Supervisor({"NOTIFY_SOCKET": manager.name}).ready()
    assert manager.heard(0.1) == ["READY=1"]
    manager.socket.close()


def test_a_service_that_only_answers_has_no_watchdog(manager):
    """Kills `creak serve --api-only` that is started again every two minutes."""
    Supervisor(manager.environment()).ready()
    assert manager.heard(0.1) == ["READY=1\nWATCHDOG_USEC=0"]


@pytest.mark.parametrize("environment", [{}, {"NOTIFY_SOCKET": "/nowhere/notify", "WATCHDOG_USEC": "100000"}])
def test_without_a_manager_nothing_happens(run, environment):
    supervisor = Supervisor(environment)
    keeper = Keeper()
    worker = Worker(Frames(run, make_frames(run, 1)), [keeper, supervisor.watch("rig")])
    worker.start()
    supervisor.ready()
    assert finished(worker).status is RunStatus.COMPLETED
    assert not keeper.end.message


def test_a_watchdog_of_another_process_is_left_alone(run, manager):
    supervisor = Supervisor(manager.environment(WATCHDOG_PID="1"))
    worker = Worker(Open(run, []), [supervisor.watch("rig")])
    worker.start()
    assert fed(manager.heard(2 * PATIENCE)) == 0
    worker.stop()


def test_the_service_speaks_for_itself(manager, tmp_path):
    """The real process: ready once it answers, fed while it measures, and it says when it stops."""
    for name, text in (("rig.toml", RIG), ("model.toml", MODEL), ("creak.toml", SERVICE.format(pace=5.0))):
        (tmp_path / name).write_text(text)
    environment = {**os.environ, **manager.environment(WATCHDOG_USEC="8000000"), "CREAK_SERVER__PORT": "0"}
    environment.pop("WATCHDOG_PID", None)
    command = [sys.executable, "-m", "creak.cli", "serve", "creak.toml"]
    process = subprocess.Popen(command, cwd=tmp_path, env=environment, stderr=subprocess.PIPE)
    try:
        heard = []
        end = time.monotonic() + 120
        while not ("READY=1" in heard and fed(heard) and any("realisations" in said for said in heard)):
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < end, heard
            heard += manager.heard(0.2)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
        assert "STOPPING=1" in manager.heard(0.1)
    finally:
        process.kill()
        process.communicate()
