"""The estimator beside published packages, on the same arrays of a recording, by turns, FFTs included.

Four realisations of a rig with three nodes: periods of 16384 samples, three steady ones, 2000 lines.

* creak: frames one by one into the sums, then the estimate of all with its p-values;
* ``best-linear-approximation``, which wants Python 3.12: ``--judge PYTHON`` is an interpreter that has it;
* ``bla_periodic`` of pyvib: ``--pyvib FOLDER`` is a checkout; from the spectra at the lines, as it takes them.

Each runs in a process of its own on one core; figures are medians of the processor time.
"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

N, LINES, PERIODS, REALISATIONS, RATE = 16384, 2000, 3, 4, 4096.0
REPETITIONS = 3  # in one process, after one that does not count


def recording(path):
    """Write ``u (M, q, q, N)`` and ``y (M, q, P, n, N)`` of a static linear structure with noise."""
    from conftest import make_rig
    from creak.multisine import realisation

    rig = make_rig(3, samples=N, lines=range(1, LINES + 1), transient=0)
    rng = np.random.default_rng(0)
    u = np.stack([realisation(rig, 1.0, 0, m) for m in range(REALISATIONS)])
    A = np.eye(3) + 0.1 * rng.standard_normal((3, 3))
    y = np.repeat((A @ u)[:, :, None], PERIODS, axis=2)
    np.savez(path, u=u, y=y + 1e-3 * rng.standard_normal(y.shape))


def creaks(u, y):
    """Frames into sums, sums into an estimate."""
    from conftest import make_rig, make_run
    from creak.judgement import Block, judged
    from creak.realisations import Collector
    from creak.records import Frame, Scope

    rig = make_rig(3, samples=N, lines=range(1, LINES + 1), transient=0)
    frames = [
        Frame(m, e, p, 0, u[m, e], y[m, e, p])
        for m in range(REALISATIONS)
        for e in range(3)
        for p in range(PERIODS)
    ]

    def work():
        collector, whole, last = Collector(make_run(rig, steady=PERIODS)), None, None
        for frame in frames:
            last = collector.take(frame).realisation
            if last is not None:
                block = Block.of(last, rig.q)
                whole = block if whole is None else whole + block
        judged(rig, whole, Scope.RUN, last)

    return work


def judges(u, y):
    """The package takes samples, nodes or inputs, experiments, realisations, periods."""
    from best_linear_approximation import robust

    inputs = np.ascontiguousarray(u.transpose(3, 2, 1, 0))
    responses = np.ascontiguousarray(y.transpose(4, 3, 1, 0, 2))
    lines = np.arange(1, LINES + 1)
    return lambda: robust.known_input(
        inputs, responses, RATE, lines, independent_subexperiments=True, show_warnings=False
    )


def pyvibs(u, y, folder):
    """It takes spectra: inputs or nodes, experiments of all realisations, periods, lines."""
    spec = importlib.util.spec_from_file_location("frf", Path(folder) / "pyvib" / "frf.py")
    frf = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(frf)

    def work():
        U, Y = (np.fft.rfft(x)[..., 1 : LINES + 1] for x in (u, y))
        U = np.repeat(U[:, :, None], PERIODS, axis=2)
        frf.bla_periodic(*(x.transpose(3, 1, 0, 2, 4).reshape(3, -1, PERIODS, LINES) for x in (U, Y)))

    return work


def measure(who, path, *more):
    """Processor seconds of each repetition, as JSON on standard output."""
    with np.load(path) as kept:
        work = {"creak": creaks, "judge": judges, "pyvib": pyvibs}[who](kept["u"], kept["y"], *more)
    work()
    spent = []
    for _ in range(REPETITIONS):
        begin = time.process_time()
        work()
        spent.append(time.process_time() - begin)
    print(json.dumps(spent))


def main():
    """Print the table."""
    from figures import options, show

    given = options(__doc__.splitlines()[0], turns=5, judge="", pyvib="")
    peers = {"creak": (sys.executable, ())}
    peers |= {"judge": (given.judge, ())} if given.judge else {}
    peers |= {"pyvib": (sys.executable, (given.pyvib,))} if given.pyvib else {}
    names = {"creak": "creak", "judge": "best-linear-approximation", "pyvib": "pyvib, bla_periodic"}
    taken = {who: [] for who in peers}
    with tempfile.TemporaryDirectory(prefix="creak-") as folder:
        path = Path(folder) / "recording.npz"
        recording(path)
        alone = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        for _ in range(given.turns):
            for who, (python, more) in peers.items():
                command = [python, __file__, "--measure", who, str(path), *more]
                done = subprocess.run(command, env=alone, capture_output=True, text=True, check=False)
                if done.returncode:
                    sys.exit(f"{names[who]}: {done.stderr.strip()}")
                taken[who] += json.loads(done.stdout.splitlines()[-1])
    own = np.median(taken["creak"])
    rows = [
        {"what": names[who], "ms a recording": 1e3 * float(np.median(t)), "ratio": float(np.median(t) / own)}
        for who, t in taken.items()
    ]
    show("estimators, 4 realisations, 3 nodes", rows, given.json)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    if sys.argv[1:2] == ["--measure"]:
        measure(*sys.argv[2:])
    else:
        main()
