"""How many CAN FD frames a second one core decodes and cuts into periods, beside cantools and a bare loop.

Both ends of an 8 Mbit/s bus (1 Mbit/s arbitration): the beam's frames of 64 bytes, and frames of 8 bytes, of which
most fit. The bus is taken as fully loaded with frames that have no stuff bits, the most that it can carry.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import cantools.database
import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

import can

import can_rigs
from conftest import make_rig, make_run
from creak.records import Fault, Frame
from creak.sources.can_controller import Controller
from creak.sources.can_frames import CanFrames
from creak.sources.can_load import frame_seconds
from creak.sources.can_pipeline import CanPipeline

N = 16384


def stream(run, mapping, frames):
    """At least so many CAN frames of whole periods, random samples, and how many periods."""
    rng = np.random.default_rng(1)
    controller, out, index, count = Controller(run, mapping), [], 0, 0
    while count < frames:
        c, p = index // run.periods % run.rig.q, index % run.periods
        u, y = 0.02 * rng.standard_normal((run.rig.q, N)), 5e-4 * rng.standard_normal((run.rig.n, N))
        m = index // run.periods // run.rig.q
        out.append(controller.frames(Frame(m, c, p, round(index * run.rig.period_ns), u, y), index))
        count += len(out[-1])
        index += 1
    whole = CanFrames(
        *(np.concatenate([getattr(o, k) for o in out]) for k in ("identifiers", "times", "lengths", "data"))
    )
    return whole, index


def seconds(work):
    begun = time.perf_counter()
    result = work()
    return time.perf_counter() - begun, result


def layout(name, text, frames, folder):
    """Figures of one layout."""
    nodes = 3 if name == "64 bytes" else 2
    run = make_run(make_rig(nodes, samples=N, lines=range(2, 200)))
    mapping = can_rigs.mapping(folder, run, text)
    given, periods = stream(run, mapping, frames)
    database = cantools.database.load_string(text, "dbc")
    messages = [
        can.Message(
            timestamp=t * 1e-9, arbitration_id=int(i), is_extended_id=False, data=d[:length].tobytes(), is_fd=True
        )
        for t, i, d, length in zip(given.times, given.identifiers, given.data, given.lengths.tolist(), strict=True)
    ]

    def cut(batches):
        pipeline = CanPipeline(run, mapping)
        return [item for batch in batches for item in pipeline.push(batch)]

    def bare():
        for message in messages:
            message.data  # noqa: B018

    def decode():
        for message in messages[:4000]:
            database.decode_message(message.arbitration_id, message.data, decode_choices=False)

    size = 1024
    cut([given[i : i + size] for i in range(0, 2 * size, size)])  # tables are made once
    arrays, found = seconds(lambda: cut([given[i : i + size] for i in range(0, len(given), size)]))
    objects, again = seconds(
        lambda: cut(CanFrames.of(messages[i : i + size]) for i in range(0, len(messages), size))
    )
    for items in (found, again):
        assert sum(isinstance(item, Frame) for item in items) == periods
        assert not any(isinstance(item, Fault) for item in items)
    length = int(given.lengths[0])
    bus = 1 / frame_seconds(length, extended=False, fd=True, bitrate=1e6, data_bitrate=8e6, stuffed=False)
    return {
        "frames": len(given),
        "bus_frames_per_s": round(bus),
        "frames_per_s": round(len(given) / objects),
        "times_bus": round(len(given) / objects / bus, 1),
        "us_per_frame": round(1e6 * objects / len(given), 2),
        "us_per_frame_from_arrays": round(1e6 * arrays / len(given), 2),
        "us_per_frame_cantools": round(1e6 * seconds(decode)[0] / min(4000, len(given)), 2),
        "us_per_frame_bare_loop": round(1e6 * seconds(bare)[0] / len(given), 3),
    }


def measure(frames=120_000):
    """Figures of both layouts, in one run."""
    with tempfile.TemporaryDirectory() as folder:
        return {
            "64 bytes": layout("64 bytes", (ROOT / "deploy/can/beam.dbc").read_text(), frames, Path(folder)),
            "8 bytes": layout("8 bytes", can_rigs.multiplexed(2), frames, Path(folder)),
        }


def main(arguments=None):
    """Print the figures as one JSON document."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--frames", type=int, default=120_000)
    figures = measure(parser.parse_args(arguments).frames)
    print(json.dumps(figures, indent=1))
    return 0 if all(each["times_bus"] >= 10 for each in figures.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
