"""Replaying many recordings on a Dask cluster of two workers against one of one worker, in turn.

Scheduler and workers are processes on this machine, one thread each, started before and idle while the other
cluster works. Beside the times stand the cores that the workers had in them: where a machine has other work as
well, two workers do not get two cores. What the machine itself allows is told by the same replay in one and two
bare processes, without Dask, in the same turns. With ``--cases K`` also K blind trials on each cluster.
"""

import multiprocessing
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import replace
from functools import partial
from operator import add
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import bench_blind
from figures import options, show

from conftest import make_rig, make_run
from creak.cluster import Here, connected, tree
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


class Bare:
    """So many processes that replay recordings, and nothing else."""

    def __init__(self, count):
        self._pool = ProcessPoolExecutor(count, mp_context=multiprocessing.get_context("spawn"))
        list(self._pool.map(time.sleep, [0.5] * count))  # all of them have begun

    @property
    def pids(self):
        return list(self._pool._processes)

    def reduce(self, function, items, combine, done):
        results = list(self._pool.map(function, items))
        return tree(len(results), results.__getitem__, combine)

    def close(self):
        self._pool.shutdown()


def used(pids):
    """Processor time of processes and those that they have ended, s."""
    ticks = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
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
            closing(Bare(1)) as alone,
            closing(Bare(2)) as pair,
        ):
            bare = alone, pair
            while (single.threads, double.threads) != (1, 2):
                time.sleep(0.1)

            def replay(place):
                return place.reduce(partial(replayed, ahead=False), parts, add, lambda: None).block.sums.S

            pairs = {
                f"replay of {recordings} recordings": {
                    "Dask": (partial(replay, single), partial(replay, double)),
                    "processes": (partial(replay, bare[0]), partial(replay, bare[1])),
                    "here": (partial(replay, Here()),),
                }
            }
            if cases:
                tried = partial(bench_blind.main, cases=cases, seed=7, show=False)
                pairs[f"{cases} blind trials"] = {
                    "Dask": (partial(tried, scheduler=one.address), partial(tried, scheduler=two.address))
                }
            pids = {"Dask": [[worker.pid for worker in cluster.workers] for cluster in (one, two)]}
            pids |= {"processes": [each.pids for each in bare], "here": [[os.getpid()]]}
            for what, ways in pairs.items():
                took = {(way, k): [] for way, works in ways.items() for k in range(len(works))}
                for _ in range(repetitions + 1):
                    came = []
                    for (way, k), each in took.items():
                        begun, before = time.perf_counter(), used(pids[way][k])
                        came.append(ways[way][k]())
                        each.append((time.perf_counter() - begun, used(pids[way][k]) - before))
                    if what.startswith("replay"):
                        assert all(np.array_equal(came[0], other) for other in came), (
                            "the result hangs on the place"
                        )
                seconds, busy = (
                    {key: np.array([each[part] for each in of[1:]]) for key, of in took.items()} for part in (0, 1)
                )
                for way in ways:
                    if way == "here":
                        continue
                    first, second = seconds[way, 0], seconds[way, 1]
                    faster, cost = first / second, busy[way, 1] / busy[way, 0]
                    rows.append(
                        {
                            "what": f"{what}, {way}",
                            "one s": float(np.median(first)),
                            "two s": float(np.median(second)),
                            "times faster": float(np.median(faster)),
                            "most": float(np.max(faster)),
                            "cores one had": float(np.median(busy[way, 0] / first)),
                            "cores two had": float(np.median(busy[way, 1] / second)),
                            "processor s of one": float(np.median(busy[way, 0])),
                            "processor time, two to one": float(np.median(cost)),
                        }
                    )
    return rows


if __name__ == "__main__":
    given = options(__doc__.splitlines()[0], repetitions=9, recordings=12, realisations=20, cases=0)
    rows = measure(given.repetitions, given.recordings, given.realisations, given.cases)
    show("one and two workers", rows, given.json)
