"""The API over a real server on the loopback interface, filled as a worker fills it."""

import itertools
import re
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from api_client import V1, get, serving, walk
from conftest import make_rig
from creak.api import create_app
from creak.api.paging import read_cursor, write_cursor
from creak.api.problems import ProblemError
from creak.codec import alarm_json, node_json, spectrum_json
from creak.records import AlarmState, Counts, Node, RunEnd, RunStatus, Scope
from creak.sinks.database import open_store
from store_places import PLACES, place
from store_records import (
    BEAM,
    SECOND,
    START,
    feed,
    fill_beam,
    make_alarm,
    make_estimate,
    make_run,
    opened,
)


@pytest.fixture(scope="module", params=PLACES)
def store(request, tmp_path_factory):
    with place(request.param, tmp_path_factory.mktemp("api")) as url:
        opened_store = open_store(url)
        fill_beam(opened_store)
        yield opened_store
        opened_store.close()


@pytest.fixture(scope="module")
def client(store):
    """A server over a store with two rigs: the beam, measured, with an alarm; and a bench that has just begun."""
    with serving(create_app(store)) as client:
        yield client


# --- what it answers -------------------------------------------------------------------------------------------


def test_rigs(client):
    assert [rig["name"] for rig in get(client, f"{V1}/rigs")["items"]] == ["beam", "bench"]
    rig = get(client, f"{V1}/rigs/beam")
    assert rig["status"] == "running"
    assert (rig["frames"], rig["rejected_frames"], rig["transient_frames"]) == (8 * 3 * 2, 0, 8 * 3)
    assert (rig["realisations"], rig["experiments"], rig["faults"]) == (8, 24, {"lost": 1})
    assert rig["start"] == "2026-05-01T08:00:00.000000Z"
    assert rig["alarms"] == {"3": "unacknowledged"}
    assert rig["recent_faults"][0]["kind"] == "lost"
    assert 'name = "beam"' in rig["configuration"]


@pytest.mark.parametrize("scope", list(Scope))
def test_nodes_have_the_keys_and_levels_of_replay(client, scope):
    estimate = make_estimate(BEAM, 7, scope, ratio=12.0)
    states = [AlarmState.NORMAL, AlarmState.NORMAL, AlarmState.UNACKNOWLEDGED]
    items = get(client, f"{V1}/rigs/beam/nodes", scope=scope.value)["items"]
    assert len(items) == 3
    for item, level, state in zip(items, estimate.nodes, states, strict=True):
        assert node_json(level, state).items() <= item.items()
        assert get(client, f"{V1}/rigs/beam/nodes/{level.name}", scope=scope.value) == item
    assert {item["realisations"] for item in items} == {estimate.realisations}


def test_window_is_the_default_scope(client):
    assert get(client, f"{V1}/rigs/beam/nodes") == get(client, f"{V1}/rigs/beam/nodes", scope="window")


def test_rig_that_has_just_begun_has_nodes_without_levels(client):
    """Kills a 404 or a 500 between the start of a rig and its first realisation."""
    items = get(client, f"{V1}/rigs/bench/nodes")["items"]
    assert [item["name"] for item in items] == ["1", "2", "3"]
    assert {item["total_to_noise_db"] for item in items} == {None}
    assert get(client, f"{V1}/rigs/bench/elements")["located"] is False
    assert get(client, f"{V1}/rigs/bench/history") == {"items": [], "next": None}
    assert get(client, f"{V1}/rigs/bench/nodes/1/spectrum", 404)["type"].endswith(":no-estimate")


def test_spectrum(client):
    estimate = make_estimate(BEAM, 7, Scope.RUN, ratio=12.0)
    body = get(client, f"{V1}/rigs/beam/nodes/2/spectrum", scope="run")
    assert spectrum_json(estimate, "2").items() <= body.items()
    assert len(body["frequency_hz"]) == len(BEAM.rig.lines)


def test_elements(client):
    body = get(client, f"{V1}/rigs/beam/elements")
    assert body["located"] is True
    assert body["items"] == [{"between": ["3", "ground"], "share": 0.98, "confidence": 0.999, "separable": True}]


def test_history_filters(client):
    rows = list(walk(client, f"{V1}/rigs/beam/history", node="3", limit=3))
    assert [row["realisation"] for row in rows] == list(range(7, -1, -1))
    rows = list(walk(client, f"{V1}/rigs/beam/history", scope="run", order="oldest", limit=5))
    assert [(row["realisation"], row["name"]) for row in rows] == [(m, n) for m in range(8) for n in "123"]
    since, until = "2026-05-01T08:00:03Z", "2026-05-01T10:00:05+02:00"
    rows = get(client, f"{V1}/rigs/beam/history", node="1", since=since, until=until, order="oldest")["items"]
    assert [row["time"][17:19] for row in rows] == ["03", "04"]


def test_alarms_and_their_filters(client, store):
    run = make_run("fleet-1", "fleet")
    sink = opened(store, run)
    seconds = [4, 1, 3, 3, 0, 4]  # not in the order of arrival, and two pairs at one time
    changes = [
        make_alarm(run, node, number, START + second * SECOND)
        for number, (node, second) in enumerate(zip("121321", seconds, strict=True))
    ]
    for change in changes:
        sink.take(change)
    ended = make_alarm(run, "2", 1, START + SECOND, event="cleared")
    sink.take(ended)
    newest = [alarm_json(changes[i]) for i in (5, 0, 3, 2)] + [alarm_json(ended), alarm_json(changes[4])]
    assert list(walk(client, f"{V1}/alarms", rig="fleet", limit=1)) == newest
    assert get(client, f"{V1}/alarms", rig="fleet", state="returned_unacknowledged")["items"] == [newest[4]]
    both = get(client, f"{V1}/alarms", rig="fleet", state=["returned_unacknowledged", "unacknowledged"])
    assert both["items"] == newest
    assert get(client, f"{V1}/alarms", rig="fleet", node="1")["items"] == [newest[0], newest[1], newest[3]]
    assert get(client, f"{V1}/alarms", rig="fleet", since=newest[3]["since"])["items"] == newest[:4]
    assert get(client, f"{V1}/alarms/{ended.id.replace('/', '%2F')}") == {
        **alarm_json(ended),
        "changes": [alarm_json(changes[1]), alarm_json(ended)],
    }


def test_recordings(client):
    (item,) = get(client, f"{V1}/recordings")["items"]
    assert item["id"] == "beam-1-000"
    assert (item["start"], item["end"], item["size"]) == ("2026-05-01T08:00:00.000000Z", None, 4096)


@pytest.mark.parametrize("name", ["a/b", "with space", "ä%2F?#&", "..x", "+"])
def test_odd_names_can_be_asked_for(client, store, name):
    """Kills a name that cannot be reached, or that reaches another route."""
    rig = replace(make_rig(name=f"rig {name}"), nodes=(Node(name, "m", "N"), Node("spectrum", "m", "N")))
    run = make_run(f"odd-{name}", rig=rig)
    sink = opened(store, run)
    feed(sink, run, 1)
    quoted = "".join(f"%{byte:02X}" for byte in name.encode())
    path = f"{V1}/rigs/rig%20{quoted}/nodes/{quoted}"
    assert get(client, path)["name"] == name
    assert get(client, f"{path}/spectrum")["name"] == name
    assert get(client, f"{V1}/rigs/rig%20{quoted}/history", node=name)["items"][0]["name"] == name
    sink.close(RunEnd(START, RunStatus.COMPLETED, Counts()))


# --- paging ----------------------------------------------------------------------------------------------------


def test_pages_give_each_row_once_while_rows_are_written(client, store):
    """Kills offset paging: new rows at the top would push old ones onto the next page a second time."""
    run = make_run("walked-1", "walked")
    sink = opened(store, run)
    feed(sink, run, 10)
    alarms = itertools.count()
    for _ in range(10):
        sink.take(
            make_alarm(run, number=next(alarms), since=START)
        )  # all at one time: the order needs more than it
    path, seen, raised = f"{V1}/rigs/walked/history", [], []
    pages = zip(walk(client, path, limit=4), walk(client, f"{V1}/alarms", rig="walked", limit=1), strict=False)
    for m, (row, alarm) in enumerate(pages):
        seen.append(row)
        raised.append(alarm["id"])
        feed(sink, run, 1, first=10 + m)
        sink.take(make_alarm(run, number=next(alarms), since=START + m % 2 * SECOND))
    assert raised == [f"walked-1/3/{number}" for number in range(9, -1, -1)]
    rows = [(row["realisation"], row["name"]) for row in walk(client, path, limit=7)]
    assert len(rows) == len(set(rows)) == 3 * (10 + m + 1)
    assert [(row["realisation"], row["name"]) for row in seen] == rows[-30:][: len(seen)]
    sink.close(RunEnd(START, RunStatus.COMPLETED, Counts()))


@given(st.lists(st.integers(-(2**63) + 1, 2**63 - 1) | st.text(), max_size=3), st.lists(st.text(), max_size=3))
def test_cursor_comes_back_as_it_was_written(place, of):
    kinds = tuple(type(value) for value in place)
    cursor = write_cursor(tuple(place), of)
    assert re.fullmatch(r"[A-Za-z0-9_-]+", cursor)
    assert read_cursor(cursor, of, kinds) == tuple(place)
    with pytest.raises(ProblemError):
        read_cursor(cursor, [*of, "another filter"], kinds)


@settings(max_examples=300)
@given(st.text(max_size=60) | st.binary(max_size=40).map(lambda data: write_cursor((data.hex(),), ["rigs"])[3:]))
def test_anything_else_is_no_cursor(text):
    """Kills a cursor from outside that ends in a 500."""
    with pytest.raises(ProblemError):
        read_cursor(text, ["rigs"], (str,))
