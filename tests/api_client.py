"""A real server on a loopback port, its client, and the one shape that all its errors have."""

import contextlib
import threading
import time

import httpx

from creak.api import bind

V1 = "/api/v1"


@contextlib.contextmanager
def serving(app, port=0):
    server = bind(app, "127.0.0.1", port)
    thread = threading.Thread(target=server.listen, name="server")
    thread.start()
    try:
        while not server.started:
            time.sleep(0.005)
        host, port = server.address
        with httpx.Client(base_url=f"http://{host}:{port}", timeout=10, trust_env=False) as client:
            client.server = server
            yield client
    finally:
        server.stop()
        thread.join(10)
        assert not thread.is_alive()


def get(client, path, status=200, **params):
    answer = client.get(path, params=params)
    assert answer.status_code == status, answer.text
    return answer.json()


def walk(client, path, **params):
    """All items of a list, page by page."""
    cursors = set()
    while True:
        page = get(client, path, **params)
        yield from page["items"]
        assert page["next"] not in cursors, "the pages go in a circle"
        cursors.add(page["next"])
        if page["next"] is None:
            return
        params["cursor"] = page["next"]


def assert_problem(answer, status, kind):
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert list(body)[:5] == ["type", "title", "status", "detail", "instance"]
    assert body["type"] == f"urn:problem-type:creak:{kind}"
    assert body["status"] == status
    assert body["title"]
    assert body["detail"]
    assert body["instance"] == answer.request.url.raw_path.decode().partition("?")[0]
    assert answer.headers["x-content-type-options"] == "nosniff"
    return body
