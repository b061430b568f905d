"""Two and three effects at once, each well above noise, on cases whose truth the diagnosis does not see.

``python tests/bench/bench_several.py [--effects 2] [--first 0] [--cases 40] [--seed 1] [--json FILE]``
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

from blind import several, trial


def one(seed, count, timeout, index):
    """Draw and try one case."""
    os.environ["OMP_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory(prefix="creak-") as folder:
        return trial.run(several.draw(seed, index, count), Path(folder), timeout)


def brief(index, result):
    """One line about one trial."""
    truth, answer = result["truth"], result["answer"]
    true = ", ".join(f"{item['effect']} {'-'.join(item['at'])}" for item in truth["effects"])
    said = result["error"]
    if answer is not None:
        causes = ", ".join(f"{cause['effect']} {'-'.join(cause['at'])}" for cause in answer["causes"])
        said = f"{answer['verdict']} [{causes}]"
    mark = several.score(truth, answer)
    state = "right" if mark["all"] and not mark["invented"] and mark["ordered"] else "WRONG"
    return f"{index:3d} {state} [{true}] -> {said} {mark} cpu {result['cpu_seconds']:.1f} s"


def main(count=2, first=0, cases=40, seed=1, processes=1, timeout=900.0, show=True):
    """Run the trials; the summary, and under ``trials`` every truth and answer."""
    with ProcessPoolExecutor(processes) as pool:
        trials = []
        indices = range(first, first + cases)
        for index, result in zip(indices, pool.map(partial(one, seed, count, timeout), indices), strict=True):
            trials.append(result)
            if show:
                print(brief(index, result), file=sys.stderr, flush=True)
    return several.summary(trials) | {"effects": count, "seed": seed, "first": first, "trials": trials}


def table(outcome):
    """Rows of the README's table."""
    rows = [f"| {outcome['effects']} effects | | of |", "|---|---|---|"]
    for key, value in outcome.items():
        if isinstance(value, tuple):
            rows.append(f"| {key} | {value[0]} | {value[1]} |")
    return "\n".join(
        [*rows, f"processor time: median {outcome['median s']:.3g} s, at most {outcome['most s']:.3g} s"]
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--effects", type=int, default=2, choices=(2, 3))
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--cases", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--timeout", type=float, default=900.0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    outcome = main(given.effects, given.first, given.cases, given.seed, given.processes, given.timeout)
    print(table(outcome))
    if given.json:
        given.json.write_text(json.dumps(outcome, indent=1))
