"""Who may use the API, how often and with how much, and what is written down of it."""

import pytest

from api_client import V1, assert_problem, serving
from api_desk import LOOPBACK, SEEN, Desk, left_alone
from creak.api import create_app
from creak.api.access import Access, Rates
from creak.sinks import keys
from creak.sinks.keys import KeyScope


@pytest.fixture
def desk(store):
    return left_alone(Desk(store))


@pytest.fixture
def client(store, desk):
    with serving(create_app(store, access=Access(allow=LOOPBACK))) as client:
        yield client


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


def test_many_keys_of_one_address_are_no_guesses(store):
    """Kills counting every key that is looked up: the screens behind one proxy would be locked out."""
    with store.write() as connection:
        tokens = [keys.add(connection, f"screen {i}", KeyScope.READ) for i in range(30)]
    with serving(create_app(store, access=Access(keys=True))) as client:
        codes = {client.get(f"{V1}/rigs", headers=with_key(token)).status_code for token in tokens}
    assert codes == {200}


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
