"""What operators and their programs may do: act on alarms, add receivers, and only with the right key."""

import concurrent.futures
import json
import threading
import time
from dataclasses import replace

import pytest
from standardwebhooks import Webhook

from api_client import V1, assert_problem, get, serving, walk
from creak.alarm_records import AlarmRules, Conflict
from creak.alarms import act
from creak.alarms.life import Alarm, demand
from creak.api import create_app
from creak.api.access import Access, Rates
from creak.records import Counts, RunEnd, RunStatus
from creak.sinks import actions, keys
from creak.sinks.database import open_store
from creak.sinks.keys import KeyScope
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import Deliverer
from receiver import receiving
from store_records import SECOND, START, make_run, opened

RUN = make_run("beam-1")
LOOPBACK = ["127.0.0.0/8"]
SEEN = {"by": "operator", "comment": "seen"}


@pytest.fixture
def store(tmp_path):
    made = open_store(f"sqlite:///{tmp_path}/creak.db")
    yield made
    made.close()


class Desk:
    """A worker's part: one alarm, carried through its life by the rules, and the store that hears of it."""

    def __init__(self, store, number=0):
        self.store, self.sink, self.time = store, opened(store, RUN), START + number * SECOND
        self.alarm = Alarm("beam", "3")
        self.want("alarm")

    def want(self, severity):
        self.time += SECOND
        self.alarm, changes = demand(self.alarm, severity, self.time, AlarmRules(), RUN.id, "level", 11.0)
        for change in changes:
            self.sink.take(change)

    def work(self):
        """What a worker does at each turn."""
        with self.store.read() as connection:
            waiting = actions.waiting(connection, "beam", 0)
        for asked in waiting:
            done = act(self.alarm, asked.action, self.time, AlarmRules(), RUN.id)
            conflict = done if isinstance(done, Conflict) else None
            if conflict is None:
                self.alarm = done[0]
                for change in () if asked.told else done[1]:
                    self.sink.take(change)
            with self.store.write() as connection:
                actions.answer(connection, asked, conflict)
        return len(waiting)


@pytest.fixture
def desk(store):
    """An alarm whose worker has ended."""
    made = Desk(store)
    made.sink.close(RunEnd(made.time, RunStatus.COMPLETED, Counts()))
    return made


@pytest.fixture
def client(store, desk):
    with serving(create_app(store, access=Access(allow=LOOPBACK))) as client:
        yield client


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    """A client and an alarm for what is refused and changes nothing."""
    made = open_store(f"sqlite:///{tmp_path_factory.mktemp('shared')}/creak.db")
    desk = Desk(made)
    desk.sink.close(RunEnd(desk.time, RunStatus.COMPLETED, Counts()))
    with serving(create_app(made, access=Access(allow=LOOPBACK))) as client:
        yield client, f"{V1}/alarms/{desk.alarm.id}"
        assert get(client, f"{V1}/webhooks")["items"] == []
    made.close()


def post(client, path, status=200, body=None, **headers):
    answer = client.post(V1 + path, json=body, headers=headers)
    assert answer.status_code == status, answer.text
    return answer.json()


# --- alarms ------------------------------------------------------------------------------------------------------


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
    desk.sink.close(RunEnd(desk.time, RunStatus.COMPLETED, Counts()))
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


# --- webhooks ----------------------------------------------------------------------------------------------------


def test_webhook_from_adding_to_removing(client, store, desk):
    deliverer = Deliverer(store, AddressPolicy(LOOPBACK))
    deliverer.start()
    try:
        with receiving() as server:
            made = client.post(
                f"{V1}/webhooks", json={"url": server.url, "events": ["alarm.acknowledged"], "rigs": []}
            )
            assert made.status_code == 201
            hook, secret = made.json(), made.json()["secret"]
            assert made.headers["location"] == f"{V1}/webhooks/{hook['id']}"
            assert secret.startswith("whsec_")
            assert "secret" not in get(client, made.headers["location"])
            assert "secret" not in get(client, f"{V1}/webhooks")["items"][0]
            test = post(client, f"/webhooks/{hook['id']}/test", 202)
            (got,) = server.wait(1)
            Webhook(secret).verify(got.body, got.headers)
            assert (got.id, got.json["type"]) == (test["message"], "webhook.test")
            post(client, f"/alarms/{desk.alarm.id}/acknowledge", body=SEEN)
            assert server.wait(2)[1].json["data"]["by"] == "operator"
            rotated = post(client, f"/webhooks/{hook['id']}/secret")["secret"]
            post(client, f"/webhooks/{hook['id']}/deliveries/{test['message']}/redeliver", 202)
            again = server.wait(3)[2]
            assert (again.id, again.body) == (got.id, got.body)
            for key in (secret, rotated):
                Webhook(key).verify(again.body, again.headers)
            end = time.monotonic() + 5
            while len(found := list(walk(client, f"{V1}/webhooks/{hook['id']}/deliveries", limit=2))) < 3:
                assert time.monotonic() < end
            assert [entry["status_code"] for entry in found] == [204, 204, 204]
            assert client.delete(made.headers["location"]).status_code == 204
            assert_problem(client.delete(made.headers["location"]), 404, "unknown-webhook")
            assert get(client, f"{V1}/webhooks")["items"] == []
    finally:
        deliverer.stop()


@pytest.mark.parametrize(
    "url",
    [
        "http://10.0.0.1/",
        "http://[::1]/",
        "http://169.254.169.254/",
        "http://0x7f.1/",
        "ftp://a/",
        "http://nosuch.invalid/",
    ],
)
def test_refused_address_is_a_422(shared, url):
    client, _ = shared
    body = assert_problem(client.post(f"{V1}/webhooks", json={"url": url}), 422, "bad-parameter")
    assert (body["errors"][0]["in"], body["errors"][0]["name"]) == ("body", "url")


def test_loopback_is_refused_unless_it_is_allowed(store):
    with serving(create_app(store)) as client:
        problem = assert_problem(
            client.post(f"{V1}/webhooks", json={"url": "http://127.0.0.1:9/"}), 422, "bad-parameter"
        )
        assert "[webhooks] allow" in problem["detail"]


@pytest.mark.parametrize(
    "body",
    [
        {"url": 3},
        {"url": None},
        {},
        {"url": "http://127.0.0.1/", "events": "alarm.raised"},
        {"url": "http://127.0.0.1/", "events": ["raised"]},
        {"url": "http://127.0.0.1/", "events": [1]},
        {"url": "http://127.0.0.1/", "rigs": [""]},
        {"url": "http://127.0.0.1/", "rigs": ["a\x00"]},
        {"url": "http://127.0.0.1/", "format": "xml"},
        {"url": "http://127.0.0.1/", "secret": "mine"},
        {"url": "http://127.0.0.1/", "events": ["alarm.raised"] * 51},
    ],
)
def test_wrong_webhook_is_a_422(shared, body):
    client, _ = shared
    assert_problem(client.post(f"{V1}/webhooks", json=body), 422, "bad-parameter")


# --- keys, rates, sizes, audit -----------------------------------------------------------------------------------


@pytest.fixture
def tokens(store):
    with store.write() as connection:
        return {scope: keys.add(connection, scope.value, scope) for scope in KeyScope}


@pytest.fixture
def guarded(store, desk, tokens):
    with serving(create_app(store, access=Access(keys=True, allow=LOOPBACK))) as client:
        yield client


def with_key(token):
    return {"Authorization": f"Bearer {token}"}


def test_scopes_open_what_they_should_and_no_more(guarded, desk, tokens):
    acknowledge = f"/alarms/{desk.alarm.id}/acknowledge"
    needed = {
        ("GET", f"{V1}/rigs"): KeyScope.READ,
        ("GET", "/metrics"): KeyScope.READ,
        ("POST", V1 + acknowledge): KeyScope.OPERATE,
        ("GET", f"{V1}/webhooks"): KeyScope.ADMIN,
        ("POST", f"{V1}/webhooks"): KeyScope.ADMIN,
        ("DELETE", f"{V1}/webhooks/x"): KeyScope.ADMIN,
        ("GET", f"{V1}/audit"): KeyScope.ADMIN,
        ("GET", f"{V1}/%61udit"): KeyScope.ADMIN,
    }
    for (method, path), scope in needed.items():
        assert_problem(guarded.request(method, path, json={}), 401, "unauthorized")
        for mine, token in tokens.items():
            answer = guarded.request(method, path, json=SEEN, headers=with_key(token))
            if mine.covers(scope):
                assert answer.status_code not in {401, 403}, (method, path, mine)
            else:
                assert_problem(answer, 403, "scope-too-small")
    for path in ("/", "/healthz", "/readyz", "/openapi.json"):
        assert guarded.get(path).status_code == 200, path


def test_what_is_no_key_opens_nothing(guarded, tokens, store):
    real = tokens[KeyScope.ADMIN]
    prefix, identifier, secret = real.split("_", 2)
    wrong = [
        "x",
        "creak__",
        f"{prefix}_{identifier}_",
        f"{prefix}_{identifier}_{secret[:-1]}",
        f"{real} ",
        real.upper(),
    ]
    assert guarded.get(f"{V1}/rigs", headers={"X-API-Key": real}).status_code == 200
    for token in [*wrong[:4], wrong[5], f"other_{identifier}_{secret}"]:
        answer = guarded.get(f"{V1}/rigs", headers={"X-API-Key": token})
        assert assert_problem(answer, 401, "unauthorized")
        assert answer.headers["www-authenticate"] == "Bearer"
    with store.read() as connection:
        assert secret not in str(connection.exec_driver_sql("SELECT * FROM api_keys").fetchall())


def test_guessing_keys_is_slowed_down(guarded):
    codes = [guarded.get(f"{V1}/rigs", headers=with_key(f"creak_{i}_x")).status_code for i in range(30)]
    assert codes[0] == 401
    assert codes[-1] == 429


def test_removed_key_opens_nothing(store, tokens, monkeypatch):
    monkeypatch.setattr("creak.api.access._KEY_SECONDS", 0.0)
    with serving(create_app(store, access=Access(keys=True))) as client:
        headers = with_key(tokens[KeyScope.READ])
        assert client.get(f"{V1}/rigs", headers=headers).status_code == 200
        with store.write() as connection:
            assert keys.remove(connection, "read")
        assert_problem(client.get(f"{V1}/rigs", headers=headers), 401, "unauthorized")


def test_rate_limit(store):
    with serving(create_app(store, access=Access(per_second=5))) as client:
        answers = [client.get(f"{V1}/rigs") for _ in range(14)]
        assert answers[0].status_code == 200
        refused = next(answer for answer in answers if answer.status_code != 200)
        assert_problem(refused, 429, "too-many-requests")
        assert int(refused.headers["retry-after"]) >= 1
        assert client.get("/healthz").status_code == 200  # a supervisor is not kept out


def test_rates_forget_clients():
    rates = Rates(1.0, 2.0)
    for i in range(20_000):
        assert rates.take(str(i), 0.0) == 0
    assert len(rates._buckets) == 10_000
    assert [rates.take("a", 0.0), rates.take("a", 0.0)] == [0, 0]
    assert rates.take("a", 0.0) == pytest.approx(1.0)
    assert rates.take("a", 1.1) == 0


def test_long_bodies_are_refused_before_they_are_read(client):
    path = f"{V1}/webhooks"
    headers = {"Content-Type": "application/json"}
    assert_problem(client.post(path, content=b" " * 70_000, headers=headers), 413, "body-too-long")
    chunks = (b" " * 1000 for _ in range(100))
    assert_problem(client.post(path, content=chunks, headers=headers), 413, "body-too-long")


def test_a_page_of_another_site_cannot_use_the_loopback_api(client, desk):
    """Kills cross-site requests and names that were bound to loopback."""
    path = f"{V1}/alarms/{desk.alarm.id}/acknowledge"
    answer = client.post(path, json=SEEN, headers={"Sec-Fetch-Site": "cross-site"})
    assert_problem(answer, 403, "cross-site")
    assert_problem(client.get(f"{V1}/rigs", headers={"Host": "evil.example"}), 421, "misdirected-request")
    for host in ("localhost", "localhost:8300", "127.0.0.1:1", "[::1]:8300", "[::1]"):
        assert client.get(f"{V1}/rigs", headers={"Host": host}).status_code == 200, host


def test_audit_log_has_who_changed_what_and_who_was_turned_away(guarded, desk, tokens):
    path = f"{V1}/alarms/{desk.alarm.id}/acknowledge"
    guarded.post(path, json=SEEN)
    guarded.post(path, json=SEEN, headers=with_key(tokens[KeyScope.READ]))
    guarded.post(path, json=SEEN, headers=with_key(tokens[KeyScope.OPERATE]))
    guarded.get(f"{V1}/rigs", headers=with_key(tokens[KeyScope.READ]))
    admin = with_key(tokens[KeyScope.ADMIN])
    items = guarded.get(f"{V1}/audit", headers=admin).json()["items"]
    assert [(e["who"], e["status"], e["method"], e["path"]) for e in items] == [
        ("operate", 200, "POST", path),
        ("read", 403, "POST", path),
        ("", 401, "POST", path),
    ]
    assert {e["address"] for e in items} == {"127.0.0.1"}


def test_connection_stays_in_step_after_a_body_that_was_not_read(client):
    """Kills an answer sent before the request was read, whose rest is taken for the next request."""
    for _ in range(5):
        client.post(f"{V1}/webhooks", content=b" " * 70_000)
        assert client.get(f"{V1}/rigs").status_code == 200
