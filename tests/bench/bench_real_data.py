"""Measured data: Silverbox, fine steering mirror, two-mass bench, beside the figures published for them.

``python tests/bench/bench_real_data.py [silverbox] [mirror] [bench] [--data ../shared/data] [--json FILE]``

Every set goes through the commands that its page in ``deploy/examples`` names; errors are those of realisations
that no fit has seen, relative to their RMS value. A set whose files are absent is left out, and said to be.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "deploy" / "examples"
DATA = ROOT.parent / "shared" / "data"


def percent(level_db):
    """Relative RMS error of a level, %."""
    return 100 * 10 ** (level_db / 20)


def creak(folder, *words):
    """Run a command of creak; what it prints."""
    return _run(folder, "-m", "creak.cli", *words)


def _run(folder, *words):
    done = subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, words))}: {done.stderr.strip()}")
    return done.stdout


def silverbox(data, folder, *sample):
    """Diagnose five realisations, or those that options name, from the best linear model; simulate five others."""
    page = EXAMPLES / "silverbox"
    _run(folder, page / "prepare.py", data / "silverbox" / "SNLS80mV.mat")
    for name in ("train", "test"):
        creak(folder, "import", f"{name}.npz", "--rig", page / "rig.toml", "--output", f"{name}.mcap")
    words = ("diagnose", "train.mcap", "--model", "linear.toml", "--validate", "test.mcap", "--json", *sample)
    answer = json.loads(creak(folder, *words))
    unseen = answer["validation"]["nodes"][0]
    return {
        "verdict": answer["verdict"],
        "causes": _named(answer),
        "before": [percent(unseen["before_db"])],
        "after": [percent(unseen["after_db"])],
        "published": "linear 13.17 %, nonlinear feedback (black box) 0.44 %",
    }


def mirror(data, folder):
    """Take the first realisation at 300 mV as the linear model, and look for what the second one has beyond it."""
    page, files = EXAMPLES / "fine-steering-mirror", data / "fine-steering-mirror"
    _run(folder, page / "reorder.py", files / "u_300mV_train.npy", files / "y_300mV_train.npy", "mirror.npz")
    creak(folder, "import", "mirror.npz", "--rig", page / "rig.toml", "--output", "mirror.mcap")
    creak(folder, "model", "mirror.mcap", "--linear", "--last-realisation", 0, "--output", "mirror.toml")
    answer = json.loads(creak(folder, "diagnose", "mirror.mcap", "--model", "mirror.toml", "--json"))
    return {
        "verdict": answer["verdict"],
        "causes": _named(answer),
        "before": [percent(node["before_db"]) for node in answer["nodes"]],
        "after": [percent(node["after_db"]) for node in answer["nodes"]],
        "published": "linear 5.63 %, black box for all levels 4.19 %",
    }


def bench(data, folder):
    """Take the only realisation as the linear model: the lines that are not excited hold the distortion."""
    page = EXAMPLES / "two-mass-bench"
    _run(folder, page / "reorder.py", data / "two-mass-bench" / "MultisineTypeB.mat", "bench.npz")
    creak(folder, "import", "bench.npz", "--rig", page / "rig.toml", "--output", "bench.mcap")
    creak(folder, "model", "bench.mcap", "--linear", "--output", "bench.toml")
    answer = json.loads(creak(folder, "diagnose", "bench.mcap", "--model", "bench.toml", "--json"))
    place = answer["where"][0]
    return {
        "verdict": answer["verdict"],
        "causes": _named(answer),
        "where": "-".join(place["at"]),
        "share": place["share"],
        "before": [percent(node["before_db"]) for node in answer["nodes"]],
        "after": [percent(node["after_db"]) for node in answer["nodes"]],
        "published": "odd distortion at low frequency, probably rolling friction in the bearings",
    }


SETS = {"silverbox": silverbox, "mirror": mirror, "bench": bench}
FOLDERS = {"silverbox": "silverbox", "mirror": "fine-steering-mirror", "bench": "two-mass-bench"}


def _named(answer):
    return [f"{cause['effect']} at {'-'.join(cause['at'])}" for cause in answer["causes"]]


def table(results):
    """Markdown."""
    rows = ["| set | linear model | corrected | published | verdict | named |", "|---|---|---|---|---|---|"]
    for name, result in results.items():
        before, after = (" / ".join(f"{x:.3g} %" for x in result[key]) for key in ("before", "after"))
        named = ", ".join(result["causes"]) or f"place: {result.get('where', '–')}"
        rows.append(f"| {name} | {before} | {after} | {result['published']} | {result['verdict']} | {named} |")
    return "\n".join(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", help=", ".join(SETS), metavar="SET")
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--json", type=Path, help="file to write")
    arguments = parser.parse_args()
    results = {}
    for name in arguments.sets or SETS:
        if not (arguments.data / FOLDERS[name]).is_dir():
            print(f"{name}: {arguments.data / FOLDERS[name]} is not there")
            continue
        with tempfile.TemporaryDirectory(prefix="creak-") as folder:
            results[name] = SETS[name](arguments.data.absolute(), Path(folder))
    print(table(results))
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1))
