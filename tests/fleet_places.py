"""What tests and benchmarks of a fleet need: a broker of their own that can be killed, rigs, service files."""

import contextlib
import multiprocessing
import os
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

import pytest

import two_masses
from processes import free_port

SERVER = shutil.which("nats-server") or "/usr/sbin/nats-server"

RIG = two_masses.rig("{name}", transient=1)
MODEL = two_masses.model(cubic=3e9)
_COMMON = """
data = "{data}"
[stream]
url = "{broker}"
lease_seconds = {lease}
repair_seconds = 120.0
[store]
url = "{store}"
"""
_RIG = """
[[rigs]]
rig = "{name}.toml"
window = 3
"""
_MEASURED = """
model = "model.toml"
[rigs.source]
kind = "simulated"
rms = 5.0
pace = {pace}
seed = {seed}
"""
_STREAMED = """
[rigs.source]
kind = "stream"
"""


class BrokerProcess:
    """A nats-server with JetStream and a store of its own, on a port that it keeps over restarts."""

    def __init__(self, folder, largest=1 << 20):
        self._folder = Path(folder)
        self._folder.mkdir(parents=True, exist_ok=True)
        (self._folder / "nats.conf").write_text(f"max_payload: {largest}\n")
        self._port = free_port()
        self.url = f"nats://127.0.0.1:{self._port}"
        self.process = None
        self.start()

    def start(self):
        place = ["-a", "127.0.0.1", "-p", str(self._port), "-js", "-sd", str(self._folder)]
        arguments = [SERVER, *place, "-c", str(self._folder / "nats.conf")]
        self.process = subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        end = time.monotonic() + 20
        while time.monotonic() < end:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self._port), 1):
                return
            time.sleep(0.05)
        raise TimeoutError("nats-server does not listen")

    def kill(self):
        self.process.kill()
        self.process.wait()

    def close(self):
        if self.process.poll() is None:
            self.kill()


@contextlib.contextmanager
def broker(folder, largest=1 << 20):
    """A broker for a test, which is skipped where there is no server."""
    if not Path(SERVER).exists():
        if os.environ.get("CI") == "true":
            raise FileNotFoundError(SERVER)
        pytest.skip("no nats-server to test with")
    made = BrokerProcess(folder, largest)
    try:
        yield made
    finally:
        made.close()


def write_fleet(folder, broker_url, store_url, rigs, *, pace=20.0, lease=4.0):
    """Service files ``NAME-worker.toml`` for each rig and ``analyse.toml`` for all of them."""
    folder = Path(folder)
    (folder / "model.toml").write_text(MODEL)
    analyse = _COMMON.format(data="central", broker=broker_url, store=store_url, lease=lease)
    for seed, name in enumerate(rigs, start=1):
        (folder / f"{name}.toml").write_text(RIG.format(name=name))
        common = _COMMON.format(data=f"data-{name}", broker=broker_url, store="", lease=lease)
        text = common + _RIG.format(name=name) + _MEASURED.format(pace=pace, seed=seed)
        (folder / f"{name}-worker.toml").write_text(text)
        analyse += _RIG.format(name=name) + _STREAMED
    (folder / "analyse.toml").write_text(analyse)


def _run(folder, log, arguments, environment):
    """The command of a forked child; its imports are those of the server that it was forked from."""
    os.chdir(folder)
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    os.dup2(file, 1)
    os.dup2(file, 2)
    os.environ.update(environment)
    import creak.cli

    os._exit(creak.cli.run(arguments))


def _child():
    """The function of the module that is preloaded, not that of a script."""
    import fleet_places

    return fleet_places._run


class Processes:
    """Commands of creak by name, each a process of its own; all are ended by their ids.

    They are forked from a server that has the imports done, which take seconds on a busy machine.
    """

    def __init__(self, folder):
        self._folder = Path(folder)
        self.running = {}
        paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
        os.environ["PYTHONPATH"] = os.pathsep.join(dict.fromkeys(paths))  # the server looks nowhere else
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        self._context = multiprocessing.get_context("forkserver")
        self._context.set_forkserver_preload(["fleet_places", "creak.cli", "creak.sources.simulated", "nats"])

    def start(self, name, *arguments, **environment):
        log = self._folder / f"{name}.log"
        process = self._context.Process(
            target=_child(),
            args=(str(self._folder), str(log), list(map(str, arguments)), environment),
            daemon=True,
        )
        process.start()
        self.running[name] = process
        return process

    def kill(self, name, kind=signal.SIGKILL):
        process = self.running.pop(name)
        os.kill(process.pid, kind)
        process.join(30)
        assert process.exitcode is not None, f"{name} does not end"
        return process.exitcode

    def close(self):
        for process in self.running.values():
            process.kill()
            process.join()
        self.running.clear()

    def said(self, name):
        path = self._folder / f"{name}.log"
        return path.read_text(errors="replace") if path.exists() else ""
