"""The cost of the estimator as a ratio to the real FFTs of the same frames, measured in turn in one run.

Per frame everything between a source and the sinks counts: the checks, the DFT, the sums and, once a realisation,
the estimates of window and run with their p-values.
"""

import sys
import time
from pathlib import Path

import numpy as np
import scipy.fft

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from conftest import make_rig, make_run
from creak.monitor import Monitor
from creak.multisine import realisation
from creak.records import Frame

N, LINES, PERIODS = 16384, 2000, 3


def frames_of(rig, realisations, rng):
    """Frames of a static linear structure; the cost does not depend on what they hold."""
    A = np.eye(rig.n) + 0.1 * rng.standard_normal((rig.n, rig.n))
    frames = []
    for m in range(realisations):
        for c, u in enumerate(realisation(rig, 1.0, 0, m)):
            frames += [Frame(m, c, p, 0, u, A @ u + 1e-3 * rng.standard_normal(u.shape)) for p in range(PERIODS)]
    return frames


def seconds(work, frames):
    """Seconds a frame."""
    begin = time.perf_counter()
    for frame in frames:
        work(frame)
    return (time.perf_counter() - begin) / len(frames)


def main():
    given = options(__doc__, repetitions=5)
    rows = []
    for n, realisations in ((3, 6), (16, 2)):
        rig = make_rig(n, samples=N, lines=range(1, LINES + 1), transient=0)
        frames = frames_of(rig, realisations, np.random.default_rng(0))
        pairs = []
        for _ in range(given.repetitions):
            fft = seconds(lambda f: (scipy.fft.rfft(f.u), scipy.fft.rfft(f.y)), frames)
            pairs.append((fft, seconds(Monitor(make_run(rig, steady=PERIODS)).take, frames)))
        fft, whole = (float(np.median(column)) for column in zip(*pairs, strict=True))
        ratio = float(np.median([b / a for a, b in pairs]))
        rows.append({"nodes": n, "FFTs ms/frame": 1e3 * fft, "all ms/frame": 1e3 * whole, "ratio": ratio})
    show("estimator against its FFTs", rows, given.json)


if __name__ == "__main__":
    main()
