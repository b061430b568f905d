"""A fleet under kill -9: workers, analysers and broker die at random; what is lost, what is counted twice.

Two rigs with a worker each, two analysers, a broker and a schema of PostgreSQL of their own. What the store holds
at the end is compared, to the last bit, with what the recordings of the workers say it must hold.
"""

import contextlib
import random
import signal
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import sqlalchemy as sa
from figures import options, show

from fleet_places import Processes, broker, write_fleet
from fleet_truth import closed, expected, progress, stored
from store_places import place

RIGS = ["a", "b"]
ANALYSERS = ["one", "two"]
HANGS = 300.0  # seconds without progress after which something is wrong


def wait(until):
    begun = time.monotonic()
    while not until():
        if time.monotonic() - begun > HANGS:
            raise TimeoutError("the fleet does not go on")
        time.sleep(0.05)
    return time.monotonic() - begun


def taken(engine):
    rows = progress(engine)
    return {rig: rows[rig].blocks if rig in rows else 0 for rig in RIGS}


def goes_on(engine, by=1):
    """Seconds until every rig has so many realisations more."""
    before = taken(engine)
    return wait(lambda: all(taken(engine)[rig] >= before[rig] + by for rig in RIGS))


class Fleet:
    def __init__(self, folder, server, engine):
        self.folder, self.server, self.engine = Path(folder), server, engine
        self.processes = Processes(self.folder)

    def start(self, name):
        if name == "broker":
            self.server.start()
        elif name in ANALYSERS:
            self.processes.start(name, "analyse", "analyse.toml")
        else:
            self.processes.start(name, "worker", f"{name}-worker.toml")

    def kill(self, name):
        if name == "broker":
            self.server.kill()
        else:
            self.processes.kill(name)


def owners(engine):
    return {rig: row.owner for rig, row in progress(engine).items()}


def takeover(fleet, name, dice):
    """Kill an analyser; seconds until each rig that it had has another owner and goes on."""
    had = owners(fleet.engine)
    fleet.kill(name)
    begun = time.monotonic()
    restart = begun + dice.uniform(0.0, 20.0)  # as often as not after others have taken over
    before = taken(fleet.engine)
    started = False
    rows = {}
    lost = None  # rigs of the killed one: those whose owner has to change, known once the others have gone on
    while True:
        now = time.monotonic()
        if not started and now > restart:
            fleet.start(name)
            started = True
        rows = owners(fleet.engine)
        blocks = taken(fleet.engine)
        waiting = [rig for rig in RIGS if blocks[rig] == before[rig]]
        if not waiting and all(rows[rig] for rig in RIGS):
            lost = [rig for rig in RIGS if rows[rig] != had[rig]]
            break
        if now - begun > HANGS:
            raise TimeoutError("a rig is not taken over")
        time.sleep(0.05)
    seconds = time.monotonic() - begun
    if not started:
        time.sleep(max(0.0, min(restart - time.monotonic(), 2.0)))
        fleet.start(name)
    return seconds if lost else None


def measure(kills, seed=1, pace=4.0, lease=12.0):
    dice = random.Random(seed)
    counts = dict.fromkeys(("workers", "analysers", "broker"), 0)
    takeovers = []
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url = stack.enter_context(place("postgresql", folder))
        server = stack.enter_context(broker(folder / "nats"))
        write_fleet(folder, server.url, url, RIGS, pace=pace, lease=lease)
        engine = sa.create_engine(url)
        stack.callback(engine.dispose)
        fleet = Fleet(folder, server, engine)
        stack.callback(fleet.processes.close)
        for name in (*ANALYSERS, *RIGS):
            fleet.start(name)
        goes_on(engine, by=3)
        for number in range(kills):
            time.sleep(dice.uniform(0.0, 2.0))
            name = dice.choice([*RIGS, *ANALYSERS, "broker", "broker"])
            kind = "broker" if name == "broker" else "analysers" if name in ANALYSERS else "workers"
            counts[kind] += 1
            if kind == "analysers":
                seconds = takeover(fleet, name, dice)
                takeovers += [] if seconds is None else [seconds]
            else:
                fleet.kill(name)
                time.sleep(dice.uniform(0.0, 3.0))
                fleet.start(name)
            waited = goes_on(engine)
            if sys.stderr.isatty():
                print(f"{number + 1}/{kills}: {name}, goes on after {waited:.1f} s", file=sys.stderr)
        for rig in RIGS:
            fleet.processes.kill(rig, signal.SIGTERM)
        wait(lambda: closed(engine, folder, RIGS))
        result = {"realisations": 0, "lost": 0, "counted twice": 0, "different": 0}
        result |= {"alarm changes": 0, "alarms lost": 0, "alarms doubled": 0}
        for rig in RIGS:
            wanted, changes, complete = expected(folder, rig)
            found, journal, counted, twice, alarms_twice = stored(engine, rig)
            result["realisations"] += sum(complete.values())
            result["lost"] += len(wanted.keys() - found.keys()) + sum(
                max(0, number - counted.get(run, 0)) for run, number in complete.items()
            )
            result["counted twice"] += twice + len(found.keys() - wanted.keys())
            result["counted twice"] += sum(
                max(0, number - complete.get(run, 0)) for run, number in counted.items()
            )
            result["different"] += sum(found.get(key) != levels for key, levels in wanted.items())
            said = [(change["id"], change["version"]) for change in journal]
            meant = [(change["id"], change["version"]) for change in changes]
            result["alarm changes"] += len(meant)
            result["alarms lost"] += len(set(meant) - set(said))
            result["alarms doubled"] += alarms_twice + len(set(said) - set(meant))
    slowest = {"takeovers": len(takeovers), "slowest takeover, s": round(max(takeovers, default=0.0), 1)}
    return {"kills": kills, **{f"of {kind}": count for kind, count in counts.items()}, **result, **slowest}


def main():
    given = options(__doc__, kills=50, seed=1)
    show("fleet under kill -9", [measure(given.kills, given.seed)], given.json)


if __name__ == "__main__":
    main()
