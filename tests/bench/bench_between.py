"""Blind trials with effects where nothing is measured: position along a beam, or a mass without sensor.

``python tests/bench/bench_between.py [--cases 36] [--seed 1] [--processes 2] [--json FILE]``
"""

import argparse
import json
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind import between, trial


def one(seed, timeout, index):
    """Draw and try one case."""
    os.environ["OMP_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory(prefix="creak-") as folder:
        return trial.run(between.draw(seed, index), Path(folder), timeout)


def brief(index, result):
    """One line about one trial."""
    truth, answer = result["truth"], result["answer"]
    where = f"{truth['position'] / truth['length']:.3f} L" if truth["length"] else "-".join(truth["at"])
    said = result["error"]
    if answer is not None:
        places = [f"{'-'.join(w['at'])} ± {w['position_standard_error'] or 0:.1g}" for w in answer["where"]]
        said = f"{answer['verdict']} {[c['effect'] for c in answer['causes']]} at {', '.join(places)}"
    judged = {
        key: value for key, value in between.judge(result).items() if key in ("error", "deviations", "effect")
    }
    return f"{index:3d} {truth['structure']} {truth['effect']} at {where} -> {said} {judged}"


def main(cases=36, seed=1, processes=2, timeout=600.0, show=True):
    """Run the trials; the summary, and under ``trials`` every truth and answer."""
    with ProcessPoolExecutor(processes) as pool:
        trials = []
        for index, result in enumerate(pool.map(partial(one, seed, timeout), range(cases))):
            trials.append(result)
            if show:
                print(brief(index, result), file=sys.stderr, flush=True)
    return between.summary(trials) | {"seed": seed, "trials": trials}


def table(outcome):
    """Rows of the README's table."""
    rows = ["| | right | of |", "|---|---|---|"]
    for key, value in outcome.items():
        if isinstance(value, tuple):
            rows.append(f"| {key} | {value[0]} | {value[1]} |")
    return "\n".join([*rows, f"median error {outcome['median error, % of the length']:.2g} % of the length"])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=36)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    outcome = main(given.cases, given.seed, given.processes)
    print(table(outcome))
    if given.json:
        given.json.write_text(json.dumps(outcome, indent=1))
