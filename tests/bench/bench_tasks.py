"""One diagnosis whose candidates are tasks: here, on a Dask cluster of one worker and on one of two, in turn.

Scheduler and workers are processes on this machine, one thread each. The cases are blind draws with two and three
effects at once, the beam whose numbers are all off with an effect beside them, and the Silverbox if its data are
there. Beside the times stand processor seconds: where a machine has other work, elapsed ones tell little. What the
process that asks does itself is not shared among workers. Every document is compared bit for bit.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

import test_gap_beam as beam
from bench.bench_dask import used
from bench.bench_real_data import DATA, EXAMPLES
from blind import several, trial
from creak.cluster import connected
from creak.codec.diagnosis_json import diagnosis_json
from creak.config.model import load_model
from creak.gap.diagnose import diagnose
from creak.gap.periodic import gather
from creak.mechanics.effects import QuadraticDamping
from creak.sources.recording import Recording
from dask_machines import machines

DRAWN = ((1, 2), (0, 3), (3, 3), (5, 3))  # index and number of effects
SEED = 2031


def imported(folder, measured, rig, model):
    """Rig, model and data of a measurement that goes through ``creak import``."""
    done = trial.creak(folder, 300.0, "import", measured, "--rig", rig, "--output", "recording.mcap")
    if done.returncode:
        raise RuntimeError(done.stderr.strip())
    recording = Recording(folder / "recording.mcap")
    return recording.run.rig, load_model(folder / model), gather(recording.run, recording.frames())


def drawn(folder, index, count):
    """A blind case."""
    case = several.draw(SEED, index, count)
    (folder / "rig.toml").write_text(case.rig)
    (folder / "model.toml").write_text(case.model)
    np.savez(folder / "measured.npz", u=case.u, y=case.y)
    return imported(folder, "measured.npz", "rig.toml", "model.toml")


def silverbox(folder):
    """The training half of the Silverbox and its linear model."""
    page = EXAMPLES / "silverbox"
    source = DATA / "silverbox" / "SNLS80mV.mat"
    subprocess.run([sys.executable, page / "prepare.py", source], cwd=folder, check=True, capture_output=True)
    return imported(folder, "train.npz", str(page / "rig.toml"), "linear.toml")


def cases(folder, most):
    """Name, and what `diagnose` takes."""
    for index, count in DRAWN[:most]:
        yield f"{count} effects, case {index}", drawn(folder, index, count)
    there = replace(beam.TRUE, effects=(QuadraticDamping(("2", "ground"), 3.0),))
    yield "beam, all numbers off", (beam.RIG, beam.wrong(beam.TRUE), beam.recorded(there))
    if (DATA / "silverbox").is_dir():
        yield "Silverbox", silverbox(folder)


def measure(repetitions, most):
    """Rows of seconds and ratios."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="creak-tasks-") as name:
        folder = Path(name)
        for place in ("of-1", "of-2"):
            (folder / place).mkdir()
        with (
            machines(folder / "of-1", 1) as one,
            machines(folder / "of-2", 2) as two,
            connected(one.address) as single,
            connected(two.address) as double,
        ):
            while (single.threads, double.threads) != (1, 2):
                time.sleep(0.1)
            ways = {"here": (map, []), "one": (single.map, one.workers), "two": (double.map, two.workers)}
            for what, given in cases(folder, most):
                rows.append({"what": what} | _turns(given, ways, repetitions))
    return rows


def _turns(given, ways, repetitions):
    """Medians over turns; the first warms up and is left out."""
    seconds, asking, working = ({way: [] for way in ways} for _ in range(3))
    for _ in range(repetitions + 1):
        documents = set()
        for way, (each, workers) in ways.items():
            pids = [worker.pid for worker in workers]
            begun, own, theirs = time.perf_counter(), time.process_time(), used(pids)
            documents.add(json.dumps(diagnosis_json(diagnose(*given, each=each), None)))
            seconds[way].append(time.perf_counter() - begun)
            asking[way].append(time.process_time() - own)
            working[way].append(used(pids) - theirs)
        assert len(documents) == 1, "the answer hangs on the place"
    turns = {way: np.array(took[1:]) for way, took in seconds.items()}
    row = {f"{way} s": float(np.median(took)) for way, took in turns.items()}
    row["one / two"] = float(np.median(turns["one"] / turns["two"]))
    row["here / two"] = float(np.median(turns["here"] / turns["two"]))
    row["processor s here"] = float(np.median(asking["here"][1:]))
    for way in ("one", "two"):
        row[f"asking, {way}"] = float(np.median(asking[way][1:]))
        row[f"workers, {way}"] = float(np.median(working[way][1:]))
    return row


if __name__ == "__main__":
    given = options(__doc__.splitlines()[0], repetitions=3, drawn=len(DRAWN))
    rows = measure(given.repetitions, given.drawn)
    show("one diagnosis, elsewhere and here", rows, given.json, load=os.getloadavg())
