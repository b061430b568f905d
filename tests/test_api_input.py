"""Every field of every request, wrong in every way: refused in one shape, and nothing has changed.

The list of requests is the OpenAPI document's own, so that none is forgotten.
"""

import json
import re

import pytest

from api_client import V1, get, serving
from creak.api import create_app
from creak.api.access import Access
from creak.sinks import receivers
from creak.sinks.database import open_store
from store_records import fill_beam

WRONG = {
    "null": "null",
    "a number": "3",
    "a negative number": "-1",
    "a fraction": "0.5",
    "beyond 64 bits": str(2**63),
    "beyond doubles": "1e999",
    "400 digits": "9" * 400,
    "not a number": "NaN",
    "a truth": "true",
    "empty": '""',
    "blank": '" "',
    "NUL": '"a\\u0000b"',
    "a control character": '"a\\u001bb"',
    "a lone surrogate": '"\\ud800"',
    "a surrogate turned round": '"\\udc00\\ud800"',
    "half a megabyte less than allowed": json.dumps("x" * 60_000),
    "a list": "[]",
    "a list of lists": "[[[]]]",
    "an object": "{}",
    "deep": "[" * 10_000 + "]" * 10_000,
    "markup": '"<script>alert(1)</script>"',
    "a path": '"../../etc/passwd"',
    "SQL": '"\'; DROP TABLE alarms; --"',
}
RAW = {
    "nothing": b"",
    "no JSON": b"{",
    "no UTF-8": b'{"by": "\xff"}',
    "twice": b'{"by": "a"}{"by": "b"}',
    "deep": b'{"by":' * 5_000 + b"1" + b"}" * 5_000,
    "a list": b"[]",
    "a string": b'"by"',
    "a number": b"1e999",
    "too long": b'{"by": "' + b"x" * 70_000 + b'"}',
}
TYPES = ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data", "application/xml", ""]
PARAMETERS = ["", "%00", "-1", "0", "1e9", "9" * 400, "%ED%A0%80", "%F0%9F%92%A9", "..%2F..", "x" * 5000, "%5B%5D"]
HEADERS = ["", '"', "3-18a2f", '"a" "b"', '"\x7f"', "W/", '"' + "x" * 300 + '"', "*, *", '"1-1",']


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """A service with something of everything, which nobody measures; at the end it is as it was."""
    store = open_store(f"sqlite:///{tmp_path_factory.mktemp('input')}/creak.db")
    fill_beam(store)
    with store.write() as connection:
        connection.exec_driver_sql("UPDATE runs SET status = 'completed'")
        connection.exec_driver_sql("UPDATE alarms SET id = 'known'")
        connection.exec_driver_sql("UPDATE journal SET alarm = 'known'")
        receivers.add(
            connection, "http://127.0.0.1:9/", (), (), "standard", "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
        )
    with serving(create_app(store, access=Access(per_second=1e9, allow=["127.0.0.0/8"]))) as made:
        before = state(made)
        yield made
        assert state(made) == before
    store.close()


def state(client):
    paths = ("alarms", "alarms/known", "rigs/beam/nodes", "webhooks", "diagnoses", "recordings")
    return [get(client, f"{V1}/{path}") for path in paths]


def document(client):
    return get(client, "/openapi.json")


def resolved(document, schema):
    while "$ref" in schema:
        schema = document["components"]["schemas"][schema["$ref"].rsplit("/", 1)[1]]
    return schema


def filled(client, path):
    """A path with names that there are."""
    (hook,) = get(client, f"{V1}/webhooks")["items"]
    known = {"rig": "beam", "node": "2", "alarm": "known", "recording": "beam-1-000", "webhook": hook["id"]}
    return re.sub(r"\{(\w+)\}", lambda match: known.get(match[1], "nosuch"), path)


def operations(document):
    for path, found in document["paths"].items():
        for method, operation in found.items():
            if path != f"{V1}/events":
                yield method.upper(), path, operation


def assert_refused(answer, operation, statuses, *what):
    """A problem of the one shape, of a status that the document tells of."""
    about = (*what, answer.request.method, str(answer.request.url)[:200], answer.status_code, answer.text[:300])
    assert answer.status_code in statuses, about
    assert str(answer.status_code) in operation["responses"], about
    assert answer.headers["content-type"] == "application/problem+json", about
    assert answer.json()["status"] == answer.status_code


def test_every_field_of_every_body(client):
    """One field at a time holds what it must not; a value that happens to be allowed is left out."""
    tried = 0
    text = document(client)
    for method, path, operation in operations(text):
        if "requestBody" not in operation:
            continue
        content = operation["requestBody"]["content"]["application/json"]
        schema = resolved(text, content["schema"])
        for field, about in schema["properties"].items():
            for name, value in WRONG.items():
                if allowed(resolved(text, about), name):
                    continue
                body = {key: json.dumps(item) for key, item in content["example"].items()} | {field: value}
                raw = "{" + ", ".join(f'"{key}": {item}' for key, item in body.items()) + "}"
                headers = {"Content-Type": "application/json"}
                answer = client.request(method, filled(client, path), content=raw, headers=headers)
                assert_refused(answer, operation, {400} if name == "deep" else {422}, field, name)
                tried += 1
    assert tried > 500


def allowed(about, name):
    """Whether a field may hold a value of this name, as far as its type says; text is judged by its route."""
    kinds = {option.get("type") for option in about.get("anyOf", [about])}
    if name in {"blank", "markup", "a path", "SQL", "half a megabyte less than allowed"} and "string" in kinds:
        return True  # free text; names of what there is are refused as unknown, see the fuzzing
    if name == "empty" and about.get("minLength") is None:
        return True
    if name == "a list" and "array" in kinds:
        return True
    if name == "a number" and "integer" in kinds:
        return True
    return name == "null" and "null" in kinds


def test_bodies_that_are_none(client):
    text = document(client)
    for method, path, operation in operations(text):
        if "requestBody" not in operation:
            continue
        for content in RAW.values():
            answer = client.request(
                method, filled(client, path), content=content, headers={"Content-Type": "application/json"}
            )
            if not content and not operation["requestBody"].get("required"):
                assert answer.status_code == 200, answer.text
                continue
            assert_refused(answer, operation, {413} if len(content) > 65_536 else {400, 422})
        for kind in TYPES:
            answer = client.request(method, filled(client, path), content=b"by=a", headers={"Content-Type": kind})
            assert_refused(answer, operation, {422})


def test_every_parameter_of_every_request(client):
    """Whatever stands in a path, a query or a header, the answer is one that the document tells of."""
    text = document(client)
    for method, path, operation in operations(text):
        if method != "GET":
            continue
        for parameter in operation.get("parameters", []):
            if parameter["in"] == "header":
                continue
            for value in PARAMETERS:
                name = parameter["name"]
                if parameter["in"] == "path":
                    url = filled(client, path.replace("{" + name + "}", value or "%20"))
                else:
                    url = f"{filled(client, path)}?{name}={value}"
                answer = client.get(url)
                about = (url[:200], answer.status_code, answer.text[:200])
                assert str(answer.status_code) in operation["responses"], about
                if answer.status_code >= 400:
                    assert_refused(answer, operation, {400, 404, 422})


@pytest.mark.parametrize("value", HEADERS)
def test_entity_tags_that_are_none(client, value):
    path = f"{V1}/alarms/known"
    sent = value.encode("latin-1")
    body = {"by": "ada", "until": "2026-05-01T09:00:00Z"}
    assert client.get(path, headers={"If-None-Match": sent}).status_code == 422
    assert client.post(f"{path}/shelve", json=body, headers={"If-Match": sent}).status_code == 422


@pytest.mark.parametrize("value", ["x", "-1", "1.5", str(2**63), "9" * 400, "1 2", "\u00b2".encode()])
def test_event_ids_that_are_none(client, value):
    answer = client.get(f"{V1}/events", headers={"Last-Event-ID": value})
    assert answer.status_code == 422, answer.text
