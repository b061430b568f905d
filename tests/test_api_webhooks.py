"""Receivers of webhooks over REST: added, tested, redelivered to, refused, removed."""

import time

import pytest
from standardwebhooks import Webhook

from api_client import V1, assert_problem, get, serving, walk
from api_desk import LOOPBACK, SEEN, Desk, left_alone, post, refusing
from creak.api import create_app
from creak.api.access import Access
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import Deliverer
from receiver import receiving


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
