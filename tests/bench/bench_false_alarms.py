"""How many false alarms does a healthy rig raise where a rate of them was asked for?

Run with ``python tests/bench/bench_false_alarms.py [--json]``; 12,500 overlapping windows of noise on three nodes,
significance alone, take about half a minute.
"""

import json
import sys
from dataclasses import replace

import numpy as np

from creak import alarms, limits
from creak.alarm_records import Limits
from creak.network import estimate
from creak.records import Excitation, Node, Rig, Run, Scope
from creak.statistics import Sums

WINDOWS, SEEDS, ALLOWED = 2500, 5, 20.0  # allowed: false alarms a seed
RIG = Rig("healthy", 64.0, 64, 1, tuple(range(2, 14)), tuple(Node(name, "m", "N") for name in "123"))
RUN = Run("bench", RIG, 2, 0, Excitation("multisine", 1.0, 1), "bench", window=4)


def windows(seed):
    """Yield the levels of all nodes window by window."""
    rng = np.random.default_rng(seed)
    q, F, P = RIG.q, len(RIG.lines), RUN.steady_periods

    def gauss(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    S = gauss(F, q, q)
    rotation = np.exp(-2j * np.pi * np.outer(np.arange(q), np.arange(q)) / q)
    blocks = []
    for m in range(WINDOWS + RUN.window):
        phase = np.exp(2j * np.pi * rng.random((F, q)))
        U = np.broadcast_to((phase * rotation[:, None, :])[:, None], (q, P, F, q))
        Y = np.einsum("fij,cpfj->cpfi", S, U) + 1e-2 * gauss(q, P, F, q)
        blocks = [*blocks, Sums.of(np.concatenate((U, Y), axis=-1), q)][-RUN.window :]
        if m >= RUN.window:
            yield m, estimate(RIG, sum(blocks[1:], blocks[0]), Scope.WINDOW, m, m).nodes


def measure():
    """False alarms by K of the last three windows."""
    per_year = limits.windows_per_year(RUN) / WINDOWS
    found = dict.fromkeys((1, 2, 3), 0)
    for seed in range(SEEDS):
        seen = list(windows(seed))
        for exceeding in found:
            asked = Limits(
                total_to_noise_db=-100.0,
                dead_band_db=0.0,
                windows=3,
                exceeding=exceeding,
                false_alarms_per_year=ALLOWED * per_year,
            )
            run = replace(RUN, limits=asked)
            for i, node in enumerate(RIG.nodes):
                state = alarms.NodeAlarm(alarms.Alarm(RIG.name, node.name))
                for m, levels in seen:
                    state, changes = alarms.step(run, state, levels[i], m)
                    found[exceeding] += sum(change.event == "raised" for change in changes)
    return found


def main(arguments):
    """Measure and print."""
    found = measure()
    if "--json" in arguments:
        print(json.dumps({"allowed": ALLOWED * SEEDS, "raised": found}))
        return
    print(f"| K of 3 | false alarms of {ALLOWED * SEEDS:g} allowed |\n|---|---|")
    for exceeding, count in found.items():
        print(f"| {exceeding} | {count} |")


if __name__ == "__main__":
    main(sys.argv[1:])
