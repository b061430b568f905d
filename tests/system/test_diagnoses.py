"""Diagnoses and replays over REST, of a service that monitors a rig whose model lacks a spring."""

import contextlib
import io
import json
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import expect

import gap_rig
from api_client import assert_problem
from browser import chromium, visiting
from creak.cli import run

CREAK = [sys.executable, "-m", "creak.cli"]
DEADLINE = 240.0  # seconds after which something hangs; not a figure
SERVICE = """
[server]
port = 0
[[rigs]]
rig = "rig.toml"
model = "model.toml"
window = 2
[rigs.source]
kind = "recording"
files = ["measured.mcap"]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A rig, its model, and what was measured of it: five realisations with a spring that the model lacks."""
    place = tmp_path_factory.mktemp("service")
    gap_rig.write(place)
    (place / "creak.toml").write_text(SERVICE)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert run(gap_rig.simulate("measured.mcap")) == 0
    return place


@pytest.fixture(scope="module")
def served(place):
    """A service; gives its API once the whole recording has passed and the alarm stands."""
    with (place / "log").open("w") as log:
        process = subprocess.Popen(
            [*CREAK, "serve", "creak.toml"], cwd=place, stderr=log, stdout=subprocess.DEVNULL
        )
        try:
            address = wait(lambda: listening(place / "log"), "an address")
            with httpx.Client(base_url=f"{address}/api/v1", timeout=30) as client:
                wait(lambda: client.get("/rigs/small").json().get("status") == "completed", "the recording")
                yield client
        finally:
            process.terminate()
            process.wait(30)


def listening(log: Path):
    words = log.read_text().split("listening on ")
    return words[1].split()[0] if len(words) > 1 else None


def wait(until, what):
    end = time.monotonic() + DEADLINE
    while time.monotonic() < end:
        found = until()
        if found:
            return found
        time.sleep(0.1)
    return pytest.fail(f"timed out: {what}")


def ask(client, path, **body):
    """A job that was accepted, and where to ask for it."""
    answer = client.post(path, json=body) if body else client.post(path)
    assert answer.status_code == 202, answer.text
    assert answer.json()["status"] in {"queued", "running"}
    assert answer.headers["location"].startswith("/api/v1/")
    return answer.headers["location"].removeprefix("/api/v1")


def done(client, location):
    def ended():
        job = client.get(location).raise_for_status().json()
        assert job["progress"] is None or 0 <= job["progress"] <= 1
        return job if job["status"] not in {"queued", "running"} else None

    job = wait(ended, location)
    assert job["status"] == "done", job["reason"]
    assert job["progress"] == 1.0
    return job


def command(*words):
    """What a command prints with ``--json``."""
    with contextlib.redirect_stdout(io.StringIO()) as out:
        assert run(list(words)) == 0
    return json.loads(out.getvalue())


def assert_same(one, other):
    """The same but for rounding, which may differ from process to process."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, list):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    else:
        assert one == (pytest.approx(other, rel=1e-6, abs=1e-9) if isinstance(one, float) else other)


def test_an_alarm_leads_to_its_cause_by_one_call(served, place, monkeypatch):
    """Kills a diagnosis over REST that says anything else than the command on the same recording."""
    monkeypatch.chdir(place)
    (alarm,) = served.get("/alarms").json()["items"]
    (recording,) = served.get("/recordings").json()["items"]
    location = ask(served, "/diagnoses", alarm=alarm["id"])
    assert location.startswith("/diagnoses/")
    job = done(served, location)
    asked = job["request"]
    assert (asked["alarm"], asked["rig"], asked["model"]) == (alarm["id"], "small", "model.toml")
    document = job["result"]
    (cause,) = document["causes"]
    assert (document["verdict"], cause["effect"], sorted(cause["at"])) == (
        "explained",
        "cubic_stiffness",
        ["2", "ground"],
    )
    limits = [f"--{end}-realisation={asked[f'{end}_realisation']}" for end in ("first", "last")]
    words = ("diagnose", "--json", recording["path"], "--model", "model.toml", *limits)
    assert_same(command(*words), document)
    report = served.get(f"{location}/report")
    assert report.headers["content-type"].startswith("text/html")
    assert "Verdict: explained" in report.text
    policy = report.headers["content-security-policy"]
    assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:" in policy
    assert job["report"] == f"/api/v1{location}/report"
    listed = served.get("/diagnoses").json()["items"]
    assert [(item["id"], "result" in item) for item in listed] == [(job["id"], False)]


def test_the_page_shows_verdict_cause_and_report(served):
    """What an operator sees of a diagnosis, from its beginning to its report."""
    (alarm,) = served.get("/alarms").json()["items"]
    address = str(served.base_url).removesuffix("/api/v1/")
    with chromium() as browser, visiting(browser, address) as visit:
        page = visit.go(f"#/alarms/{alarm['id']}")
        link = page.get_by_role("term").filter(has_text="diagnosis").locator("xpath=following-sibling::dd/a")
        begun = served.get("/diagnoses").json()["items"]  # by the test before this one, if it ran
        (link if begun else page.get_by_role("button", name="Diagnose")).click()
        expect(page.locator(".verdict")).to_contain_text("explained", timeout=1000 * DEADLINE)
        expect(page.get_by_role("row").filter(has_text="cubic stiffness")).to_contain_text("2 – ground")
        with page.expect_popup() as opened:
            page.get_by_role("link", name="The report").click()
        expect(opened.value.get_by_text("Verdict: explained").first).to_be_visible()
        page.get_by_role("link", name="Diagnoses").first.click()
        expect(page.locator("tbody tr").first).to_contain_text("cubic stiffness, 2 – ground")


def test_a_replay_is_a_job_with_the_numbers_of_the_command(served, place, monkeypatch):
    monkeypatch.chdir(place)
    (recording,) = served.get("/recordings").json()["items"]
    location = ask(served, f"/recordings/{recording['id']}/replay")
    assert location.startswith("/jobs/")
    assert done(served, location)["result"] == command("replay", "--json", recording["path"])
    assert_problem(served.get(f"{location.replace('/jobs/', '/diagnoses/')}"), 404, "unknown-diagnosis")


def test_the_page_replays_a_recording(served):
    (recording,) = served.get("/recordings").json()["items"]
    with chromium() as browser, visiting(browser, str(served.base_url).removesuffix("/api/v1/")) as visit:
        page = visit.go("#/recordings")
        page.get_by_role("button", name=f"Replay {recording['id']}").click()
        expect(page.get_by_role("heading", name="Replay: small")).to_be_visible()
        nodes = page.get_by_role("region", name="Levels of the nodes")
        expect(nodes.locator("tbody tr")).to_have_count(2, timeout=1000 * DEADLINE)
        level = served.get("/rigs/small/nodes/2", params={"scope": "run"}).json()["total_to_noise_db"]
        expect(nodes.locator("tbody tr").nth(1)).to_contain_text(f"{level:.1f} dB")


def test_the_service_answers_while_a_diagnosis_runs_and_can_end_it(served):
    """Kills a computation in the event loop: other requests would wait for it."""
    (recording,) = served.get("/recordings").json()["items"]
    location = ask(served, "/diagnoses", recording=recording["id"])
    wait(lambda: served.get(location).json()["status"] == "running", "the job runs")
    slowest = 0.0
    for _ in range(10):
        began = time.monotonic()
        served.get("/rigs/small/nodes").raise_for_status()
        slowest = max(slowest, time.monotonic() - began)
    assert slowest < 2.0  # a diagnosis takes several times as long, on a machine that is busy with others too
    assert_problem(served.get(f"{location}/report"), 404, "no-report")
    served.post(f"{location.replace('/diagnoses/', '/jobs/')}/cancel").raise_for_status()
    wait(lambda: served.get(location).json()["status"] == "cancelled", "the job ends")


def test_what_cannot_be_diagnosed_is_a_problem(served):
    (recording,) = served.get("/recordings").json()["items"]
    known = recording["id"]
    for status, kind, body in (
        (404, "unknown-recording", {"recording": "nosuch"}),
        (404, "unknown-alarm", {"alarm": "nosuch"}),
        (404, "unknown-recording", {"recording": known, "validate": "nosuch"}),
        (422, "bad-parameter", {}),
        (422, "bad-parameter", {"recording": known, "alarm": "x"}),
        (422, "bad-parameter", {"recording": known, "model": "/etc/passwd"}),
        (422, "bad-parameter", {"recording": known, "first_realisation": -1}),
        (422, "bad-parameter", {"recording": known, "report": "/tmp/x"}),
        (422, "bad-parameter", {"recording": [known]}),
    ):
        assert_problem(served.post("/diagnoses", json=body), status, kind)
    assert "'model.toml'" in served.post("/diagnoses", json={"recording": known, "model": "x"}).json()["detail"]
    assert_problem(served.post("/diagnoses", content=b"{"), 422, "bad-parameter")
    assert_problem(served.post("/recordings/nosuch/replay"), 404, "unknown-recording")
    for path in ("/jobs/nosuch", "/diagnoses/nosuch", "/diagnoses/nosuch/report"):
        assert served.get(path).status_code == 404
    assert_problem(served.post("/jobs/nosuch/cancel"), 404, "unknown-job")
