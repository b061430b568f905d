"""What Linux tells of processes."""

from pathlib import Path


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
