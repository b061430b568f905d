"""The API in a process of its own: an answer never waits for what a worker computes, nor a worker for an answer.

The two meet in the store alone. What the process needs comes as one line on its standard input, which then stays
open for as long as the service lives: its end tells that the service was killed, and nobody is left behind.
"""

import json
import logging
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

from creak.api.access import Access
from creak.api.app import create_app
from creak.api.server import Server
from creak.sinks.database import open_store

_log = logging.getLogger(__name__)

_FORMAT = "%(asctime)s %(levelname)s %(name)s: %(message)s"
_PAUSE_SECONDS = 1.0
_LONGEST_PAUSE_SECONDS = 30.0


@dataclass(frozen=True)
class ApiSettings:
    """What the application is made of.

    Parameters
    ----------
    store : str
        URL of the store.
    rigs : sequence of str
        Rigs without which the service is not ready.
    access : Access
    models : mapping of str to Path
        Model file of each rig that has one.
    data : Path or None
        Directory of the recordings.
    """

    store: str
    rigs: Sequence[str] = ()
    access: Access = field(default_factory=Access)
    models: Mapping[str, Path] = field(default_factory=dict)
    data: Path | None = None


class ApiProcess:
    """Runs the application on a listening socket, and starts it again should it end by itself.

    Parameters
    ----------
    settings : ApiSettings
    listener : socket.socket
        Listening. It stays open here, so clients wait while the process begins.
    """

    def __init__(self, settings: ApiSettings, listener: socket.socket) -> None:
        self._settings = settings
        self._listener = listener
        self._process: subprocess.Popen[bytes] | None = None

    def run(self) -> None:
        """Serve until KeyboardInterrupt, which is raised again."""
        pause = _PAUSE_SECONDS
        while True:
            begun = time.monotonic()
            self._process = self._start()
            code = self._process.wait()
            if time.monotonic() - begun > _LONGEST_PAUSE_SECONDS:
                pause = _PAUSE_SECONDS
            _log.error("the API ended with %d; it is started again in %g s", code, pause)
            time.sleep(pause)
            pause = min(2 * pause, _LONGEST_PAUSE_SECONDS)

    def end(self) -> None:
        """Tell the process to end; returns at once."""
        if self._process is not None:
            self._process.terminate()

    def wait(self, seconds: float) -> None:
        """Wait for its end, and end it for certain."""
        if self._process is None:
            return
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdin is not None:
            self._process.stdin.close()

    def _start(self) -> "subprocess.Popen[bytes]":
        descriptor = self._listener.fileno()
        process = subprocess.Popen(
            [sys.executable, "-m", __name__],
            stdin=subprocess.PIPE,
            pass_fds=(descriptor,),
            process_group=0,  # a Ctrl-C is for the service, which ends this one in its turn
        )
        assert process.stdin is not None
        told = {**asdict(self._settings), "listener": descriptor, "level": _log.getEffectiveLevel()}
        with suppress(BrokenPipeError):  # it has ended already, which is seen by whoever waits for it
            process.stdin.write(json.dumps(told, default=str).encode() + b"\n")
            process.stdin.flush()
        return process


def main() -> None:
    """Be the process."""
    told = json.loads(sys.stdin.buffer.readline())
    logging.basicConfig(level=told["level"], format=_FORMAT)
    threading.Thread(target=_end_with_the_service, name="service", daemon=True).start()
    store = open_store(told["store"])
    app = create_app(
        store,
        rigs_expected=told["rigs"],
        access=Access(**told["access"]),
        models_of={name: Path(path) for name, path in told["models"].items()},
        data=None if told["data"] is None else Path(told["data"]),
    )
    try:
        Server(app, socket.socket(fileno=told["listener"])).listen()
    finally:
        store.close()


def _end_with_the_service() -> None:
    sys.stdin.buffer.read()
    os._exit(1)  # at once: whoever starts the service again needs its address


if __name__ == "__main__":
    main()
