"""What other programs rely on: metrics, health, the OpenAPI document, and the page that browsers load."""

import hashlib
import json
import posixpath
import re
import time
from pathlib import Path

import pytest
from fastapi.openapi.models import OpenAPI
from prometheus_client.parser import text_string_to_metric_families

from api_client import V1, assert_problem, get, serving
from creak.api import create_app
from creak.api.models import Answer
from creak.api.page import site
from creak.records import Counts, RunEnd, RunStatus
from creak.sinks import jobs
from creak.sinks.database import open_store
from store_places import PLACES, place
from store_records import (
    SECOND,
    START,
    fill_beam,
    make_frame,
    make_run,
    opened,
)


@pytest.fixture(scope="module", params=PLACES)
def store(request, tmp_path_factory):
    with place(request.param, tmp_path_factory.mktemp("api")) as url:
        opened_store = open_store(url)
        fill_beam(opened_store)
        jobs.put(
            opened_store,
            jobs.Task("diagnosis", ("beam.mcap",), "model.toml"),
            {"recording": "x"},
            now=0,
            waiting=1,
        )
        yield opened_store
        opened_store.close()


@pytest.fixture(scope="module")
def client(store):
    """A server over a store with two rigs: the beam, measured, with an alarm; and a bench that has just begun."""
    with serving(create_app(store, data=Path(__file__).parent)) as client:
        yield client


def test_metrics(client):
    text = client.get("/metrics").text
    values = {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }

    def value(name, **labels):
        return values[(name, *sorted(labels.items()))]

    assert value("creak_frames_total", rig="beam", status="accepted") == 48
    assert value("creak_frames_total", rig="beam", status="transient") == 24
    assert value("creak_realisations_total", rig="beam") == 8
    assert value("creak_faults_total", rig="beam", kind="lost") == 1
    assert value("creak_faults_total", rig="beam", kind="late") == 0
    assert value("creak_node_level_db", rig="beam", node="3", quantity="total_to_noise") == 12.0
    assert value("creak_node_alarm", rig="beam", node="3", creak_node_alarm="unacknowledged") == 1
    assert value("creak_node_alarm", rig="beam", node="1", creak_node_alarm="normal") == 1
    assert value("creak_last_recorded_timestamp_seconds", rig="beam") == START / 1e9 + 8
    assert value("creak_run_running", rig="beam") == 1
    assert value("creak_run_status", rig="beam", creak_run_status="running") == 1
    assert value("creak_run_status", rig="beam", creak_run_status="failed") == 0
    assert 0 <= time.time() - value("creak_last_beat_timestamp_seconds", rig="beam") < 300
    assert (
        value("creak_active_alarms", rig="beam", severity="alarm", acknowledged="false", **{"class": "process"})
        == 1
    )
    assert value("creak_jobs", kind="diagnosis", status="queued") == 1
    assert value("creak_recordings_bytes", rig="beam") > 0
    assert 0 < value("creak_data_free_bytes") < value("creak_data_size_bytes")
    assert value("process_resident_memory_bytes") > 1e6
    assert "creak_build_info{" in text
    openmetrics = client.get("/metrics", headers={"Accept": "application/openmetrics-text; version=1.0.0"})
    assert openmetrics.text.endswith("# EOF\n")


def test_readiness_tells_a_dead_worker_from_a_live_one(tmp_path):
    """Kills a service that is ready though nobody measures."""
    now = [time.time_ns()]
    url = f"sqlite:///{tmp_path}/creak.db"
    store = open_store(url)
    run = make_run()

    def complaint(client):
        return assert_problem(client.get("/readyz"), 503, "not-ready")["detail"]

    with serving(create_app(url, rigs_expected=["beam"])) as client:
        assert complaint(client) == "rig 'beam': no worker has opened a run yet"
        sink = opened(store, run, clock=lambda: now[0])
        assert complaint(client) == "rig 'beam': it has not sent a frame yet"
        sink.take(make_frame(run, 0))
        sink.tick(1.0)
        assert get(client, "/readyz") == {"status": "ready", "rigs": ["beam"]}
        now[0] -= 100 * SECOND
        sink.tick(10.0)
        assert re.fullmatch(r"rig 'beam': its worker has not written for 1\d\d s", complaint(client))
        sink.take(make_frame(run, 0))
        now[0] += 100 * SECOND
        sink.tick(20.0)
        assert re.fullmatch(r"rig 'beam': it has sent no frame for 1\d\d s", complaint(client))
        sink.close(RunEnd(START, RunStatus.FAILED, Counts(), "the rig is silent"))
        assert complaint(client) == "rig 'beam': its run ended as failed (the rig is silent)"
        sink.close(RunEnd(START, RunStatus.COMPLETED, Counts()))
        assert get(client, "/readyz")["status"] == "ready"
    store.close()


def operations(client):
    """The document, and its operations by method and path."""
    document = get(client, "/openapi.json")
    return document, {
        (method, path): operation for path, item in document["paths"].items() for method, operation in item.items()
    }


def test_openapi_document_is_valid_and_whole(client):
    """Kills a reference to nowhere, a route of the contract that is missing, and one without documented errors."""
    document, routes = operations(client)
    OpenAPI.model_validate(document)
    for reference in set(re.findall(r'"#/([^"]+)"', json.dumps(document))):
        found = document
        for key in reference.split("/"):
            found = found[key]
    rigs = ["", "/{rig}", "/{rig}/nodes", "/{rig}/nodes/{node}", "/{rig}/nodes/{node}/spectrum"]
    expected = {f"{V1}/rigs{path}" for path in [*rigs, "/{rig}/elements", "/{rig}/history"]}
    expected |= {f"{V1}/{path}" for path in ("alarms", "alarms/{alarm}", "recordings", "events")}
    expected |= {f"{V1}/{path}" for path in ("webhooks", "webhooks/{webhook}", "webhooks/{webhook}/deliveries")}
    expected |= {f"{V1}/{path}" for path in ("jobs", "jobs/{job}", "diagnoses", "diagnoses/{diagnosis}")}
    expected |= {f"{V1}/diagnoses/{{diagnosis}}/report"}
    expected |= {f"{V1}/audit", "/healthz", "/readyz", "/metrics"}
    assert expected <= {path for method, path in routes if method == "get"}
    actions = {f"alarms/{{alarm}}/{name}" for name in ("acknowledge", "shelve", "unshelve")}
    changes = actions | {"webhooks", "webhooks/{webhook}/test"}
    assert {f"{V1}/{path}" for path in changes} <= {path for method, path in routes if method == "post"}
    assert ("delete", f"{V1}/webhooks/{{webhook}}") in routes
    assert len({route["operationId"] for route in routes.values()}) == len(routes)
    for (method, path), route in routes.items():
        problems = {status: answer for status, answer in route["responses"].items() if status >= "400"}
        assert path == "/healthz" or {"500", "503"} <= set(problems)
        names_something = "{" in path or (method, path) == ("post", f"{V1}/diagnoses")  # there in its body
        assert ("404" in problems) == names_something
        has_input = bool(route.get("parameters")) or "requestBody" in route
        assert ("422" in problems) == has_input, path
        for answer in problems.values():
            assert list(answer["content"]) == ["application/problem+json"]


def test_examples_are_what_the_routes_answer(client):
    """Kills an example that has gone stale: its keys must be those of a real answer."""
    _, routes = operations(client)
    for (method, path), route in routes.items():
        (content,) = [
            answer["content"] for status, answer in route["responses"].items() if status in {"200", "201", "202"}
        ][:1] or [{}]
        for shown in content.values():
            assert shown["example"], path
        if method != "get" or "application/json" not in content or "webhook" in path or "audit" in path:
            continue
        job = get(client, f"{V1}/jobs")["items"][0]["id"]
        real = client.get(path.format(rig="beam", node="3", alarm="beam-1%2F3%2F0", job=job, diagnosis=job))
        body = real.json() if real.status_code == 200 else {"status": "ready", "rigs": []}
        assert shape(shown["example"]) == shape(body), path


def models(root):
    for model in root.__subclasses__():
        yield model
        yield from models(model)


@pytest.mark.parametrize("model", [m for m in models(Answer) if m.example is not None], ids=lambda m: m.__name__)
def test_examples_have_the_keys_of_their_models(model):
    assert model.model_validate(model.example)


def shape(value):
    """Keys of a body, with the first item of a list for all; free tables and lists that are empty here are not."""
    if isinstance(value, dict):
        free = {"faults", "alarms", "limits", "excitation", "request", "result", "quality", "detection"}
        return {key: None if key in free else shape(item) for key, item in value.items()}
    if isinstance(value, list):
        return [shape(value[0])] if value and isinstance(value[0], dict) else None
    return None


# --- the page --------------------------------------------------------------------------------------------------


def test_page_needs_nothing_from_elsewhere(client):
    """Kills a remote script, and an inline one that the policy would stop."""
    answer = client.get("/")
    assert answer.headers["content-type"].startswith("text/html")
    policy = dict(item.split(" ", 1) for item in answer.headers["content-security-policy"].split("; "))
    assert policy["default-src"] == "'none'"
    assert policy["script-src"] == policy["style-src"] == policy["connect-src"] == "'self'"
    assert not re.search(r"https?://|<script>|<style|\son\w+=|style=", answer.text)
    linked = re.findall(r'(?:src|href)="(static/[^"]+)"', answer.text)
    assert {path.rsplit(".", 1)[1] for path in linked} == {"css", "js", "svg"}
    for path in linked:
        part = client.get(f"/{path}")
        assert part.status_code == 200
        assert part.headers["x-content-type-options"] == "nosniff"


def test_parts_of_the_page_are_kept_by_browsers_until_there_are_others(client):
    """Kills a part that is asked for at each visit, and an old one that meets a new page."""
    page = client.get("/")
    assert page.headers["cache-control"] == "no-cache"
    again = client.get("/", headers={"If-None-Match": page.headers["etag"]})
    assert again.status_code == 304
    policy = "content-security-policy"
    assert again.headers[policy] == page.headers[policy]  # a browser takes the newest headers for the old body
    (script,) = re.findall(r'"(static/[^"]+/main.js)"', page.text)
    part = client.get(f"/{script}")
    assert "immutable" in part.headers["cache-control"]
    assert client.get(f"/{script}", headers={"If-None-Match": part.headers["etag"]}).status_code == 304
    version = script.split("/")[1]
    for path in (
        script.replace(version, "0" * 16),
        f"static/{version}/nosuch.js",
        f"static/{version}/..%2Fpage.py",
    ):
        assert_problem(client.get(f"/{path}"), 404, "not-found")


def test_every_module_that_is_imported_is_there():
    """Kills a page that fails half-way as one of its parts was left out of the package."""
    parts = site().parts
    for name, content in parts.items():
        for path in re.findall(r'from "(\.[^"]+)"', content.decode()) if name.startswith("js/") else []:
            assert posixpath.normpath(posixpath.join(posixpath.dirname(name), path)) in parts, (name, path)


def test_the_charts_are_those_of_uplot():
    """Kills a package that carries another script than the one that uPlot 1.6.31 was released with."""
    digests = {name: hashlib.sha256(site().parts[name]).hexdigest() for name in ("uplot.js", "uplot.css")}
    assert digests == {
        "uplot.js": "2d27e8ad3d228164525ce213f9dc716f39b4e3aee0cc773fb3491c96cf4921a2",
        "uplot.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    }


def test_every_answer_is_guarded(client):
    for path in (f"{V1}/rigs", "/metrics", "/openapi.json", "/nosuch"):
        headers = client.get(path).headers
        assert headers["content-security-policy"].startswith("default-src 'none'")
        assert headers["cache-control"] == "no-store"
        assert "server" not in headers
