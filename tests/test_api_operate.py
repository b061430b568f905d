"""What operators may do with alarms: acknowledge, shelve, and only what they have seen."""

import concurrent.futures
import json
import threading
from dataclasses import replace

import pytest

from api_client import V1, assert_problem, get, serving
from api_desk import LOOPBACK, SEEN, Desk, left_alone, post, refusing
from creak.api import create_app
from creak.api.access import Access


@pytest.fixture
def desk(store):
    return left_alone(Desk(store))


@pytest.fixture
def client(store, desk):
    with serving(create_app(store, access=Access(allow=LOOPBACK))) as client:
        yield client


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with refusing(tmp_path_factory.mktemp("shared")) as found:
        yield found


def test_acknowledge_without_a_worker_and_once_more(client, desk, store):
    path = f"/alarms/{desk.alarm.id}"
    alarm = post(client, f"{path}/acknowledge", body=SEEN)
    assert (alarm["state"], alarm["acknowledged"], alarm["active"]) == ("acknowledged", True, True)
    assert (alarm["by"], alarm["comment"], alarm["event"]) == ("operator", "seen", "acknowledged")
    assert post(client, f"{path}/acknowledge", body={"by": "another"}) == alarm
    changes = get(client, V1 + path)["changes"]
    assert [change["event"] for change in changes] == ["raised", "acknowledged"]
    assert desk.work() == 1  # a later worker learns of it
    assert desk.alarm.facts.acknowledged
    assert [change["event"] for change in get(client, V1 + path)["changes"]] == ["raised", "acknowledged"]


def test_a_living_worker_decides_and_the_answer_waits_for_it(store):
    """Kills an acknowledgement that the worker's next change overwrites."""
    desk = Desk(store)
    stop = threading.Event()

    def working():
        while not stop.wait(0.02):
            desk.work()

    thread = threading.Thread(target=working)
    thread.start()
    try:
        with serving(create_app(store)) as client:
            path = f"/alarms/{desk.alarm.id}"
            assert post(client, f"{path}/acknowledge", body=SEEN)["state"] == "acknowledged"
            desk.want(None)
            assert get(client, V1 + path)["state"] == "normal"
            again = post(client, f"{path}/acknowledge", body=SEEN)
            assert (again["state"], again["acknowledged"]) == ("normal", True)
    finally:
        stop.set()
        thread.join()


def test_worker_that_does_not_answer_is_a_202_and_does_it_later(store, monkeypatch):
    monkeypatch.setattr("creak.api.operate._WAIT_SECONDS", 0.2)
    desk = Desk(store)
    with serving(create_app(store)) as client:
        path = f"/alarms/{desk.alarm.id}"
        assert post(client, f"{path}/acknowledge", 202, SEEN)["state"] == "unacknowledged"
        assert desk.work() == 1
        assert get(client, V1 + path)["state"] == "acknowledged"


def test_shelve_and_unshelve(client, desk):
    path = f"/alarms/{desk.alarm.id}"
    until = "2026-05-01T12:00:00.000000Z"
    alarm = post(client, f"{path}/shelve", body={**SEEN, "until": until})
    assert (alarm["state"], alarm["shelved"], alarm["shelved_until"]) == ("shelved", True, until)
    assert post(client, f"{path}/unshelve", body=SEEN)["state"] == "unacknowledged"
    assert post(client, f"{path}/unshelve", body=SEEN)["state"] == "unacknowledged"
    for bare in (None, {}, {"comment": "back in sight"}):
        post(client, f"{path}/shelve", body={**SEEN, "until": until})
        alarm = post(client, f"{path}/unshelve", body=bare)
        assert (alarm["state"], alarm["by"]) == ("unacknowledged", "anonymous")
    for bad in ("2026-04-30", "2030-01-01"):  # in the past; for longer than is allowed
        answer = client.post(f"{V1}{path}/shelve", json={**SEEN, "until": bad})
        assert_problem(answer, 409, "alarm-not-allowed")


def test_stale_occurrence_is_a_conflict(store):
    desk = Desk(store)
    old = desk.alarm.id
    desk.want(None)
    desk.alarm = replace(desk.alarm, facts=replace(desk.alarm.facts, latched=False))  # over, seen by nobody
    desk.want("alarm")
    assert desk.alarm.id != old
    left_alone(desk)
    with serving(create_app(store)) as client:
        answer = client.post(f"{V1}/alarms/{old}/acknowledge", json=SEEN)
        assert "newer" in assert_problem(answer, 409, "alarm-stale")["detail"]
        assert_problem(client.post(f"{V1}/alarms/nosuch/acknowledge", json=SEEN), 404, "unknown-alarm")
        assert post(client, f"/alarms/{desk.alarm.id}/acknowledge", body=SEEN)["acknowledged"]


def test_etag_keeps_an_operator_from_acting_on_what_he_has_not_seen(client, desk):
    path = f"{V1}/alarms/{desk.alarm.id}"
    first = client.get(path)
    tag = first.headers["etag"]
    assert client.get(path, headers={"If-None-Match": tag}).status_code == 304
    assert client.get(path, headers={"If-None-Match": f'W/{tag}, "x"'}).status_code == 304
    shelved = client.post(
        f"{path}/shelve", json={**SEEN, "until": "2026-05-01T12:00:00Z"}, headers={"If-Match": tag}
    )
    assert shelved.status_code == 200
    assert shelved.headers["etag"] != tag
    assert client.get(path, headers={"If-None-Match": tag}).status_code == 200
    late = client.post(f"{path}/acknowledge", json=SEEN, headers={"If-Match": tag})
    assert shelved.headers["etag"] in assert_problem(late, 412, "alarm-changed")["detail"]
    assert_problem(client.post(f"{path}/acknowledge", json=SEEN, headers={"If-Match": "x"}), 422, "bad-parameter")
    fresh = {"If-Match": shelved.headers["etag"]}
    assert client.post(f"{path}/acknowledge", json=SEEN, headers=fresh).status_code == 200
    assert client.post(f"{path}/acknowledge", json=SEEN, headers={"If-Match": "*"}).status_code == 200


BAD_BODIES = [
    b"",
    b"{",
    b"\xff\xfe",
    b"[]",
    b"null",
    b"{}",
    b'{"by": ""}',
    b'{"by": 3}',
    b'{"by": null}',
    b'{"by": "a\\u0000"}',
    b'{"by": "\\ud800"}',
    b'{"by": "a", "comment": 1}',
    b'{"by": "a", "comment": "\\u0000"}',
    b'{"by": "a", "more": 1}',
    json.dumps({"by": "a" * 201}).encode(),
    json.dumps({"by": "a", "comment": "c" * 2001}).encode(),
]
BAD_ENDS = [None, 3, "", "soon", "99999-01-01", "2026-05-01T25:00", [], "2026-05-01T12:00:00.0000000001Z"]


@pytest.mark.parametrize("body", BAD_BODIES, ids=lambda body: body[:30].decode("latin-1") or "empty")
def test_every_wrong_field_is_a_422(shared, body):
    client, alarm = shared
    headers = {"Content-Type": "application/json"}
    answer = client.post(f"{alarm}/acknowledge", content=body, headers=headers)
    assert_problem(answer, 422, "bad-parameter")


@pytest.mark.parametrize("until", BAD_ENDS, ids=str)
def test_every_wrong_end_is_a_422(shared, until):
    client, alarm = shared
    answer = client.post(f"{alarm}/shelve", json={**SEEN, "until": until})
    assert_problem(answer, 422, "bad-parameter")


def test_many_operators_at_once_leave_one_entry(client, desk):
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        path = f"{V1}/alarms/{desk.alarm.id}/acknowledge"
        answers = list(pool.map(lambda i: client.post(path, json={"by": f"op {i}"}).json(), range(16)))
    assert len({answer["by"] for answer in answers}) == 1
    assert [c["event"] for c in get(client, f"{V1}/alarms/{desk.alarm.id}")["changes"]] == [
        "raised",
        "acknowledged",
    ]
