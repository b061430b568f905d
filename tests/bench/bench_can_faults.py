"""100,000 injected faults of all kinds: does any estimate differ from that of the surviving frames alone?

The judge knows what was done to every frame: it takes the periods of which every frame got through in time, puts
them through a monitor of its own, and every estimate of the two must be the same to the last bit. Restarts of the
controller, silence and wild counters come on top of what `DisturbedWay` does to single frames.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import can_rigs
from conftest import make_frames, make_rig, make_run
from creak.monitor import Monitor
from creak.records import Estimate, Fault, FaultKind, Frame
from creak.sources.can_controller import KINDS, Controller, Disturbances, DisturbedWay, quantised
from creak.sources.can_frames import CanFrames
from creak.sources.can_pipeline import CanPipeline

N = 64


class Judge:
    """Estimates from the periods that got through whole, and nothing else."""

    def __init__(self, run):
        self.monitor = Monitor(run)
        self.estimates = []

    def take(self, frame):
        self.estimates += [o for o in self.monitor.take(frame) if isinstance(o, Estimate)]


def alike(one, other):
    """Whether two estimates say the same, bit for bit."""
    return one.nodes == other.nodes and all(
        np.array_equal(getattr(one.spectra, name), getattr(other.spectra, name), equal_nan=True)
        for name in ("signal", "noise", "total", "classical_noise", "classical_total")
    )


def session(folder, seed, realisations, rates):
    """One life of a service: a controller that begins again twice, faults on the way; what was injected and found.

    Returns injected faults by kind, the estimates compared, how many of them differ, and counts of named faults.
    """
    rng = np.random.default_rng(seed)
    run = make_run(make_rig(2, samples=N, lines=range(2, 12)), steady=2)
    mapping = can_rigs.mapping(folder, run, can_rigs.one_frame(2, counter_bits=16))
    pipeline, way = CanPipeline(run, mapping), DisturbedWay(Disturbances(**rates), seed)
    judge, found = Judge(run), Judge(run)
    injected = {"silence": 0, "wild": 0, "restart": 0}
    named = dict.fromkeys(FaultKind, 0)
    clock, base = 0, 0
    lives = np.sort(rng.integers(5, 2 * realisations, size=2))
    for life, count in enumerate((*lives.tolist(), realisations)):
        frames = make_frames(run, count, seed=int(rng.integers(1 << 30)))
        cut = len(frames) if life == 2 else len(frames) - int(rng.integers(0, run.rig.q * run.periods))
        controller = Controller(run, mapping, first_counter=N * int(rng.integers(0, 1 << 10)))
        for index, frame in enumerate(frames[:cut]):
            at = Frame(frame.realisation, frame.experiment, frame.period, clock, frame.u, frame.y)
            clock += round(run.rig.period_ns)
            own = controller.frames(at, index)
            if rng.random() < 0.01:  # nothing comes for a whole period
                injected["silence"] += 1
                own = own[:0]
                sent, done = CanFrames.none(), np.ones(1, np.uint8)
            else:
                sent, done = way.send(own)
            if rng.random() < 0.01 and len(sent):  # a frame with a good checksum from a place that is not there
                injected["wild"] += 1
                stray = Frame(int(rng.integers(256)), 1, 1, clock, frame.u, frame.y)
                wild = Controller(run, mapping, N * int(rng.integers(1 << 10))).frames(stray, 0)[:1]
                sent = sent + CanFrames(wild.identifiers, sent.times[-1:], wild.lengths, wild.data)
            for item in pipeline.push(sent):
                take(found, item, named)
            whole = not np.isin(done, (1, 5)).any()
            if whole:
                judged = quantised(at, mapping)
                judge.take(Frame(base + frame.realisation, *place(judged), clock, judged.u, judged.y))
        for item in pipeline.push(way.rest()):
            take(found, item, named)
        base += frames[cut - 1].realisation + 1
        injected["restart"] += life < 2
    for item in pipeline.finish():
        take(found, item, named)
    for kind in KINDS:
        injected[kind] = way.injected[kind]
    wrong = sum(not alike(a, b) for a, b in zip(found.estimates, judge.estimates, strict=False))
    wrong += abs(len(found.estimates) - len(judge.estimates))
    return injected, len(judge.estimates), wrong, named


def place(frame):
    return frame.experiment, frame.period


def take(found, item, named):
    if isinstance(item, Fault):
        named[item.kind] += 1
        found.monitor.take(item)
    else:
        found.take(item)


RATES = {"lost": 0.003, "doubled": 0.06, "delayed": 0.06, "reordered": 0.06, "corrupted": 0.003, "delay": 0.3}


def measure(faults, seed=1, realisations=120):
    """Sessions until so many faults were injected."""
    total, compared, wrong, sessions = {}, 0, 0, 0
    named = dict.fromkeys(FaultKind, 0)
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        while sum(total.values()) < faults:
            injected, estimates, differing, found = session(Path(folder), seed + sessions, realisations, RATES)
            for kind, number in injected.items():
                total[kind] = total.get(kind, 0) + number
            for kind, number in found.items():
                named[kind] += number
            compared, wrong, sessions = compared + estimates, wrong + differing, sessions + 1
    return {
        "injected": sum(total.values()),
        **total,
        "estimates": compared,
        "differing": wrong,
        "sessions": sessions,
        "named": {kind.value: number for kind, number in named.items() if number},
        "seconds": round(time.perf_counter() - begun, 1),
    }


def main(arguments=None):
    """Print the figures as one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--faults", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args(arguments)
    figures = measure(given.faults, given.seed)
    print(json.dumps(figures, indent=1))
    return 1 if figures["differing"] else 0


if __name__ == "__main__":
    sys.exit(main())
