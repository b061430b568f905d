"""What tests of processes and threads share: free ports, patience, and what Linux tells of processes."""

import socket
import time
from pathlib import Path


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(until, seconds=60.0):
    """Poll until something is true; what it gave."""
    end = time.monotonic() + seconds
    while not (found := until()):
        assert time.monotonic() < end, "timed out"
        time.sleep(0.01)
    return found


def children(parent):
    """Ids of the processes that a process has started and that live."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, above = stat.read_text().rpartition(")")[2].split()[:2]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(above) == parent and state != "Z":
            found.append(int(stat.parent.name))
    return found


def resident(process):
    """Resident set of a process and of those that it started, MiB."""
    status = Path(f"/proc/{process}/status").read_text()
    own = next(int(line.split()[1]) / 1024 for line in status.splitlines() if line.startswith("VmRSS:"))
    return own + sum(map(resident, children(process)))
