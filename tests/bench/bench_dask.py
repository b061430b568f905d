"""Replaying many recordings on a Dask cluster of two workers against one of one worker, in turn.

Scheduler and workers are processes on this machine, one thread each, started before and idle while the other
cluster works. Beside the times stand the cores that the workers had in them: where a machine has other work as
well, two workers do not get two cores. With ``--cases K`` also K blind trials on each.
"""

import os
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from operator import add
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import bench_blind
from figures import options, show

from conftest import make_rig, make_run
from creak.cluster import Here, connected
from creak.monitor import Monitor
from creak.multisine import realisation
from creak.records import Frame, RunEnd, RunStatus
from creak.replay import replayed
from creak.sinks.recorder import Recorder
from dask_machines import machines

N, LINES, NODES, PERIODS = 4096, 600, 3, 3


def record(path, seed, realisations):
    """Record a static linear structure; the cost of a replay does not depend on what the frames hold."""
    rig = make_rig(NODES, samples=N, lines=range(1, LINES + 1), transient=0)
    run = replace(make_run(rig, steady=PERIODS), id=f"run {seed}")
    rng = np.random.default_rng(seed)
    A = np.eye(NODES) + 0.1 * rng.standard_normal((NODES, NODES))
    monitor, recorder = Monitor(run), Recorder(path)
    recorder.open(run)
    for m in range(realisations):
        for c, u in enumerate(realisation(rig, 1.0, 0, m)):
            for p in range(PERIODS):
                frame = Frame(m, c, p, 0, u, A @ u + 1e-3 * rng.standard_normal(u.shape))
                for outcome in monitor.take(frame):
                    recorder.take(outcome)
    recorder.close(RunEnd(0, RunStatus.COMPLETED, monitor.counts))
    return path


def used(cluster):
    """Processor time of the workers and the processes that they have ended, s."""
    ticks = 0
    for worker in cluster.workers:
        fields = Path(f"/proc/{worker.pid}/stat").read_text().rpartition(")")[2].split()
        ticks += sum(map(int, fields[11:15]))  # user and system time, own and of children
    return ticks / os.sysconf("SC_CLK_TCK")


def measure(repetitions, recordings, realisations, cases):
    """Rows of seconds and ratios."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="creak-dask-") as name:
        folder = Path(name)
        parts = [(record(folder / f"{k}.mcap", k, realisations),) for k in range(recordings)]
        for workers in (1, 2):
            (folder / f"of-{workers}").mkdir()
        with (
            machines(folder / "of-1", 1) as one,
            machines(folder / "of-2", 2) as two,
            connected(one.address) as single,
            connected(two.address) as double,
        ):
            while (single.threads, double.threads) != (1, 2):
                time.sleep(0.1)

            def replay(place):
                return place.reduce(partial(replayed, ahead=False), parts, add, lambda: None).block.sums.S

            works = {
                f"replay of {recordings} recordings": {
                    "here": partial(replay, Here()), "one": partial(replay, single), "two": partial(replay, double)
                }
            }  # fmt: skip
            if cases:
                tried = partial(bench_blind.main, cases=cases, seed=7, show=False)
                works[f"{cases} blind trials"] = {
                    "here": partial(tried, processes=1),
                    "one": partial(tried, scheduler=one.address),
                    "two": partial(tried, scheduler=two.address),
                }
            for what, ways in works.items():
                taken = {way: [] for way in ways}
                cores = {way: [] for way in ways}
                came = {}
                for _ in range(repetitions + 1):
                    for way, work in ways.items():
                        cluster = {"one": one, "two": two}.get(way)
                        begun, before = time.perf_counter(), used(cluster) if cluster else 0.0
                        came[way] = work()
                        taken[way].append(time.perf_counter() - begun)
                        cores[way].append((used(cluster) - before) / taken[way][-1] if cluster else 1.0)
                if what.startswith("replay"):
                    assert np.array_equal(came["one"], came["two"]), "the result hangs on the number of workers"
                    assert np.array_equal(came["here"], came["two"]), "the result hangs on where it was computed"
                here, first, second = (np.array(taken[way][1:]) for way in ways)
                had = np.array(cores["two"][1:]) / np.array(cores["one"][1:])
                rows.append(
                    {
                        "what": what,
                        "here s": float(np.median(here)),
                        "one worker s": float(np.median(first)),
                        "two workers s": float(np.median(second)),
                        "times faster": float(np.median(first / second)),
                        "most": float(np.max(first / second)),
                        "cores, two to one": float(np.median(had)),
                        "processor time, one to two": float(np.median(first / second / had)),
                    }
                )
    return rows


if __name__ == "__main__":
    given = options(__doc__.splitlines()[0], repetitions=9, recordings=12, realisations=4, cases=0)
    rows = measure(given.repetitions, given.recordings, given.realisations, given.cases)
    show("one and two workers", rows, given.json)
