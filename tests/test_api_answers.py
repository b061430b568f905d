"""Answers that are kept: the same bytes while nothing is written, never one of before what was written."""

from urllib.parse import quote

import pytest
import sqlalchemy as sa

from api_client import V1, get, serving
from creak.api import create_app
from creak.api.access import Access
from creak.errors import StorageError
from creak.sinks import keys, tables
from creak.sinks.database import open_store
from creak.sinks.keys import KeyScope
from store_records import BEAM, fill_beam, make_alarm, opened


@pytest.fixture
def store(url):
    made = open_store(url)
    fill_beam(made)
    yield made
    made.close()


@pytest.fixture
def reads(store, monkeypatch):
    """How often the store was read."""
    begun, read = [], store.read

    def counted():
        begun.append(1)
        return read()

    monkeypatch.setattr(store, "read", counted)
    return begun


PATHS = ["/rigs", "/rigs/beam", "/rigs/beam/nodes", "/rigs/beam/history?limit=3", "/alarms", "/alarms?rig=bench"]


def test_an_answer_is_that_of_the_store_whoever_wrote_and_is_computed_once(url, store, reads):
    """Kills an answer of before the last write, and one that is given for another question."""
    other = open_store(url)  # stands for a worker in another process
    kept = store.version() is not None
    with serving(create_app(store)) as client:
        for status in ("completed", "failed", "interrupted"):
            with other.write() as connection:
                connection.execute(sa.update(tables.runs).values(status=status))
            assert {item["status"] for item in get(client, f"{V1}/rigs")["items"]} == {status}
            first = {path: client.get(V1 + path) for path in PATHS}
            del reads[:]
            for path, before in first.items():
                after = client.get(V1 + path)
                assert (after.status_code, after.content) == (200, before.content)
                assert {**after.headers, "date": ""} == {**before.headers, "date": ""}
            assert len(reads) == (0 if kept else len(PATHS))
        assert len({answer.content for answer in first.values()}) == len(PATHS)
        sink = opened(other, BEAM)
        sink.take(make_alarm(BEAM, number=7))
        assert get(client, f"{V1}/alarms")["items"][0]["id"].endswith("/7")
    other.close()


def test_what_is_no_whole_answer_or_depends_on_more_than_the_store_is_not_kept(store, reads):
    with serving(create_app(store)) as client:
        for path, status in (("/rigs/nosuch", 404), ("/rigs?limit=0", 422), ("/nothing", 404)):
            assert client.get(V1 + path).status_code == status
            assert client.get(V1 + path).status_code == status
        (alarm,) = get(client, f"{V1}/alarms")["items"]
        path = f"{V1}/alarms/{quote(alarm['id'], safe='')}"
        tag = client.get(path).headers["etag"]
        for _ in range(2):
            again = client.get(path, headers={"If-None-Match": tag})
            assert (again.status_code, again.content) == (304, b"")
        assert client.get(path).headers["etag"] == tag


def test_keys_are_asked_for_before_an_answer_that_is_kept(store):
    with store.write() as connection:
        token = keys.add(connection, "wall", KeyScope.READ)
    with serving(create_app(store, access=Access(keys=True))) as client:
        path = f"{V1}/rigs"
        with_key = {"Authorization": f"Bearer {token}"}
        assert client.get(path, headers=with_key).status_code == 200
        assert client.get(path, headers=with_key).status_code == 200
        assert client.get(path).status_code == 401


def test_the_version_is_another_one_after_every_write_and_after_nothing_else(url, store):
    other = open_store(url)
    seen = [store.version()]
    if seen[0] is None:
        assert not url.startswith("sqlite")
        other.close()
        return
    for writer in (store, other) * 3:
        with writer.write(durable=writer is store) as connection:
            connection.execute(sa.update(tables.runs).values(message=str(len(seen))))
        with store.read() as connection:
            connection.execute(sa.select(tables.runs)).all()
        seen.append(store.version())
        assert store.version() == seen[-1]
    with pytest.raises(StorageError), other.write() as connection:  # noqa: PT012 - it does not come about
        connection.execute(sa.update(tables.runs).values(message="never"))
        connection.execute(sa.text("SELECT nothing FROM nowhere"))
    assert store.version() == seen[-1]
    assert len(set(seen)) == len(seen)
    other.close()
