"""Blind trials of the diagnosis: cases drawn, recorded, diagnosed by another process, and scored.

``python tests/bench/bench_blind.py [--cases 200] [--seed 1] [--first 0] [--processes 2] [--json FILE]``

With ``--scheduler ADDRESS`` the cases are tasks of a Dask cluster, whose workers have one thread each (processor
time is that of a worker's children) and see this clone under the same path.
"""

import argparse
import json
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from functools import partial
from pathlib import Path

TESTS = str(Path(__file__).parents[1])
sys.path.insert(0, TESTS)

from blind import score


def one(tests, seed, timeout, index):
    """Draw and try one case; a worker elsewhere finds the rest in the same clone."""
    if tests not in sys.path:
        sys.path.insert(0, tests)
    from blind import trial
    from blind.cases import draw

    os.environ["OMP_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory(prefix="creak-") as folder:
        return index, trial.run(draw(seed, index), Path(folder), timeout)


@contextmanager
def executor(scheduler, processes):
    """Give an executor, and what tells how many trials it does at a time."""
    if scheduler is None:
        with ProcessPoolExecutor(processes) as pool:
            yield pool, lambda: processes
        return
    from creak.cluster import connected

    with connected(scheduler) as cluster:
        yield cluster.executor(), lambda: max(1, cluster.threads)


def brief(index, result):
    """One line about one trial."""
    truth, answer = result["truth"], result["answer"]
    said = result["error"] if answer is None else answer["verdict"]
    causes = [] if answer is None else [f"{c['effect']}@{'-'.join(c['at'])}" for c in answer["causes"]]
    wrong = [key for key, value in score.judge(result).items() if value is False]
    return (
        f"{index:4d} {truth['structure']:5s} {truth['effect'] or 'no gap'}@{'-'.join(truth['at'])}"
        f"{' +linear error' if truth['linear_error'] else ''} {score.clearness(truth):.0f} dB -> {said} "
        f"{', '.join(causes)} {result['cpu_seconds']:.0f} s{' WRONG: ' + ', '.join(wrong) if wrong else ''}"
    )


def main(cases=200, seed=1, first=0, processes=2, timeout=600.0, budget=None, show=True, scheduler=None):
    """Run blind trials.

    Parameters
    ----------
    cases, seed, first : int
        How many, of which set, from which on.
    processes : int
        Trials at a time.
    timeout : float
        Seconds a diagnosis may take.
    budget : float, optional
        Seconds after which no further trial begins.
    show : bool
        Print a line a trial.
    scheduler : str, optional
        Address of a Dask scheduler that spreads the trials, in place of processes here.

    Returns
    -------
    dict
        Summary, and under ``trials`` every truth and answer by index.
    """
    begun = time.monotonic()
    trials = {}
    waiting = list(range(first, first + cases))
    with executor(scheduler, processes) as (pool, at_a_time):
        running = set()
        while waiting or running:
            late = budget is not None and time.monotonic() - begun > budget
            while waiting and not late and len(running) < at_a_time():
                running.add(pool.submit(partial(one, TESTS, seed, timeout), waiting.pop(0)))
            if not running:
                break
            done = next(as_completed(running))
            running.remove(done)
            index, result = done.result()
            trials[index] = result
            if show:
                print(brief(index, result), flush=True)
    result = score.summary([trials[index] for index in sorted(trials)])
    return result | {"seed": seed, "seconds": time.monotonic() - begun, "trials": trials}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--budget", type=float)
    parser.add_argument("--scheduler")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    outcome = main(
        given.cases, given.seed, given.first, given.processes, budget=given.budget, scheduler=given.scheduler
    )
    print(score.tables(outcome))
    if given.json:
        given.json.write_text(json.dumps(outcome, indent=1))
