"""Blind trials of chosen effects: a line a trial, then a row an effect."""

import argparse
import json
import math
import os
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median

from blind import score, trial
from blind.cases import draw_of


def one(seed, chosen, timeout, healthy, index):
    """Draw and try one case."""
    os.environ["OMP_NUM_THREADS"] = "1"
    with tempfile.TemporaryDirectory(prefix="creak-") as folder:
        return trial.run(draw_of(seed, index, chosen, healthy=healthy), Path(folder), timeout)


def main(chosen, cases, seed=1, processes=2, timeout=600.0, healthy=False, show=True):
    """Try cases of chosen effects.

    Parameters
    ----------
    chosen : sequence of str
        Effects, taken in turn.
    cases, seed, processes : int
    timeout : float
        Seconds an answer may take.
    healthy : bool
        The diagnosis is given a recording from before, and no model.
    show : bool
        Print a line a trial.

    Returns
    -------
    dict
        Under ``effects`` a summary an effect, under ``trials`` every truth and answer.
    """
    trials = []
    with ProcessPoolExecutor(processes) as pool:
        for result in pool.map(partial(one, seed, tuple(chosen), timeout, healthy), range(cases)):
            trials.append(result)
            if show:
                sys.stdout.write(f"{line(result)}\n")
                sys.stdout.flush()
    rows = {name: summary([t for t in trials if t["truth"]["effect"] == name]) for name in chosen}
    return {"effects": rows, "trials": trials}


def summary(trials):
    """What became of the trials of one effect: counts, largest and median error of a parameter, deviates."""
    marks = [score.judge(item) for item in trials]
    clear = [mark for mark in marks if "named" in mark]
    errors = [value for mark in clear for key, value in mark.items() if key.startswith("error of")]
    deviates = [abs(value) for mark in clear for key, value in mark.items() if key.startswith("deviate of")]
    return {
        "cases": len(trials),
        "clear": len(clear),
        "place": sum(mark["place"] for mark in clear),
        "named first": sum(mark["named"] for mark in clear),
        "named or an alternative": sum(mark["effect"] for mark in clear),
        "with causes that are none": sum(mark.get("extra causes", 0) > 0 for mark in clear),
        "error_median": median(errors) if errors else None,
        "error_largest": max(errors) if errors else None,
        "within_1_96": sum(d <= 1.96 for d in deviates),
        "parameters": len(deviates),
    }


def line(result):
    """One line about one trial."""
    truth, answer = result["truth"], result["answer"]
    said = result["error"] if answer is None else answer["verdict"]
    causes = [] if answer is None else [f"{c['effect']}@{'-'.join(c['at'])}" for c in answer["causes"]]
    others = [] if answer is None else [f"{c['effect']}@{'-'.join(c['at'])}" for c in answer["alternatives"]]
    wrong = [key for key, value in score.judge(result).items() if value is False]
    return (
        f"{truth['structure']:5s} {truth['effect']}@{'-'.join(truth['at'])} {score.clearness(truth):.0f} dB -> "
        f"{said}: {', '.join(causes)}{' or ' + ', '.join(others) if others else ''} {result['cpu_seconds']:.0f} s"
        f"{' WRONG: ' + ', '.join(wrong) if wrong else ''}"
    )


def table(result):
    """The summary as Markdown."""
    rows = [
        "| effect | clear cases | place | named first | or an alternative | with a cause that is none "
        "| median error | largest | within 1.96 standard errors |",
        "|---|---|---|---|---|---|---|---|---|",
    ]

    def percent(value):
        return "–" if value is None or not math.isfinite(value) else f"{100 * value:.2g} %"

    for name, row in result["effects"].items():
        rows.append(
            f"| `{name}` | {row['clear']} | {row['place']} | {row['named first']} "
            f"| {row['named or an alternative']} | {row['with causes that are none']} "
            f"| {percent(row['error_median'])} | {percent(row['error_largest'])} "
            f"| {row['within_1_96']} of {row['parameters']} |"
        )
    return "\n".join(rows)


def command(description, chosen, cases, healthy=False):
    """Run as a command."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=cases)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path, help="file to write")
    arguments = parser.parse_args()
    result = main(chosen, arguments.cases, arguments.seed, arguments.processes, healthy=healthy)
    sys.stdout.write(f"{table(result)}\n")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=1))
