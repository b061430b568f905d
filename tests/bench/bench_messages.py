"""What a realisation of a rig costs a fleet: bytes on the wire and in the store, messages, rows, processor time.

Three masses and the beam, as their examples have them; the beam's realisation of 72 s is the longer one.
"""

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import sqlalchemy as sa
from figures import options, show

from creak import codec
from creak.analysis import Plan, RigAnalysis
from creak.broker import Broker, StreamLimits
from creak.codec.letters import Letter, letter_parts
from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.digests import CLOSING, OPENING, Digest, Gatherer
from creak.records import AlarmRules, BaselineRules, Frame, Limits
from creak.sinks import fleet, kept_sums, tables
from creak.sinks.database import open_store
from creak.sinks.stream import subject
from creak.sources.simulated import SimulatedRig
from fleet_places import broker
from store_places import place

EXAMPLES = Path(__file__).parents[2] / "deploy" / "examples"
LARGEST = (1 << 20) - 4096
ROWS = (tables.estimates, tables.levels, tables.spectra, tables.events, kept_sums.fleet_sums)


def source_of(name, realisations):
    folder = EXAMPLES / name
    rig, model = load_rig(folder / "rig.toml"), load_model(folder / "model.toml")
    rms = 0.02 if name == "beam" else 50.0
    return SimulatedRig(rig, model, steady_periods=2, rms=rms, seed=1, realisations=realisations, run_id=name)


def gathered(run, frames, whole_frames=False):
    gatherer = Gatherer(run, whole_frames=whole_frames)
    told = [each for frame in frames for each in gatherer.take(frame)] + gatherer.finish()
    return [each for each in told if isinstance(each, Digest) and each.index not in {OPENING, CLOSING}]


def sent(run, digest):
    parts = list(letter_parts(Letter(1, None, run, digest), LARGEST))
    return sum(len(data) for _, data in parts), len(parts)


def analysed(folder, run, digests):
    """Seconds of processor time a realisation, and rows and bytes of the store that it adds."""
    with place("postgresql", folder) as url, broker(folder / "nats") as server:
        store, connection = open_store(url), Broker(server.url, "m", StreamLimits(3600.0))
        while not connection.connected:
            time.sleep(0.05)
        digests = [Digest(OPENING, OPENING, run.start), *digests]
        for digest in digests:
            room = connection.largest - 4096
            for headers, data in letter_parts(Letter(1, None, run, digest), room):
                connection.publish(subject("m", "digests", run.rig.name), data, headers)
        with store.write() as transaction:
            epoch = fleet.share(transaction, "analyser/bench", [run.rig.name], 600.0)[run.rig.name]
        plan = Plan(run.rig, run.window, Limits(), AlarmRules(), BaselineRules())
        identity, _ = connection.identity()
        analysis = RigAnalysis(store, connection, plan, epoch, "m", identity, 60.0, time.monotonic)
        warm = 1 + run.window
        for _ in range(warm):
            analysis.step(time.time_ns())
        before = rows(store)
        begun, waited = time.process_time(), time.monotonic()
        while analysis.step(time.time_ns()):
            pass
        cpu, wall = time.process_time() - begun, time.monotonic() - waited
        count = len(digests) - warm
        with store.read() as transaction:
            kept, row = kept_sums.fleet_sums, fleet.fleet
            size = sa.select(sa.func.length(kept.c.payload)).order_by(kept.c.number.desc(), kept.c.slot.desc())
            small = sa.select(sa.func.length(row.c.opening) + sa.func.length(row.c.checkpoint))
            spectra = sa.select(sa.func.sum(sa.func.length(tables.spectra.c.samples)))
            block, whole, rest, shown = (
                int(transaction.execute(each).scalars().first())
                for each in (size.where(kept.c.slot > 0), size.where(kept.c.slot == -1), small, spectra)
            )
            state = block + whole / run.window + rest
        added = (rows(store) - before) / count
        connection.close()
        store.close()
    return cpu / count, wall / count, added, state, shown


def rows(store):
    with store.read() as transaction:
        return sum(
            transaction.execute(sa.select(sa.func.count()).select_from(table)).scalar_one() for table in ROWS
        )


def measure(name, realisations):
    source = source_of(name, realisations)
    frames = [item for item in source.frames() if isinstance(item, Frame)]
    run = source.run
    first = [frame for frame in frames if frame.realisation == 0]
    samples = sum(frame.u.nbytes + frame.y.nbytes for frame in first)
    digests = gathered(run, frames)
    sums, parts = sent(run, digests[0])
    whole, frame_parts = sent(run, gathered(run, first, whole_frames=True)[0])
    recorded = sum(len(codec.encode(frame)) for frame in first)
    with tempfile.TemporaryDirectory() as folder:
        cpu, wall, added, state, shown = analysed(Path(folder), run, digests)
    return {
        "rig": run.rig.name,
        "seconds": len(first) * run.rig.period_ns / 1e9,
        "lines": len(run.rig.lines),
        "samples, kB": samples / 1e3,
        "sums, kB": sums / 1e3,
        "ratio": samples / sums,
        "messages": parts,
        "frames, kB": whole / 1e3,
        "their messages": frame_parts,
        "recorded, kB": recorded / 1e3,
        "analysis, ms of a core": cpu * 1e3,
        "analysis, ms": wall * 1e3,
        "rows": added,
        "state written, kB": state / 1e3,
        "spectra written, kB": shown / 1e3,
    }


def main():
    given = options(__doc__, realisations=16)
    names = ("three-mass", "beam")
    show("a realisation in a fleet", [measure(name, given.realisations) for name in names], given.json)


if __name__ == "__main__":
    main()
