"""Kill -9 at random moments: a process that raises alarms and one that delivers them; nothing may be lost.

Each round starts one process that does both on one store, kills it after a random time, and notes which
changes it had reported as written. At the end a last deliverer empties the outbox; every reported change must have
arrived, and every id with one body.
"""

import argparse
import json
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from creak.sinks import receivers
from creak.sinks.database import open_store
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import Deliverer, DeliveryRules
from creak.webhooks.schedule import Schedule
from creak.webhooks.signature import new_secret
from receiver import receiving

_RULES = DeliveryRules(per_minute=1e6, burst=10**6, storm=10**9, schedule=Schedule(delays=(0.1,) * 50))

CHILD = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parents[1])!r})
from bench.bench_webhooks import child
child(sys.argv[1], int(sys.argv[2]))
"""


def child(url, number):
    """Raise alarms without end and deliver them; say which were written."""
    from store_records import make_alarm, make_run, opened

    store = open_store(url)
    Deliverer(store, AddressPolicy(["127.0.0.0/8"]), _RULES).start()
    run = make_run(f"run-{number}")
    sink = opened(store, run)
    count = 0
    while True:
        sink.take(make_alarm(run, number=count))
        sys.stdout.write(f"{run.id}/3/{count}\n")
        sys.stdout.flush()
        count += 1
        time.sleep(0.002)


def measure(kills, seed=1):
    """Kill so often; what was written, what arrived, what was lost."""
    dice = random.Random(seed)
    with tempfile.TemporaryDirectory() as directory, receiving() as server:
        url = f"sqlite:///{directory}/creak.db"
        store = open_store(url)
        with store.write() as connection:
            receivers.add(connection, server.url, (), (), "standard", new_secret())
        written = []
        for number in range(kills):
            command = [sys.executable, "-c", CHILD, url, str(number)]
            process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
            written.append(process.stdout.readline().strip())
            time.sleep(dice.uniform(0.0, 0.4))
            process.kill()
            rest, _ = process.communicate()
            written += rest.split("\n")[:-1]
        last = Deliverer(store, AddressPolicy(["127.0.0.0/8"]), _RULES)
        last.start()
        end = time.monotonic() + 120
        arrived = set()
        while time.monotonic() < end and not arrived.issuperset(written):
            time.sleep(0.1)
            arrived = {got.json["data"]["id"] for got in list(server.received)}
        last.stop()
        bodies = {}
        for got in server.received:
            bodies.setdefault(got.id, set()).add(got.body)
        store.close()
        return {
            "kills": kills,
            "written": len(written),
            "arrived": len(arrived),
            "lost": len(set(written) - arrived),
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
