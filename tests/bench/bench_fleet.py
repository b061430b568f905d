"""How many beam rigs one machine carries in real time without losing a frame.

The service runs with all its parts (monitors, recordings, store, API) in a process of its own; only the sources
are the benchmark's: live ones, which cannot wait, and hand over frames made beforehand when a period of the rig is
over (three nodes, 16384 samples at 4096 Hz; three transient and three steady periods an experiment). What is told
comes from the service's own metrics: complete realisations against those due, frames lost or refused, how far the
newest recorded time stays behind the clock, and how long it took until all that was due at the end was told. All
rigs end their realisations within one period of four seconds, so the store gets them at once. Cores and memory are
those of the service and its children.

With ``--step K`` K rigs are added from run to run until one does not hold, and the most that does is sought
between the last two, to a quarter of K. A run holds if no frame was lost or refused, all due realisations were
told in time, the service lived and left memory, and the store had worked off a round of realisations before the
next.
"""

import itertools
import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from bench.bench_replay import beam_frames
from conftest import make_rig, make_run
from processes import children, resident

STEADY, FRAMES_EACH, PERIOD = 3, 18, 4.0  # steady periods an experiment; frames a realisation; s
PATIENCE = 120.0  # s after which what is due and not told counts as lost
ROUND = FRAMES_EACH * PERIOD  # s from one realisation of a rig to the next
FREE = 1 << 30  # bytes of memory below which a run is given up


def offsets(count):
    """When the rigs begin, in seconds from the start of the service: evenly over a period, when all are set up."""
    return [10.0 + 0.05 * count + PERIOD * k / count for k in range(count)]


class Prepared:
    """A live source of frames made beforehand, in real time; rigs are out of step with each other."""

    live = True

    def __init__(self, rig, frames, late):
        run = make_run(rig, steady=STEADY, start=time.time_ns() + round(late * 1e9), run_id=f"{rig.name}-run")
        self.run = replace(run, source="can")
        self._frames, self._closed = frames, threading.Event()

    def frames(self):
        run, period = self.run, self.run.rig.period_ns
        for index in itertools.count():
            end = run.start + (index + 1) * period
            if self._closed.wait(max(0.0, (end - time.time_ns()) / 1e9)):
                return
            frame = self._frames[index % len(self._frames)]
            yield replace(frame, realisation=index // FRAMES_EACH, time=run.start + round(index * period))

    def close(self):
        self._closed.set()


def serve(folder, port, count):
    """Run the service with so many rigs; this process is the service."""
    from creak.api.server import listen_on
    from creak.cli.service import _run
    from creak.config.rig import rig_toml
    from creak.config.service import parse_service

    rig = replace(make_rig(3, samples=16384, lines=range(1, 2001), transient=3), sample_rate=4096.0)
    frames = list(beam_frames(make_run(rig, steady=STEADY), 2, np.random.default_rng(0)))
    (folder / "rig.toml").write_text(rig_toml(rig), encoding="utf-8")
    table = {"rig": "rig.toml", "source": {"kind": "recording", "files": ["none.mcap"]}}
    settings = parse_service({"data": "var", "rigs": [table] * count}, "fleet", folder)
    rigs = [replace(rig, name=f"beam-{k:03d}") for k in range(count)]
    with closing(listen_on("127.0.0.1", port)) as listener:
        sources = [Prepared(rig, frames, late) for rig, late in zip(rigs, offsets(count), strict=True)]
        (folder / "begun").write_text(repr(time.time()))
        return _run(settings, "fleet", rigs, sources, listener, [[] for _ in sources])


def metrics(port):
    """Samples of the service's metrics: ``{(name, labels): value}``."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30) as answer:
        text = answer.read().decode()
    samples = re.findall(r"^(\w+)(?:\{(.*)\})? (\S+)$", text, re.MULTILINE)
    return {(name, labels): float(value) for name, labels, value in samples}


def total(samples, name, label=""):
    return sum(value for (key, labels), value in samples.items() if key == name and label in labels)


def used(pid):
    """Processor seconds and resident MiB of a process and its children."""
    seconds = 0.0
    for one in (pid, *children(pid)):
        fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
        seconds += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return seconds, resident(pid)


def available():
    """Bytes of memory that the machine has left."""
    return 1024 * int(re.search(r"MemAvailable:\s+(\d+)", Path("/proc/meminfo").read_text())[1])


def measure(count, seconds):
    """Run so many rigs for so long; a row of the table."""
    with tempfile.TemporaryDirectory() as name, socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
        probe.close()
        service = subprocess.Popen(
            [sys.executable, __file__, "--serve", name, "--port", str(port), "--rigs", str(count)],
            stdout=subprocess.DEVNULL,
        )
        lags = []
        try:
            samples = {}
            setting_up = time.monotonic()
            while total(samples, "creak_frames_total") < count:  # all of them have begun
                if service.poll() is not None:
                    raise SystemExit("the service has ended")
                if time.monotonic() - setting_up > PATIENCE + offsets(count)[-1]:
                    break
                time.sleep(1.0)
                try:
                    samples = metrics(port)
                except (OSError, urllib.error.URLError):
                    continue
            before, begun = used(service.pid)[0], time.monotonic()
            start = float((Path(name) / "begun").read_text())
            held = "yes"
            while time.monotonic() - begun < seconds and held == "yes":
                time.sleep(5.0)
                if service.poll() is not None:
                    raise SystemExit("the service has ended")
                if available() < FREE:
                    held = "memory"
                try:
                    samples = metrics(port)
                except (OSError, urllib.error.URLError):  # busy; the next answer tells as much
                    continue
                now = time.time()
                newest = [v for (key, _), v in samples.items() if key == "creak_last_recorded_timestamp_seconds"]
                if newest:
                    lags.append((now, now - min(newest) - PERIOD))
            took = time.monotonic() - begun
            after, mib = used(service.pid)
            ended = time.time()
            due = sum(int((ended - start - late) // (PERIOD * FRAMES_EACH)) for late in offsets(count))
            while (told := total(samples, "creak_realisations_total")) < due and time.time() - ended < PATIENCE:
                if service.poll() is not None:
                    raise SystemExit("the service has ended")
                with suppress(OSError, urllib.error.URLError):
                    samples = metrics(port)
            late = time.time() - ended
        finally:
            service.send_signal(signal.SIGTERM)
            try:
                service.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                service.kill()
                service.wait()
        written = sum(path.stat().st_size for path in Path(name).glob("var/*.mcap")) / 1e6
    lost = int(total(samples, "creak_faults_total", 'kind="lost"'))
    refused = int(total(samples, "creak_frames_total", 'status="rejected"'))
    behind = [lag for _, lag in lags]
    # Each round of realisations comes at once; a store that keeps up has caught up some time in the last of them.
    caught_up = min((lag for at, lag in lags if at > ended - ROUND), default=float("inf"))
    if held == "yes" and lost + refused:
        held = "frames"
    if held == "yes" and told < due:
        held = "realisations"
    if (
        held == "yes" and caught_up > 2 * PERIOD
    ):  # one it lags by itself, since some rig is always at the end of one
        held = "store"
    return {
        "rigs": count,
        "held": held,
        "seconds": round(took),
        "realisations due": due,
        "complete": int(told),
        "all told after s": late,
        "frames lost": lost,
        "refused": refused,
        "seconds behind": max(behind, default=float("inf")),
        "least behind, last round": caught_up,
        "cores": (after - before) / took,
        "MiB": round(mib),
        "MB recorded": round(written),
    }


def raised(first, step, seconds):
    """Rows of ever more rigs until a run does not hold, then of those between the last two."""
    rows, good, bad = [], 0, None
    count = first
    while bad is None or bad - good > max(1, step // 4):
        try:
            row = measure(count, seconds)
        except SystemExit as why:
            row = {"rigs": count, "held": str(why)}
        else:
            rows.append(row)
        print(", ".join(f"{key} {value}" for key, value in row.items()), file=sys.stderr, flush=True)
        good, bad = (count, bad) if row["held"] == "yes" else (good, count)
        count = count + step if bad is None else (good + bad) // 2
    return sorted(rows, key=lambda row: row["rigs"]), good


def main():
    if "--serve" in sys.argv:
        folder, port, count = (sys.argv[sys.argv.index(key) + 1] for key in ("--serve", "--port", "--rigs"))
        sys.exit(serve(Path(folder), int(port), int(count)))
    given = options(__doc__, rigs=100, seconds=160.0, step=0)
    if not given.step:
        show("rigs on one machine", [measure(given.rigs, given.seconds)], given.json)
        return
    rows, most = raised(given.rigs, given.step, given.seconds)
    show(f"rigs on one machine: {most} hold", rows, given.json, most=most)


if __name__ == "__main__":
    main()
