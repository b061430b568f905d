"""The rate of a replay beside that of the bare MCAP reader on the same bytes, and what recording costs.

A beam rig (three nodes, periods of 16384 samples at 4096 Hz, three transient and three steady ones) is recorded
with all that the monitor says of it. Then, by turns: the bare stream reader of the package ``mcap``, without and
with its checks of checksums; the recording as a source (checksums, salvage, decoding); the whole replay, which
reads ahead in a thread of its own. Rates count the bytes of the file and are the best of the repetitions; on a
machine that others use, those by processor time say more.
"""

import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from mcap.records import Message
from mcap.stream_reader import StreamReader

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from conftest import make_rig, make_run
from creak.monitor import Monitor
from creak.multisine import realisation
from creak.records import Frame, RunEnd, RunStatus
from creak.sinks.recorder import Recorder
from creak.sources.recording import Recording
from creak.worker import drive


def beam_frames(run, realisations, rng):
    """Frames of a static linear structure with noise; the cost does not depend on what they hold."""
    rig = run.rig
    A = np.eye(rig.n) + 0.1 * rng.standard_normal((rig.n, rig.n))
    count = 0
    for m in range(realisations):
        for c, u in enumerate(realisation(rig, 1.0, 0, m)):
            for p in range(run.periods):
                noisy = A @ u + 1e-3 * rng.standard_normal(u.shape)
                yield Frame(m, c, p, run.start + round(count * rig.period_ns), u, noisy)
                count += 1


def record(path, run, realisations):
    """Record a run; processor seconds that the recorder took for a second of the rig's time."""
    recorder, monitor, spent, end = Recorder(path), Monitor(run), 0.0, 0

    def timed(work, *given):
        nonlocal spent
        begin = time.thread_time()
        work(*given)
        spent += time.thread_time() - begin

    timed(recorder.open, run)
    for frame in beam_frames(run, realisations, np.random.default_rng(0)):
        for outcome in monitor.take(frame):
            timed(recorder.take, outcome)
        end = frame.time + round(run.rig.period_ns)
    timed(recorder.close, RunEnd(end, RunStatus.COMPLETED, monitor.counts))
    return spent / ((end - run.start) / 1e9)


def bare(path, validate):
    with path.open("rb") as file:
        return sum(
            len(r.data) for r in StreamReader(file, validate_crcs=validate).records if isinstance(r, Message)
        )


def main():
    given = options(__doc__, realisations=10, repetitions=5)
    rig = replace(make_rig(3, samples=16384, lines=range(1, 2001), transient=3), sample_rate=4096.0)
    run = make_run(rig, steady=3)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "beam.mcap"
        share = record(path, run, given.realisations)
        works = {
            "bare reader": lambda: bare(path, False),
            "bare reader, checksums": lambda: bare(path, True),
            "recording as a source": lambda: sum(1 for _ in Recording(path).replayed()),
            "replay": lambda: drive(Recording(path), []),
        }
        size = path.stat().st_size / 1e6
        wall, cores = {name: [] for name in works}, {name: [] for name in works}
        for _ in range(given.repetitions):
            for name, work in works.items():
                begin, used = time.perf_counter(), time.process_time()
                work()
                wall[name].append(time.perf_counter() - begin)
                cores[name].append(time.process_time() - used)
    best = {name: min(times) for name, times in wall.items()}
    rows = [
        {
            "what": name,
            "MB/s": size / best[name],
            "MB a processor second": size / min(cores[name]),
            "rate / bare": best["bare reader"] / best[name],
            "rate / bare with checksums": best["bare reader, checksums"] / best[name],
        }
        for name in works
    ]
    if not given.json:
        print(f"recording takes {100 * share:.2f} % of a core for a beam rig in real time")
    show("replay", rows, given.json, recording_share_of_a_core=share)


if __name__ == "__main__":
    main()
