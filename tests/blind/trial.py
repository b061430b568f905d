"""One blind trial: the diagnosis runs as a process of its own that is given a recording and a model, no more.

The truth is sealed before: it stands in a file that is XORed with as many random bytes, which only this
process's memory holds until the answer has come. The diagnosis runs in another folder, under a name that does not
tell the case, without the generator on its path; seeds stand in no file.
"""

import json
import os
import resource
import secrets
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np


def seal(truth, path):
    """Write a truth that nobody can read; return the key that opens it."""
    text = json.dumps(truth).encode()
    key = secrets.token_bytes(len(text))
    path.write_bytes(bytes(a ^ b for a, b in zip(text, key, strict=True)))
    return key


def unseal(path, key):
    """Read a truth with its key."""
    return json.loads(bytes(a ^ b for a, b in zip(path.read_bytes(), key, strict=True)))


def environment():
    """Environment of the diagnosis: the service on its path, the tests not."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    source = str(Path(__file__).parents[2] / "service")
    return kept | {"PYTHONPATH": source, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def creak(folder, timeout, *arguments):
    """Run a command of creak in a folder."""
    return subprocess.run(
        [sys.executable, "-m", "creak.cli", *arguments],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout,
    )


def _used():
    """Processor time of all ended child processes, s."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run(case, folder, timeout=300.0):
    """Have one case diagnosed.

    Parameters
    ----------
    case : Case
    folder : Path
        An empty folder; left empty.
    timeout : float
        Seconds after which a diagnosis counts as failed.

    Returns
    -------
    dict
        truth, answer (the JSON of ``creak diagnose``, or None), error (its last line, or None), seconds
        (elapsed) and cpu_seconds (of the diagnosis, which tell more on a machine that is shared).
    """
    inside = folder / secrets.token_hex(8)
    inside.mkdir()
    key = seal(case.truth, folder / "truth.sealed")
    (inside / "rig.toml").write_text(case.rig)
    measured = {"recording": (case.u, case.y)} | ({"healthy": case.healthy} if case.healthy else {})
    for name, (u, y) in measured.items():
        np.savez(inside / "measured.npz", u=u, y=y)
        made = creak(inside, timeout, "import", "measured.npz", "--rig", "rig.toml", "--output", f"{name}.mcap")
        if made.returncode != 0:
            raise RuntimeError(f"the recording was refused: {made.stderr.strip()}")
    for name in ("measured.npz", "rig.toml"):
        (inside / name).unlink()
    believed = ("--healthy", "healthy.mcap") if case.healthy else ("--model", "model.toml")
    if not case.healthy:
        (inside / "model.toml").write_text(case.model)
    answer, error = None, None
    begun, used = time.monotonic(), _used()
    try:
        done = creak(inside, timeout, "diagnose", "recording.mcap", *believed, "--json")
        if done.returncode == 0:
            answer = json.loads(done.stdout)
        else:
            error = (done.stderr.strip() or "no message").splitlines()[-1]
    except subprocess.TimeoutExpired:
        error = f"no answer within {timeout:g} s"
    spent = {"seconds": time.monotonic() - begun, "cpu_seconds": _used() - used}
    shutil.rmtree(inside)
    truth = unseal(folder / "truth.sealed", key)
    (folder / "truth.sealed").unlink()
    return {"truth": truth, "answer": answer, "error": error, **spent}
