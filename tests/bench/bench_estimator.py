"""The cost of the estimator as a ratio to the real FFTs of the same frames, measured in turn in one run.

*sums*: all work on a frame between source and estimate: the checks that refuse it, the DFT, the sums, the window.
*all*: what the monitor does beyond that, too: the checks of data quality and, once a realisation, the estimates of
window and run with their p-values. *snapshot*: one such estimate. The FFTs are numpy's (pocketfft, as scipy's), of
all channels of a frame side by side into memory that is there, which is the quickest way to have them.
"""

import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from conftest import make_rig, make_run
from creak.judgement import Block, judged
from creak.monitor import Monitor
from creak.multisine import realisation
from creak.preparation import prepare
from creak.realisations import Collector
from creak.records import Frame, Scope
from creak.window import Window

N, LINES, PERIODS, WINDOW = 16384, 2000, 3, 4


def frames_of(rig, realisations, rng):
    """Frames of a static linear structure, two realisations by turns; what they hold does not matter."""
    A = np.eye(rig.n) + 0.1 * rng.standard_normal((rig.n, rig.n))
    frames = []
    for m in range(2):
        for c, u in enumerate(realisation(rig, 1.0, 0, m)):
            for p in range(PERIODS):
                noisy = [x + 1e-3 * rng.standard_normal(x.shape) for x in (u, A @ u)]
                frames.append(Frame(m, c, p, 0, *noisy))
    each = len(frames) // 2
    return [replace(frames[k % (2 * each)], realisation=k // each) for k in range(realisations * each)]


class Summing:
    """What the monitor does with frames, but for data quality, estimates and alarms."""

    def __init__(self, run):
        self.run, self.collector, self.window = run, Collector(run), Window(run.window)
        self.whole = self.about = self.last = None

    def take(self, frame):
        found = self.collector.take(frame).realisation
        if found is not None:
            block = Block.of(found, self.run.rig.q)
            self.about = block.sums.S if self.about is None else self.about
            block = block.about(self.about)
            self.window.push(block)
            self.whole = block if self.whole is None else self.whole + block
            self.last = found

    def snapshot(self):
        judged(self.run.rig, self.window.total, Scope.WINDOW, self.last)


def seconds(work, frames):
    """Processor seconds a frame; all runs in one thread, and others may be busy beside it."""
    begin = time.process_time()
    for frame in frames:
        work(frame)
    return (time.process_time() - begin) / len(frames)


def main():
    given = options(__doc__, repetitions=7)
    prepare()  # as every process with a monitor does
    rows = []
    for n, realisations in ((3, 13), (16, 9)):
        rig = make_rig(n, samples=N, lines=range(1, LINES + 1), transient=0)
        run = make_run(rig, steady=PERIODS, window=WINDOW)
        frames = frames_of(rig, realisations, np.random.default_rng(0))
        channels = [np.concatenate((f.u, f.y)) for f in frames[: 2 * n * PERIODS]]
        transform = partial(np.fft.rfft, out=np.empty((2 * n, N // 2 + 1), dtype=np.complex128))
        measured = []
        for _ in range(given.repetitions):
            summing = Summing(run)
            measured.append(
                (
                    seconds(transform, channels),
                    seconds(summing.take, frames),
                    seconds(Monitor(run).take, frames),
                    seconds(lambda _, s=summing: s.snapshot(), frames[:3]),
                )
            )
        fft, sums, whole, snapshot = (float(np.median(column)) for column in zip(*measured, strict=True))
        rows.append(
            {
                "nodes": n,
                "FFTs ms/frame": 1e3 * fft,
                "sums ms/frame": 1e3 * sums,
                "all ms/frame": 1e3 * whole,
                "sums/FFTs": float(np.median([s / f for f, s, *_ in measured])),
                "all/FFTs": float(np.median([a / f for f, _, a, _ in measured])),
                "snapshot ms": 1e3 * snapshot,
            }
        )
    show("estimator against its FFTs", rows, given.json)


if __name__ == "__main__":
    main()
