"""Whatever goes wrong, the API answers with a problem of one shape, and the rest goes on."""

import json
import socket

import pytest

from api_client import V1, assert_problem, get, serving
from creak.api import bind, create_app
from creak.errors import AddressError
from creak.sinks.database import open_store
from store_records import fill_beam


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    opened_store = open_store(f"sqlite:///{tmp_path_factory.mktemp('api')}/creak.db")
    fill_beam(opened_store)
    yield opened_store
    opened_store.close()


@pytest.fixture(scope="module")
def client(store):
    """A server over a store with two rigs: the beam, measured, with an alarm; and a bench that has just begun."""
    with serving(create_app(store)) as client:
        yield client


BAD = [
    (404, "unknown-rig", "/rigs/nosuch"),
    (404, "unknown-rig", "/rigs/nosuch/nodes"),
    (404, "unknown-rig", "/rigs/nosuch/nodes/1/spectrum"),
    (404, "unknown-node", "/rigs/beam/nodes/nosuch"),
    (404, "unknown-node", "/rigs/beam/nodes/nosuch/spectrum"),
    (404, "unknown-node", "/rigs/beam/history?node=nosuch"),
    (404, "unknown-alarm", "/alarms/nosuch"),
    (404, "not-found", "/nosuch"),
    (404, "not-found", "/rigs/"),
    (422, "bad-parameter", "/rigs?cursor=nosuch"),
    (422, "bad-parameter", "/rigs?cursor=%00"),
    (422, "bad-parameter", "/rigs?limit=0"),
    (422, "bad-parameter", "/rigs?limit=1001"),
    (422, "bad-parameter", "/rigs?limit=many"),
    (422, "bad-parameter", "/rigs/beam/nodes?scope=year"),
    (422, "bad-parameter", "/rigs/beam/history?since=yesterday"),
    (422, "bad-parameter", "/rigs/beam/history?until=99999-01-01"),
    (422, "bad-parameter", "/rigs/beam/history?since=9999-01-01"),
    (422, "bad-parameter", "/rigs/beam/history?order=up"),
    (422, "bad-parameter", "/alarms?state=loud"),
    (422, "bad-parameter", "/alarms?node=a%00b"),
    (422, "bad-parameter", "/alarms?since="),
    (400, "bad-path", "/rigs/a%00b"),
    (400, "bad-path", "/rigs/a%1Fb"),
    (400, "bad-path", "/rigs/%FF"),
]


@pytest.mark.parametrize(("status", "kind", "path"), BAD)
def test_every_refusal_has_one_shape(client, status, kind, path):
    assert_problem(client.get(V1 + path), status, kind)


def test_refusals_name_what_is_wrong(client):
    assert "'nosuch'" in get(client, f"{V1}/rigs/nosuch", 404)["detail"]
    assert "its nodes are '1', '2', '3'" in get(client, f"{V1}/rigs/beam/nodes/x", 404)["detail"]
    (error,) = get(client, f"{V1}/rigs", 422, limit=0)["errors"]
    assert (error["in"], error["name"]) == ("query", "limit")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_wrong_method_has_the_same_shape(client, method):
    answer = client.request(method, f"{V1}/rigs")
    assert_problem(answer, 405, "method-not-allowed")
    assert answer.headers["allow"] == "GET"


@pytest.fixture
def broken(tmp_path):
    """A server whose store has lost its tables, as after a restore of the wrong file."""
    store = open_store(f"sqlite:///{tmp_path}/creak.db")
    with store.write() as connection:
        for table in ("spectra", "levels", "estimates", "rigs", "events", "counters", "alarms"):
            connection.exec_driver_sql(f"DROP TABLE {table}")
    with serving(create_app(store)) as client:
        yield client
    store.close()


@pytest.mark.parametrize(
    "path", [f"{V1}/rigs", f"{V1}/rigs/beam/nodes", f"{V1}/alarms", f"{V1}/events", "/readyz", "/metrics"]
)
def test_broken_store_is_a_problem_too_and_says_nothing_of_its_inside(broken, path):
    body = assert_problem(broken.get(path), 503, "store-unavailable")
    assert "SELECT" not in json.dumps(body)
    assert broken.get("/healthz").status_code == 200


def test_failure_of_ours_is_a_problem_too(store, caplog):
    app = create_app(store)

    @app.get("/api/v1/failing")
    def failing():
        raise RuntimeError("secret")

    with serving(app) as other:
        body = assert_problem(other.get("/api/v1/failing"), 500, "internal-error")
    assert "secret" not in json.dumps(body)
    assert "secret" in caplog.text


def test_address_in_use_is_one_clear_line(store):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(AddressError, match=f"127.0.0.1:{port}: .*in use"):
            bind(create_app(store), "127.0.0.1", port)
