"""Kill -9 at random moments: a process that raises alarms and one that delivers them; nothing may be lost.

Each round starts one process that does both on one store, kills it after a random time, and notes which
changes it had reported as written. At the end a last deliverer empties the outbox; every reported change must have
arrived, and every id with one body. What has not arrived is counted by what the outbox says of it: ``pending`` is
late, not lost; ``failed``, ``delivered`` and ``absent`` (no row) are lost.
"""

import argparse
import itertools
import json
import multiprocessing
import os
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import sqlalchemy as sa

from creak.sinks import receivers
from creak.sinks.database import open_store
from creak.sinks.operator_tables import outbox
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import Deliverer, DeliveryRules
from creak.webhooks.schedule import Schedule
from creak.webhooks.signature import new_secret
from receiver import receiving
from store_records import make_alarm, make_run, opened

_QUIET_SECONDS = 60.0  # nothing new for so long: what is missing will not come
_RULES = DeliveryRules(per_minute=1e6, burst=10**6, storm=10**9, schedule=Schedule(delays=(0.1,) * 50))


def child(url, number, report):
    """Raise alarms without end and deliver them; say which were written."""
    store = open_store(url)
    Deliverer(store, AddressPolicy(["127.0.0.0/8"]), _RULES).start()
    run = make_run(f"run-{number}")
    sink = opened(store, run)
    said = os.open(report, os.O_WRONLY | os.O_APPEND)
    for count in itertools.count():
        sink.take(make_alarm(run, number=count))
        os.write(said, f"{run.id}/3/{count}\n".encode())
        time.sleep(0.002)


def _child():
    """The child of the module that is preloaded, not that of a script."""
    from bench import bench_webhooks

    return bench_webhooks.child


def _missing(store, ids):
    """Count messages that did not arrive by what the outbox says of them."""
    counts = dict.fromkeys(("pending", "failed", "delivered", "absent"), 0)
    with store.read() as connection:
        rows = connection.execute(sa.select(outbox.c.subject, outbox.c.status))
        status = {row.subject: row.status for row in rows}
    for each in ids:
        counts[status.get(each, "absent")] += 1
    return counts


def measure(kills, seed=1):
    """Kill so often; what was written, what arrived, what was lost."""
    dice = random.Random(seed)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["bench.bench_webhooks"])  # a fork is quick, all the imports are not
    paths = [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))  # its server looks nowhere else
    with tempfile.TemporaryDirectory() as directory, receiving() as server:
        url, report = f"sqlite:///{directory}/creak.db", Path(directory, "written")
        report.touch()
        store = open_store(url)
        with store.write() as connection:
            receivers.add(connection, server.url, (), (), "standard", new_secret())
        for number in range(kills):
            before = report.stat().st_size
            process = context.Process(target=_child(), args=(url, number, str(report)))
            process.start()
            while report.stat().st_size == before:
                time.sleep(0.005)
            time.sleep(dice.uniform(0.0, 0.4))
            process.kill()
            process.join()
        written = report.read_text().split()
        last = Deliverer(store, AddressPolicy(["127.0.0.0/8"]), _RULES)
        last.start()
        begun = time.monotonic()
        before_drain = len(server.received)
        arrived, news = set(), begun
        while time.monotonic() < news + _QUIET_SECONDS and not arrived.issuperset(written):
            time.sleep(0.1)
            seen = {got.json["data"]["id"] for got in list(server.received)}
            if len(seen) > len(arrived):
                arrived, news = seen, time.monotonic()
        seconds = time.monotonic() - begun
        last.stop()
        missing = _missing(store, set(written) - arrived)
        bodies = {}
        for got in server.received:
            bodies.setdefault(got.id, set()).add(got.body)
        store.close()
        return {
            "kills": kills,
            "written": len(written),
            "arrived": len(arrived),
            "lost": sum(missing.values()) - missing["pending"],
            **{f"missing_{status}": count for status, count in missing.items()},
            "drained": len(server.received) - before_drain,
            "drain_seconds": round(seconds, 1),
            "requests": len(server.received),
            "twice": len(server.received) - len(bodies),
            "ids_of_more_than_one_body": sum(len(each) > 1 for each in bodies.values()),
        }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = measure(options.kills)
    if options.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:28}{value}")


if __name__ == "__main__":
    main()
