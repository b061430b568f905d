"""Runs the jobs of the store: each as a process of its own, nice to the acquisition, so that its end harms nobody.

A job is the command that a person would type, with ``--json``: what it prints is the job's result, and the line
that it says on failure is the reason.
"""

import contextlib
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from creak.errors import StorageError
from creak.sinks import jobs
from creak.sinks.database import Store
from creak.sinks.jobs import Claim, JobStatus, Task

_log = logging.getLogger(__name__)

_POLL_SECONDS = 0.3
_BEAT_SECONDS = 1.0
_NICE = 10
_LONGEST_REASON = 2000


class JobRunner:
    """Takes jobs from the store and runs them, some at a time.

    Parameters
    ----------
    store : Store
    directory : Path
        Where reports are kept.
    at_once : int
        Jobs that run beside each other.
    max_seconds : float
        A job that takes longer is ended and has failed.
    """

    def __init__(self, store: Store, directory: Path, *, at_once: int = 1, max_seconds: float = 1800.0) -> None:
        self._store = store
        self._directory = directory.absolute()
        self._max_seconds = max_seconds
        self._stopping = threading.Event()
        self._threads = [
            threading.Thread(target=self._serve, name=f"jobs-{number}", daemon=True) for number in range(at_once)
        ]

    def start(self) -> None:
        """Begin to take jobs."""
        for thread in self._threads:
            thread.start()

    def stop(self, seconds: float) -> None:
        """End soon: jobs that run are ended and have failed, those that wait go on waiting in the store."""
        self._stopping.set()
        deadline = time.monotonic() + seconds
        for thread in filter(threading.Thread.is_alive, self._threads):
            thread.join(max(0.0, deadline - time.monotonic()))

    def _serve(self) -> None:
        checked = float("-inf")
        while not self._stopping.wait(_POLL_SECONDS):
            try:
                if time.monotonic() - checked > jobs.SILENT_SECONDS / 3:
                    checked = time.monotonic()
                    jobs.fail_orphans(self._store, time.time_ns())
                claimed = jobs.claim(self._store, time.time_ns())
                if claimed is not None:
                    self._run(claimed)
                    self._forget()
            except Exception as error:  # noqa: BLE001 - a runner that dies would leave all that wait waiting
                # The store may come back; a job that suffered by it becomes an orphan.
                _log.error("jobs: %s", error, exc_info=None if isinstance(error, StorageError) else error)
                self._stopping.wait(_BEAT_SECONDS)

    def _run(self, claimed: Claim) -> None:
        """Run a job to its end, which is written; one that this machine cannot run has failed."""
        try:
            self._carry_out(claimed)
        except StorageError:
            raise
        except OSError as error:  # a full disk, no memory for a process
            reason = f"it cannot be run here: {error.strerror or error}"
            jobs.finish(self._store, claimed.id, JobStatus.FAILED, time.time_ns(), reason=reason)

    def _carry_out(self, claimed: Claim) -> None:
        self._directory.mkdir(parents=True, exist_ok=True)
        report = self._directory / f"{claimed.id}.html" if claimed.task.kind == "diagnosis" else None
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            process, progress = _start(claimed.task, report, out.fileno(), err.fileno())
            try:
                reason = self._watch(claimed.id, process, progress)
            finally:
                _end(process)
                progress.close()
            out.seek(0)
            err.seek(0)
            said = err.read().decode(errors="replace").strip()
            if reason is None and process.returncode == 0:
                result = out.read().decode()
                path = None if report is None else str(report)
                jobs.finish(self._store, claimed.id, JobStatus.DONE, time.time_ns(), result=result, report=path)
                return
        if report is not None:
            report.unlink(missing_ok=True)
        why = reason or _last_line(said) or f"its process ended with {process.returncode}"
        jobs.finish(self._store, claimed.id, JobStatus.FAILED, time.time_ns(), reason=why[:_LONGEST_REASON])

    def _watch(self, identifier: str, process: "subprocess.Popen[bytes]", progress: "_Progress") -> str | None:
        """Stay with a process to its end; a reason if it is to be ended before."""
        began = beaten = time.monotonic()
        while process.poll() is None:
            now = time.monotonic()
            if now - beaten >= _BEAT_SECONDS:
                beaten = now
                share, stage = progress.newest()
                if not jobs.beat(self._store, identifier, time.time_ns(), share, stage):
                    return "cancelled while it ran"
                if now - began > self._max_seconds:
                    return f"it took longer than {self._max_seconds:g} s"
            if self._stopping.wait(0.05):
                return "the service was stopped while it ran; ask for it again"
        return None

    def _forget(self) -> None:
        for path in jobs.prune(self._store):
            Path(path).unlink(missing_ok=True)


class _Progress:
    """Reading end of a job's progress."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor = descriptor
        self._rest = b""
        self._share: float | None = None
        self._stage = ""

    def newest(self) -> tuple[float | None, str]:
        """Fraction done, None if it is not known, and what is being done."""
        with contextlib.suppress(BlockingIOError):
            while data := os.read(self._descriptor, 65536):
                self._rest += data
        *lines, self._rest = self._rest.split(b"\n")
        if lines:
            share, _, stage = lines[-1].decode(errors="replace").partition("\t")
            self._share, self._stage = float(share), stage
        return self._share, self._stage

    def close(self) -> None:
        """Close it."""
        os.close(self._descriptor)


def arguments(task: Task, report: Path | None) -> list[str]:
    """Command of a task, as one would type it.

    Parameters
    ----------
    task : Task
    report : Path or None
        Page to write, for a diagnosis.
    """
    if task.kind == "replay":
        return ["replay", "--json", "--", *task.files]
    words = ["diagnose", "--json"]
    for option, value in (
        ("--model", task.model),
        *(("--healthy", part) for part in task.healthy),
        ("--first-healthy", task.first_healthy),
        ("--last-healthy", task.last_healthy),
        ("--report", report),
        ("--validate", task.validate),
        ("--first-realisation", task.first),
        ("--last-realisation", task.last),
    ):
        if value is not None:
            words += [option, str(value)]
    return [*words, "--", *task.files]


def _start(task: Task, report: Path | None, out: int, err: int) -> "tuple[subprocess.Popen[bytes], _Progress]":
    reading, writing = os.pipe()
    words = arguments(task, report)
    if task.kind == "diagnosis":
        words[1:1] = ["--progress-fd", str(writing)]
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "creak.cli", *words],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            pass_fds=(writing,),
            start_new_session=True,  # a Ctrl-C meant for the service does not reach it twice
        )
    except BaseException:
        os.close(reading)
        raise
    finally:
        os.close(writing)
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process.pid, _NICE)
    return process, _Progress(reading)


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End a process for certain."""
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(1.0)
        except subprocess.TimeoutExpired:
            process.kill()
    process.wait()


def _last_line(text: str) -> str:
    return text.splitlines()[-1].removeprefix("creak: ") if text else ""
