"""A Dask scheduler and workers as processes of their own on loopback, as they would run on other machines."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

SOURCES = os.pathsep.join(str(Path(__file__).parents[1] / folder) for folder in ("service", "tests"))


class Machines:
    """Processes of one cluster; files go into a folder of its own."""

    def __init__(self, folder):
        self._folder = folder
        self._env = os.environ | {"PYTHONPATH": SOURCES, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._file = folder / "scheduler.json"
        self.workers = []
        self.scheduler = self._start(
            "dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
            "--scheduler-file",
            self._file,
        )
        while not self._file.exists() or not self._file.read_text():
            assert self.scheduler.poll() is None, (folder / "dask_scheduler.log").read_text()
            time.sleep(0.05)
        self.address = json.loads(self._file.read_text())["address"]

    def _start(self, module, *arguments):
        with (self._folder / f"{module}.log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.{module}", *map(str, arguments)],
                env=self._env,
                cwd=self._folder,
                stdout=log,
                stderr=log,
            )

    def add_worker(self):
        """Start a worker of one thread, without a nanny that would start it anew."""
        where = ("--local-directory", self._folder / f"worker-{len(self.workers)}")
        self.workers.append(
            self._start("dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard", *where)
        )

    def kill(self, process):
        """End a process at once, and with it all that it held."""
        process.send_signal(signal.SIGKILL)
        process.wait()

    def stop(self):
        for process in (*self.workers, self.scheduler):
            if process.poll() is None:
                self.kill(process)


@contextmanager
def machines(folder, workers):
    """A cluster of so many workers, gone afterwards."""
    cluster = Machines(folder)
    try:
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        cluster.stop()
