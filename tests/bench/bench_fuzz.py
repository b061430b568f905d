"""Requests made from the OpenAPI document, good and bad: no answer of 5xx, and none that is not documented.

Half of them are as the document allows. In most of these, ids and entity tags are ones that there are, also those
that earlier answers gave, so that things are made, changed, refused for what they have become, and removed.
"""

import argparse
import contextlib
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from urllib.parse import quote

import schemathesis
import sqlalchemy as sa
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from schemathesis.checks import CHECKS, load_all_checks

sys.path.insert(0, str(Path(__file__).parents[1]))

from api_client import serving
from creak.api import create_app
from creak.api.access import Access
from creak.sinks import receivers, tables
from creak.sinks.database import open_store
from creak.sinks.operator_tables import outbox
from creak.sinks.store import RecordingEntry, StoreSink, put_recording
from store_records import BEAM, SECOND, START, fill_beam, make_alarm

_CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
)
_STREAMS = "/api/v1/events"  # an answer without an end, which the library would wait for


_ROUNDS = 8  # what one round makes (receivers, jobs, changed alarms) the next one meets
_BODIES = {  # fields that a generator never guesses; a time of that kind, a receiver that may be added
    "until": ["2026-05-01T09:00:00Z", "2026-05-01T08:00:00.5Z", "2100-01-01"],
    "url": ["http://127.0.0.1:9/hook", "https://127.0.0.1/", "http://10.0.0.1/"],
    "by": ["ada"],
}


class World:
    """Ids that there are, as a client learns them: from the beginning, and from what it is answered."""

    def __init__(self, **known):
        self.known = {name: list(ids) for name, ids in known.items()}

    def learn(self, case, response):
        """Take up the id of what a request has made."""
        if response.status_code in {201, 202} and isinstance(made := response.json(), dict) and "id" in made:
            path = case.operation.path
            for part, names in (
                ("diagnoses", ("diagnosis", "job")),
                ("replay", ("job",)),
                ("webhooks", ("webhook",)),
            ):
                if part in path and "deliveries" not in path and not path.endswith("test"):
                    for name in names:
                        self.known[name].append(made["id"])

    def put_in(self, case, data):
        """Replace, now and then, what was guessed by what there is."""
        sometimes = st.integers(0, 3)
        for name in case.path_parameters or {}:
            if self.known.get(name) and data.draw(sometimes):
                case.path_parameters[name] = quote(data.draw(st.sampled_from(self.known[name])), safe="")
        for name in ("If-Match", "If-None-Match"):
            if any(header.name.lower() == name.lower() for header in case.operation.headers):
                if data.draw(sometimes) > 1:
                    case.headers[name] = data.draw(st.sampled_from(['"0-0"', "*", 'W/"1-1", *', '"']))
                else:
                    case.headers.pop(name, None)
        if isinstance(case.body, dict):
            for name, values in {**_BODIES, **self.known}.items():
                if name in case.body and values and data.draw(sometimes):
                    case.body[name] = data.draw(st.sampled_from(values))


@contextlib.contextmanager
def _world():
    """A client of a service with rigs, alarms, a recording with its file and a receiver; nobody measures."""
    with tempfile.TemporaryDirectory() as name:
        directory = Path(name)
        store = open_store(f"sqlite:///{directory}/creak.db")
        fill_beam(store)
        sink, file = StoreSink(store), directory / "beam.mcap"
        model = Path(__file__).parents[2] / "deploy/examples/three-mass/model.toml"
        sink._run, sink._rig = BEAM.id, BEAM.rig.name
        over = make_alarm(BEAM, number=5, since=START)  # a newer one of the node stands
        for change in (over, make_alarm(BEAM, node="2"), make_alarm(BEAM, "", 2, class_="quality")):
            sink.take(change)
        sink.take(make_alarm(BEAM, number=6, since=START + 8 * SECOND))
        file.write_bytes(b"recorded")
        entry = RecordingEntry("beam-1-001", "beam", BEAM.id, str(file), START, START + SECOND, "complete", 8)
        put_recording(store, entry)
        with store.write() as connection:
            connection.execute(sa.update(tables.runs).values(status="completed"))
            secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
            receiver = receivers.add(connection, "http://127.0.0.1:9/", (), (), "standard", secret)
        sink.take(make_alarm(BEAM, node="1"))  # so that there is a message
        with store.read() as connection:
            messages = list(connection.execute(sa.select(outbox.c.id)).scalars())
            alarms = list(connection.execute(sa.select(tables.alarms.c.id)).scalars())
        world = World(
            rig=["beam", "bench"],
            node=["1", "2", "3"],
            alarm=alarms,
            recording=["beam-1-000", "beam-1-001"],
            webhook=[receiver.id],
            message=messages,
            diagnosis=[],
            job=[],
        )
        access = Access(per_second=1e9, allow=["127.0.0.0/8"])
        with serving(create_app(store, access=access, models_of={"beam": model})) as client:
            yield client, world
        store.close()


def measure(requests, number=1):
    """Make at least so many requests; statuses counted, and what failed."""
    load_all_checks()
    checks = [CHECKS.get_one(name) for name in _CHECKS]
    statuses, failures, begun = Counter(), [], time.monotonic()
    with _world() as (client, world):
        schema = schemathesis.openapi.from_url(f"{client.base_url}/openapi.json")
        operations = [found.ok() for found in schema.get_all_operations()]
        operations = [operation for operation in operations if operation.path != _STREAMS]
        each = -(-requests // (_ROUNDS * len(operations)))
        for turn in range(_ROUNDS):
            for operation in operations:
                _fuzz(operation, max(each, 2), number * 1000 + turn, checks, world, statuses, failures)
            if sum(statuses.values()) >= requests:
                break
        while (missing := requests - sum(statuses.values())) > 0 and turn < 5 * _ROUNDS:  # some are soon all made
            turn += 1
            rich = [operation for operation in operations if operation.query or operation.body]
            for operation in rich:
                share = -(-missing // len(rich))
                _fuzz(operation, max(share, 2), number * 1000 + turn, checks, world, statuses, failures)
    return {
        "requests": sum(statuses.values()),
        "operations": len(operations),
        "statuses": dict(sorted(statuses.items())),
        "seconds": round(time.monotonic() - begun, 1),
        "failures": failures[:20],
    }


def _fuzz(operation, examples, number, checks, world, statuses, failures):
    wrong = examples // 2 if operation.query or operation.headers or operation.body else 0  # else all is right
    for right, share in ((True, examples - wrong), (False, wrong)):
        if share:
            _ask(operation, share, right, number, checks, world, statuses, failures)


def _ask(operation, examples, right, number, checks, world, statuses, failures):
    mode = schemathesis.GenerationMode.POSITIVE if right else schemathesis.GenerationMode.NEGATIVE

    @seed(number)
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=mode), data=st.data())
    def request(case, data):
        if right:
            world.put_in(case, data)
        response = case.call()
        statuses[response.status_code] += 1
        for check in checks:
            try:
                case.validate_response(response, checks=[check])
            except (AssertionError, BaseExceptionGroup, schemathesis.errors.SchemathesisError) as error:
                failures.append(f"{operation.label}: {type(error).__name__}: {str(error)[:600]}")
        world.learn(case, response)

    try:
        request()
    except Exception as error:  # noqa: BLE001 - whatever the library raises, the rest is measured
        if "Unsatisfiable" not in type(error).__name__ and "unsatisfiable" not in str(error).lower():
            failures.append(f"{operation.label}: {type(error).__name__}: {str(error)[:600]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--requests", type=int, default=10_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    result = measure(options.requests)
    print(json.dumps(result, indent=None if options.json else 2))
    sys.exit(bool(result["failures"]))


if __name__ == "__main__":
    main()
