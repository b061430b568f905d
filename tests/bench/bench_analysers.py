"""Two analysers against one: realisations a second of a backlog of three-mass rigs, side by side.

One analyser works on a backlog of its own, two on another, at the same time, so that whatever else runs on the
machine hits both alike; each has a broker and a schema of its own. The brokers start once the rigs are shared. All
processes and PostgreSQL compete for the same cores: `cores busy` is the share of them in use, by whomever.
"""

import contextlib
import os
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from dataclasses import replace

import sqlalchemy as sa
from bench_messages import gathered, source_of
from figures import options, show

from creak.broker import Broker, StreamLimits
from creak.codec.letters import Letter, letter_parts
from creak.config.rig import rig_toml
from creak.digests import OPENING, Digest
from creak.records import Frame
from creak.sinks.stream import subject
from fleet_places import Processes, broker
from fleet_truth import progress
from store_places import place

_SERVICE = """
data = "central"
[stream]
url = "{broker}"
lease_seconds = 4.0
[store]
url = "{store}"
"""
_RIG = """
[[rigs]]
rig = "{name}.toml"
[rigs.source]
kind = "stream"
"""
HANGS = 300.0


def wait(until):
    end = time.monotonic() + HANGS
    while not (found := until()):
        if time.monotonic() > end:
            raise TimeoutError("the analysers do not go on")
        time.sleep(0.05)
    return found


def processor_seconds(processes):
    """User and system time of processes so far."""
    ticks = 0
    for process in processes.running.values():
        fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def machine():
    """Seconds that the cores were busy and idle since the start of the machine."""
    values = [int(value) for value in Path("/proc/stat").read_text().splitlines()[0].split()[1:]]
    return sum(values) - values[3] - values[4], sum(values)


class Fleet:
    """A backlog, and analysers that wait for its broker."""

    def __init__(self, stack, run, digests, rigs, analysers):
        self.folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url = stack.enter_context(place("postgresql", self.folder))
        self.server = stack.enter_context(broker(self.folder / "nats"))
        self.total, self.rigs, self.analysers = rigs * len(digests), rigs, analysers
        text = _SERVICE.format(broker=self.server.url, store=url)
        connection = Broker(self.server.url, "creak", StreamLimits(7 * 86_400.0))
        wait(lambda: connection.connected)
        for number in range(rigs):
            name = f"rig{number}"
            rig = replace(run.rig, name=name)
            (self.folder / f"{name}.toml").write_text(rig_toml(rig))
            text += _RIG.format(name=name)
            its = replace(run, id=name, rig=rig)
            for digest in (Digest(OPENING, OPENING, run.start), *digests):
                for headers, data in letter_parts(Letter(1, None, its, digest), connection.largest - 4096):
                    connection.publish(subject("creak", "digests", name), data, headers)
        connection.close()
        self.server.kill()
        (self.folder / "analyse.toml").write_text(text)
        self.engine = sa.create_engine(url)
        stack.callback(self.engine.dispose)
        self.processes = Processes(self.folder)
        stack.callback(self.processes.close)
        for number in range(analysers):
            self.processes.start(f"analyser{number}", "analyse", "analyse.toml")

    @property
    def shared(self):
        owned = Counter(row.owner for row in progress(self.engine).values())
        fair = -(-self.rigs // self.analysers)
        return len(owned) == self.analysers and None not in owned and max(owned.values()) <= fair

    @property
    def taken(self):
        return sum(row.blocks for row in progress(self.engine).values())


def measure(run, digests, rigs, seconds):
    """Rates and processor times a realisation, of one analyser and of two; share of the machine in use."""
    with contextlib.ExitStack() as stack:
        fleets = [Fleet(stack, run, digests, rigs, analysers) for analysers in (1, 2)]
        wait(lambda: all(fleet.shared for fleet in fleets))
        for fleet in fleets:
            fleet.server.start()
        wait(lambda: all(fleet.taken >= rigs for fleet in fleets))
        first = [fleet.taken for fleet in fleets]
        used = [processor_seconds(fleet.processes) for fleet in fleets]
        begun, before = time.monotonic(), machine()
        while time.monotonic() - begun < seconds and all(fleet.taken < 0.9 * fleet.total for fleet in fleets):
            time.sleep(0.5)
        counts = [fleet.taken - count for fleet, count in zip(fleets, first, strict=True)]
        used = [processor_seconds(fleet.processes) - one for fleet, one in zip(fleets, used, strict=True)]
        took = time.monotonic() - begun
        busy, total = (after - one for one, after in zip(before, machine(), strict=True))
    return [count / took for count in counts], [u / c for u, c in zip(used, counts, strict=True)], busy / total


def main():
    given = options(__doc__, rigs=6, realisations=60, seconds=40.0)
    source = source_of("three-mass", given.realisations)
    digests = gathered(source.run, [item for item in source.frames() if isinstance(item, Frame)])
    rates, costs, busy = measure(source.run, digests, given.rigs, given.seconds)
    rows = [
        {
            "analysers": number + 1,
            "realisations a second": rate,
            "times one": rate / rates[0],
            "ms of a core each": 1e3 * cost,
            "cores busy": busy,
        }
        for number, (rate, cost) in enumerate(zip(rates, costs, strict=True))
    ]
    show("analysers", rows, given.json)


if __name__ == "__main__":
    main()
