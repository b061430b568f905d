"""Memory of the service over rig time: one rig at the highest pace, its processes' resident sets together.

After a warm-up (the first quarter of the rig time) it must stay flat; what is told is its slope from there, by
least squares, and its range.
"""

import argparse
import asyncio
import json
import socket
import sys
import tempfile
import time
from datetime import datetime
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from bench import bench_load
from processes import resident


async def _watch(process, port, hours, seconds):
    """Points ``(recorded hours, MiB)`` until so many hours have been recorded or the time is up."""
    points, end, counts = [], time.monotonic() + seconds, {}
    while time.monotonic() < end and (not points or points[-1][0] < hours):
        await asyncio.sleep(1.0)
        try:
            (rig,) = (await bench_load._rigs(port)).values()
        except (OSError, ValueError):
            if process.poll() is not None:
                raise SystemExit("the service has ended") from None
            continue
        if rig["last"] is not None:
            span = datetime.fromisoformat(rig["last"]) - datetime.fromisoformat(rig["start"])
            points.append((span.total_seconds() / 3600, resident(process.pid)))
            counts = {name: rig[name] for name in ("realisations", "frames", "rejected_frames", "faults")}
    return points, counts


def measure(hours=1.0, seconds=600.0):
    """Run one rig at the highest pace until so much rig time is over, at most so many seconds."""
    with tempfile.TemporaryDirectory() as name, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        process = bench_load.service(Path(name), port, names=("north",), more="pace = 1e6\n")
        begun = time.monotonic()
        try:
            points, counts = asyncio.run(_watch(process, port, hours, seconds))
        finally:
            bench_load.end(process)
        took = time.monotonic() - begun
    at, size = np.array(points).T
    warm = at >= at[-1] / 4
    return {
        "rig_hours": round(float(at[-1]), 3),
        "seconds": round(took, 1),
        **counts,
        "mib_at_warm_up": round(float(size[warm][0]), 1),
        "mib_at_end": round(float(size[-1]), 1),
        "mib_least_after_warm_up": round(float(size[warm].min()), 1),
        "mib_most_after_warm_up": round(float(size[warm].max()), 1),
        "mib_per_rig_hour": round(float(np.polyfit(at[warm], size[warm], 1)[0]), 1),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="rig time")
    parser.add_argument("--seconds", type=float, default=600.0, help="longest wall time")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = measure(options.hours, options.seconds)
    print(json.dumps(result, indent=None if options.json else 2))


if __name__ == "__main__":
    main()
