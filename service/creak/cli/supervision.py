"""What the service tells systemd: that it is ready, and, fed by the loops that measure, that it lives.

The protocol is that of sd_notify(3): datagrams on the socket that ``NOTIFY_SOCKET`` names. The watchdog is fed
from within those loops, never by a timer beside them: one that hangs or has failed ends the feeding, and systemd
starts the service again. A rig that is silent is no reason, since its loop goes on; it has an alarm.
"""

import contextlib
import os
import socket
import threading
import time
from collections.abc import Mapping

from creak.digests import Outcome
from creak.records import Estimate, Run, RunEnd, RunStatus, Scope

_SHARE = 0.25  # of the watchdog's time, after which it is fed again: half is what systemd recommends at most
_BEGIN_SECONDS = 120.0  # that a loop has for its first tick: kernels are compiled


class Supervisor:
    """The service manager that started this process, if there is one.

    Parameters
    ----------
    environment : mapping of str to str
        Where systemd leaves ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID``.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        mine = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = environment.get("WATCHDOG_USEC", "")
        self._patience = int(usec) / 1e6 if mine and usec.isdigit() else 0.0
        self._lock = threading.Lock()
        self._ticked: dict[str, float] = {}  # rigs that are measured, and when their loops last came by
        self._failed = False
        self._fed = float("-inf")

    def ready(self) -> None:
        """Tell that the service has started; one that has nothing to measure, but to answer, has no watchdog."""
        with self._lock:
            idle = not self._ticked and not self._failed
        self._tell("READY=1\nWATCHDOG_USEC=0" if idle and self._patience else "READY=1")

    def stopping(self) -> None:
        """Tell that the service is about to end."""
        self._tell("STOPPING=1")

    def watch(self, rig: str) -> "RigWatch":
        """Give the sink through which the loop of a rig feeds the watchdog."""
        return RigWatch(self, rig)

    def begin(self, rig: str) -> None:
        """Count on the loop of a rig from now on."""
        with self._lock:
            self._ticked[rig] = time.monotonic() + _BEGIN_SECONDS

    def tick(self, rig: str, now: float) -> None:
        """Feed the watchdog if it is time and no other loop is overdue.

        Parameters
        ----------
        rig : str
        now : float
            Monotonic time in seconds.
        """
        with self._lock:
            self._ticked[rig] = now
            overdue = any(now - then > self._patience / 2 for then in self._ticked.values())
            if not self._patience or self._failed or overdue or now - self._fed < self._patience * _SHARE:
                return
            self._fed = now
        self._tell("WATCHDOG=1")

    def end(self, rig: str, status: RunStatus) -> None:
        """No longer count on a loop; one that failed is never forgiven, and without loops there is no watchdog."""
        with self._lock:
            self._ticked.pop(rig, None)
            self._failed = self._failed or status is RunStatus.FAILED
            over = not self._ticked and not self._failed
        if over and self._patience:
            self._tell("WATCHDOG_USEC=0")

    def status(self, line: str) -> None:
        """Tell in one line what is going on, for ``systemctl status``."""
        self._tell(f"STATUS={line}")

    def _tell(self, message: str) -> None:
        if not self._address:
            return
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as to:
            to.setblocking(False)  # a manager that does not listen must not hold the loop up
            to.sendto(message.encode(), address)


class RigWatch:
    """Sink that tells the supervisor of the loop which ticks it."""

    def __init__(self, supervisor: Supervisor, rig: str) -> None:
        self._supervisor = supervisor
        self._rig = rig

    def open(self, run: Run) -> None:
        """Begin to count on the loop."""
        self._supervisor.begin(self._rig)

    def take(self, record: Outcome) -> None:
        """Tell of every complete realisation."""
        if isinstance(record, Estimate) and record.scope is Scope.RUN:
            self._supervisor.status(f"{self._rig}: {record.realisations} realisations")

    def tick(self, now: float) -> None:
        """Feed the watchdog."""
        self._supervisor.tick(self._rig, now)

    def close(self, end: RunEnd) -> None:
        """The loop is over."""
        self._supervisor.end(self._rig, end.status)
