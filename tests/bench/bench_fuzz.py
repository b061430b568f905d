"""Requests made from the OpenAPI document, good and bad: no answer of 5xx, and none that is not documented."""

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import schemathesis
import sqlalchemy as sa
from hypothesis import HealthCheck, Phase, given, seed, settings
from schemathesis.checks import CHECKS, load_all_checks

sys.path.insert(0, str(Path(__file__).parents[1]))

from api_client import serving
from creak.api import create_app
from creak.api.access import Access
from creak.sinks import receivers, tables
from creak.sinks.database import open_store
from store_records import fill_beam

_CHECKS = (
    "not_a_server_error",
    "status_code_conformance",
    "content_type_conformance",
    "response_headers_conformance",
    "response_schema_conformance",
)
_STREAMS = "/api/v1/events"  # an answer without an end, which the library would wait for


def measure(requests, number=1):
    """Make at least so many requests; statuses counted, and what failed."""
    load_all_checks()
    checks = [CHECKS.get_one(name) for name in _CHECKS]
    statuses, failures, begun = Counter(), [], time.monotonic()
    with tempfile.TemporaryDirectory() as directory:
        store = open_store(f"sqlite:///{directory}/creak.db")
        fill_beam(store)
        with store.write() as connection:  # nobody measures, and that is in order
            connection.execute(sa.update(tables.runs).values(status="completed"))
            receivers.add(
                connection, "http://127.0.0.1:9/", (), (), "standard", "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
            )
        access = Access(per_second=1e9, allow=["127.0.0.0/8"])
        with serving(create_app(store, access=access)) as client:
            schema = schemathesis.openapi.from_url(f"{client.base_url}/openapi.json")
            operations = [found.ok() for found in schema.get_all_operations()]
            operations = [operation for operation in operations if operation.path != _STREAMS]
            for operation in operations:
                _fuzz(operation, -(-requests // len(operations)), number, checks, statuses, failures)
        store.close()
    return {
        "requests": sum(statuses.values()),
        "operations": len(operations),
        "statuses": dict(sorted(statuses.items())),
        "seconds": round(time.monotonic() - begun, 1),
        "failures": failures[:20],
    }


def _fuzz(operation, examples, number, checks, statuses, failures):
    mode = schemathesis.GenerationMode
    wrong = examples // 2 if operation.query or operation.headers or operation.body else 0  # else all is right
    for one, share in ((mode.POSITIVE, examples - wrong), (mode.NEGATIVE, wrong)):
        if share == 0:
            continue

        @seed(number)
        @settings(
            max_examples=share,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(case=operation.as_strategy(generation_mode=one))
        def request(case):
            response = case.call()
            statuses[response.status_code] += 1
            for check in checks:
                try:
                    case.validate_response(response, checks=[check])
                except (AssertionError, BaseExceptionGroup, schemathesis.errors.SchemathesisError) as error:
                    failures.append(f"{operation.label}: {type(error).__name__}: {str(error)[:600]}")

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
