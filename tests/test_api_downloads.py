"""Recordings over REST: whole, in parts, and while they grow."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from api_client import V1, assert_problem, serving
from creak.api import create_app
from creak.api.access import Access
from creak.api.downloads import byte_range
from creak.api.problems import ProblemError
from creak.sinks import keys
from creak.sinks.database import open_store
from creak.sinks.keys import KeyScope
from creak.sinks.store import RecordingEntry, put_recording
from store_records import START

CONTENT = bytes(range(256)) * 3000  # several chunks


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    place = tmp_path_factory.mktemp("recordings")
    (place / 'bär "1".mcap').write_bytes(CONTENT)
    return place


@pytest.fixture(scope="module")
def store(place):
    store = open_store(f"sqlite:///{place}/creak.db")
    for identifier, name in (("a/b-000", 'bär "1".mcap'), ("gone", "gone.mcap")):
        put_recording(
            store, RecordingEntry(identifier, "beam", "beam-1", str(place / name), START, None, "writing", 1)
        )
    yield store
    store.close()


@pytest.fixture(scope="module")
def client(store):
    with serving(create_app(store)) as client:
        yield client


URL = f"{V1}/recordings/a%2Fb-000/file"


def test_a_recording_is_downloaded_whole_under_its_name(client):
    answer = client.get(URL)
    assert answer.status_code == 200
    assert answer.content == CONTENT
    assert answer.headers["content-disposition"] == "attachment; filename*=UTF-8''b%C3%A4r%20%221%22.mcap"
    assert answer.headers["content-type"] == "application/octet-stream"
    assert answer.headers["x-content-type-options"] == "nosniff"


def test_a_download_is_resumed_unless_the_file_has_changed(client):
    whole = client.get(URL)
    size, tag = len(CONTENT), whole.headers["etag"]
    rest = client.get(URL, headers={"Range": "bytes=700000-", "If-Range": tag})
    assert (rest.status_code, rest.headers["content-range"]) == (206, f"bytes 700000-{size - 1}/{size}")
    assert rest.content == CONTENT[700000:]
    changed = client.get(URL, headers={"Range": "bytes=700000-", "If-Range": '"another"'})
    assert (changed.status_code, changed.content) == (200, CONTENT)
    outside = client.get(URL, headers={"Range": f"bytes={size}-"})
    assert_problem(outside, 416, "no-such-range")
    assert outside.headers["content-range"] == f"bytes */{size}"


def test_a_recording_that_grows_is_sent_as_it_was_when_asked_for(place, client):
    """Kills an answer that is longer than its Content-Length says."""
    with client.stream("GET", URL) as answer:
        with (place / 'bär "1".mcap').open("ab") as file:
            file.write(b"more")
        assert answer.read() == CONTENT
    (place / 'bär "1".mcap').write_bytes(CONTENT)


def test_what_is_not_there_is_a_problem(client):
    assert_problem(client.get(f"{V1}/recordings/nosuch/file"), 404, "unknown-recording")
    assert_problem(client.get(f"{V1}/recordings/gone/file"), 410, "recording-gone")


def test_a_download_needs_a_key_that_reads(store):
    with store.write() as connection:
        token = keys.add(connection, "reader", KeyScope.READ)
    with serving(create_app(store, access=Access(keys=True))) as client:
        assert_problem(client.get(URL), 401, "unauthorized")
        assert client.get(URL, headers={"Authorization": f"Bearer {token}"}).content == CONTENT


@given(st.integers(0, 50), st.integers(0, 60), st.integers(0, 60))
def test_ranges_are_those_of_python(size, first, last):
    data = bytes(range(size))
    for header, part in (
        (f"bytes={first}-{first + last}", data[first : first + last + 1]),
        (f"bytes={first}-", data[first:]),
        (f" Bytes=-{last} ", data[max(0, size - last) :] if last else b""),
    ):
        if part:
            assert data[slice(*byte_range(header, size))] == part
        else:
            with pytest.raises(ProblemError):
                byte_range(header, size)
    for ignored in (None, "", "lines=1-2", "bytes=1-2,4-5", "bytes=-", "bytes=2-1", "bytes=a-", "bytes 1-2"):
        assert byte_range(ignored, size) is None
