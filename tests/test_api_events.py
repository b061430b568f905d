"""The event stream over a real server: in order, without gaps, and never in the way."""

import contextlib
import itertools
import json
import threading
import time

import pytest

from api_client import V1, assert_problem, serving
from creak.api import create_app
from creak.codec import alarm_json
from creak.records import Counts, RunEnd, RunStatus
from creak.sinks.database import open_store
from store_records import (
    SECOND,
    START,
    feed,
    make_alarm,
    make_run,
    opened,
)


@pytest.fixture
def client(store):
    with serving(create_app(store)) as client:
        yield client


class Stream:
    """A reader of server-sent events, as the standard describes them."""

    def __init__(self, client, last=None):
        headers = {} if last is None else {"Last-Event-ID": str(last)}
        self._context = client.stream("GET", f"{V1}/events", headers=headers)

    def __enter__(self):
        self.answer = self._context.__enter__()
        assert self.answer.status_code == 200
        self._lines = self.answer.iter_lines()
        while next(self._lines):  # the greeting: from here on nothing is missed
            pass
        return self

    def __exit__(self, *error):
        return self._context.__exit__(*error)

    def __iter__(self):
        fields = {}
        for line in self._lines:
            if not line and "event" in fields:
                yield fields["event"], int(fields["id"]), json.loads(fields["data"])
                fields = {}
            elif line and not line.startswith(":"):
                name, _, value = line.partition(": ")
                fields[name] = value


def take(stream, count):
    return list(itertools.islice(stream, count))


def test_events_arrive_as_they_happen(client, store):
    run = make_run("heard-1", "heard")
    with Stream(client) as stream:
        sink = opened(store, run)
        feed(sink, run, 1)
        change = make_alarm(run)
        sink.take(change)
        sink.close(RunEnd(START + SECOND, RunStatus.COMPLETED, Counts()))
        events = take(stream, 5)
    assert [(kind, data["rig"]) for kind, _, data in events] == [
        (kind, "heard") for kind in ("run", "levels", "levels", "alarm", "run")
    ]
    assert events[3][2] == alarm_json(change)
    assert [node["name"] for node in events[1][2]["nodes"]] == ["1", "2", "3"]
    assert stream.answer.headers["content-type"].startswith("text/event-stream")


def test_reconnecting_with_the_last_id_leaves_no_gap(client, store):
    """Kills events that are lost or doubled while a client is away, or while it catches up with a live rig."""
    run = make_run("away-1", "away")
    sink = opened(store, run)
    with Stream(client) as stream:
        sink.take(make_alarm(run, number=0))
        ((_, last, _),) = take(stream, 1)
    seen = []
    numbers = iter(range(1, 401))
    writer = threading.Thread(target=lambda: [sink.take(make_alarm(run, number=n)) for n in numbers])
    writer.start()
    while len(seen) < 400:
        with Stream(client, last) as stream:
            seen += take(stream, 137 if len(seen) < 200 else 400 - len(seen))
        last = seen[-1][1]
    writer.join()
    assert [data["id"] for _, _, data in seen] == [f"away-1/3/{number}" for number in range(1, 401)]
    ids = [number for _, number, _ in seen]
    assert ids == list(range(ids[0], ids[0] + 400))


def test_events_that_are_gone_are_announced(tmp_path):
    """Kills a silent gap: a client that was away too long, or that knew another store, must read anew."""
    store = open_store(f"sqlite:///{tmp_path}/creak.db")
    run = make_run()
    sink = opened(store, run, keep_events=100)
    for number in range(600):
        sink.take(make_alarm(run, number=number))
    with serving(create_app(store)) as client:
        with Stream(client, 1) as stream:
            (kind, reset, _), (_, first, _) = take(stream, 2)
        assert (kind, first) == ("reset", reset + 1)
        with Stream(client, 10**6) as stream:
            sink.take(make_alarm(run, number=600))
            (kind, _, _), (_, _, alarm) = take(stream, 2)
        assert (kind, alarm["id"]) == ("reset", "run-1/3/600")
        for bad in ("one", "-1", str(2**63)):
            assert_problem(client.get(f"{V1}/events", headers={"Last-Event-ID": bad}), 422, "bad-parameter")
    store.close()


def test_quiet_stream_has_a_heartbeat(client, monkeypatch):
    monkeypatch.setattr("fastapi.routing._PING_INTERVAL", 0.1)
    with client.stream("GET", f"{V1}/events") as answer:
        lines = list(itertools.islice(answer.iter_lines(), 8))
    assert lines.count(": ping") >= 2


def test_open_stream_does_not_hold_the_server(store):
    """Kills a service that does not end while a dashboard is open."""
    with contextlib.ExitStack() as stack:
        with serving(create_app(store)) as client:
            stream = stack.enter_context(Stream(client))
            begun = time.monotonic()
            client.server.stop()
            assert list(stream) == []
        assert time.monotonic() - begun < 2
