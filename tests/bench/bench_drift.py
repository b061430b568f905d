"""How soon is slow growth seen, and how often is an unchanged machine accused? Three kinds of limit side by side.

Run with ``python tests/bench/bench_drift.py [machines] [--json] [--figure FILE.png]``; 60 machines take about two
minutes. Every machine is a little nonlinear from the beginning, each to its own degree. Its windows come from the
monitor's own estimates and are judged by the monitor's own alarms; only the noise is drawn directly as spectra.
"""

import json
import sys
from collections import deque
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np

from creak import alarms, baseline, limits
from creak.alarm_records import BaselineRules, Limits
from creak.network import estimate
from creak.records import Excitation, Node, Rig, Run, Scope
from creak.statistics import Sums

LEARNT = 100  # realisations before anything is judged
WATCHED = 900  # realisations that nothing changes in
GROWING = 500  # realisations of growth, on a machine of its own
GROWTH_DB = 2.0  # of the distortion's power, every 100 realisations
LINES = 40
HEALTHY_DB = (-6.0, 6.0)  # distortion over noise of a healthy machine: every one has its own

RIG = Rig(
    name="drift",
    sample_rate=1024.0,
    period_samples=1024,
    transient_periods=1,
    lines=tuple(range(5, 5 + LINES)),
    nodes=(Node("1", "m", "N"), Node("2", "m", "N")),
)
RUN = Run("bench", RIG, 2, 0, Excitation("multisine", 1.0, 1), "bench", window=4)
OFF_DB = 1e3  # a limit that nothing reaches


@dataclass(frozen=True)
class Setting:
    """One kind of limit at one value.

    Parameters
    ----------
    kind : str
    value : float
        The limit in dB, or the false alarms asked for in 1,000 realisations.
    run : Run
    """

    kind: str
    value: float
    run: Run


@dataclass(frozen=True)
class Found:
    """What a setting did.

    Parameters
    ----------
    setting : Setting
    accused : float
        Share of the unchanged machines with at least one false alarm.
    false_alarms : float
        Mean number of them in 1,000 realisations.
    seen : float
        Share of the growing machines that were found out, of those not accused before the growth began.
    delay : float
        Median number of realisations from the beginning of the growth; NaN if fewer than half were found.
    """

    setting: Setting
    accused: float
    false_alarms: float
    seen: float
    delay: float

    def row(self):
        """As JSON."""
        return {
            "limit": self.setting.kind,
            "value": self.setting.value,
            "machines_accused": round(self.accused, 3),
            "false_alarms_per_1000": round(self.false_alarms, 3),
            "growth_seen": round(self.seen, 3),
            "median_realisations": None if np.isnan(self.delay) else self.delay,
        }


def settings():
    """All limits that are compared."""
    per_year = limits.windows_per_year(RUN) / 1000  # of a rate in 1,000 realisations
    for value in (2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0):
        yield Setting("fixed threshold, dB", value, replace(RUN, limits=Limits(total_to_noise_db=value)))
    for value in (10.0, 1.0, 0.1, 0.01):
        rules = BaselineRules(LEARNT, change_db=1.0, trend_false_alarms_per_year=None)
        tested = Limits(total_to_noise_db=OFF_DB, false_alarms_per_year=value * per_year)
        yield Setting("change of 1 dB, rate", value, replace(RUN, limits=tested, baseline=rules))
    for value in (10.0, 1.0, 0.1, 0.01):
        rules = BaselineRules(LEARNT, change_db=OFF_DB, trend_false_alarms_per_year=value * per_year)
        off = Limits(total_to_noise_db=OFF_DB)
        yield Setting("trend, rate", value, replace(RUN, limits=off, baseline=rules))


def levels(rng, healthy_db, growth_db):
    """Yield the levels of the grown node window by window, from the first full window on.

    Parameters
    ----------
    rng : numpy Generator
    healthy_db : float
        Distortion over noise in the beginning.
    growth_db : array
        What comes on top, by realisation.
    """
    q, n, P = RIG.q, RIG.n, RUN.steady_periods

    def gauss(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    S = gauss(LINES, n, q) + 2.0 * np.eye(n, q)
    rotation = np.exp(-2j * np.pi * np.outer(np.arange(q), np.arange(q)) / q)
    blocks = deque(maxlen=RUN.window)
    for m, more in enumerate(growth_db):
        phase = np.exp(2j * np.pi * rng.random((LINES, q)))
        U = np.broadcast_to((phase * rotation[:, None, :])[:, None], (q, P, LINES, q))
        Y = np.einsum("fij,cpfj->cpfi", S, U) + 1e-2 * gauss(q, P, LINES, n)
        Y[..., -1] += 1e-2 * 10 ** ((healthy_db + more) / 20) * gauss(q, 1, LINES)
        blocks.append(Sums.of(np.concatenate((U, Y), axis=-1), q))
        if len(blocks) == RUN.window:
            yield m, estimate(RIG, reduce(add, blocks), Scope.WINDOW, m, m).nodes[-1]


def raised_at(run, windows):
    """Realisations at which the alarm of the node is raised; what stands when learning ends is raised then."""
    node = alarms.NodeAlarm(alarms.Alarm(RIG.name, RIG.nodes[-1].name))
    known = None
    raised = []
    for m, level in windows:
        verdicts = {}
        if run.baseline.realisations:
            known = known or baseline.begin(level, 1.0)
            known, verdicts = baseline.step(run, known, level, m, m, node.healthy)
        node, changes = alarms.step(run, node, level, m, verdicts)
        raised += [max(m, LEARNT) for change in changes if change.event == "raised"]
    return raised


def measure(machines, seed=20261121):
    """Compare all settings on the same machines."""
    rng = np.random.default_rng(seed)
    unchanged, growing = [], []
    growth = np.maximum(np.arange(LEARNT + GROWING) - LEARNT, 0) * GROWTH_DB / 100
    for _ in range(machines):
        healthy_db = rng.uniform(*HEALTHY_DB)
        unchanged.append(list(levels(rng, healthy_db, np.zeros(LEARNT + WATCHED))))
        growing.append(list(levels(rng, healthy_db, growth)))
    found = []
    for setting in settings():
        false = [raised_at(setting.run, windows) for windows in unchanged]
        grown = [raised_at(setting.run, windows) for windows in growing]
        clean = [raised for raised in grown if not raised or raised[0] > LEARNT]
        delays = [raised[0] - LEARNT if raised else np.inf for raised in clean]
        median = float(np.median(delays)) if delays else np.nan
        found.append(
            Found(
                setting,
                accused=float(np.mean([bool(raised) for raised in false])),
                false_alarms=float(np.mean([len(raised) for raised in false])) * 1000 / WATCHED,
                seen=float(np.mean(np.isfinite(delays))) if delays else np.nan,
                delay=median if np.isfinite(median) else np.nan,
            )
        )
    return found


def table(found):
    """The results in Markdown."""
    lines = [
        "| limit | value | unchanged machines accused | false alarms per 1,000 | growth seen | after |",
        "|---|---|---|---|---|---|",
    ]
    for f in found:
        after = "–" if np.isnan(f.delay) else f"{f.delay:.0f}"
        lines.append(
            f"| {f.setting.kind} | {f.setting.value:g} | {100 * f.accused:.0f} % | {f.false_alarms:.2f} "
            f"| {100 * f.seen:.0f} % | {after} |"
        )
    return "\n".join(lines)


def draw(found, path):
    """Time to detection over the share of unchanged machines that are accused."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6.4, 3.6), layout="constrained")
    for kind, marker in zip(dict.fromkeys(f.setting.kind for f in found), "s^o", strict=True):
        points = [f for f in found if f.setting.kind == kind and not np.isnan(f.delay)]
        axes.plot([100 * f.accused for f in points], [f.delay for f in points], marker + "-", label=kind)
        for f in points:
            axes.annotate(
                f"{f.setting.value:g}",
                (100 * f.accused, f.delay),
                xytext=(4, 4),
                textcoords="offset points",
                size=7,
            )
    axes.set_xlabel("unchanged machines with a false alarm in 900 realisations, %")
    axes.set_ylabel("median realisations to detection")
    axes.set_title(f"Growth of {GROWTH_DB:g} dB in 100 realisations; left and low is better", size=9)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=130)


def main(arguments):
    """Measure and print."""
    figure = arguments[arguments.index("--figure") + 1] if "--figure" in arguments else None
    numbers = [int(word) for word in arguments if word.isdigit()]
    found = measure(numbers[0] if numbers else 60)
    if figure is not None:
        draw(found, figure)
    if "--json" in arguments:
        print(json.dumps([f.row() for f in found]))
    else:
        print(table(found))


if __name__ == "__main__":
    main(sys.argv[1:])
