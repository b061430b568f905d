"""The page in a browser where the demo does not go: odd names, keys, a service that goes away, other views."""

from dataclasses import replace
from math import log10

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import expect

from api_client import serving
from browser import DEADLINE, chromium, visiting
from conftest import make_rig
from creak.api import create_app
from creak.api.access import Access
from creak.baseline import level_db
from creak.records import Node
from creak.sinks import keys
from creak.sinks.database import open_store
from creak.sinks.keys import KeyScope
from creak.sinks.store import RecordingEntry, put_recording
from receiver import receiving
from store_records import (
    BEAM,
    SECOND,
    START,
    feed,
    fill_beam,
    make_alarm,
    make_fault,
    make_level,
    make_run,
    opened,
)
from webhook_desk import add, delivering

expect.set_options(timeout=DEADLINE)
EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture
def store(tmp_path):
    store = open_store(f"sqlite:///{tmp_path}/creak.db")
    fill_beam(store)
    yield store
    store.close()


def address(client):
    return str(client.base_url).rstrip("/")


def test_names_are_only_ever_text(browser, store):
    """Kills markup in the name of a rig, a node, a file or a comment."""
    nodes = (Node(EVIL, "m", "N"), Node("a/b #?%", "<i>m", "N"))
    run = make_run("evil-1", rig=replace(make_rig(name=EVIL), nodes=nodes))
    sink = opened(store, run)
    feed(sink, run, 3)
    sink.take(make_alarm(run, EVIL, since=START + 3 * SECOND, by=EVIL, comment=EVIL, guidance=EVIL))
    sink.take(replace(make_fault(), message=EVIL))
    put_recording(store, RecordingEntry(EVIL, EVIL, "evil-1", f"/x/{EVIL}.mcap", START, None, "writing", 1))
    with serving(create_app(store)) as client, visiting(browser, address(client)) as visit:
        page = visit.go()
        page.locator(".tile").filter(has_text=EVIL).click()
        expect(page.get_by_role("heading", name=f"{EVIL}, node {EVIL}")).to_be_visible()
        expect(page.locator(".plot canvas")).to_have_count(4)
        page.get_by_role("link", name=EVIL, exact=True).click()
        expect(page.get_by_role("link", name="Node a/b #?%")).to_be_visible()
        page.get_by_role("link", name="Node a/b #?%").click()
        expect(page.get_by_role("heading", name="node a/b #?%")).to_be_visible()
        for view in ("#/alarms", "#/recordings"):
            page = visit.go(view)
            expect(page.get_by_text(EVIL).first).to_be_visible()
        page = visit.go("#/alarms")
        page.locator("tbody tr").filter(has_text=EVIL).get_by_role("link").nth(1).click()
        expect(page.get_by_role("cell", name=EVIL).first).to_be_visible()
        assert page.locator("main img, main i").count() == 0


def test_the_key_is_asked_for_once_and_kept_in_the_tab(browser, store):
    with store.write() as connection:
        token = keys.add(connection, "operator", KeyScope.OPERATE)
    app = create_app(store, access=Access(keys=True))
    with serving(app) as client, visiting(browser, address(client), forgiven=("401", "403")) as visit:
        page = visit.go()
        dialog = page.get_by_role("dialog")
        dialog.get_by_label("API key").fill("creak_wrong")
        dialog.get_by_role("button", name="Use this key").click()
        expect(dialog).to_contain_text("refused")
        dialog.get_by_label("API key").fill(token)
        page.keyboard.press("Enter")
        expect(page.locator("#state")).to_have_text("live")  # the stream has it too
        expect(page.locator(".tile")).to_have_count(6)
        page.reload()
        expect(page.locator(".tile")).to_have_count(6)
        expect(dialog).to_have_count(0)
        assert page.evaluate("() => localStorage.length + document.cookie.length") == 0
        page.get_by_role("link", name="Webhooks").click()
        expect(page.get_by_text("scope admin")).to_be_visible()
        page.get_by_role("button", name="Change key").click()
        expect(dialog.get_by_label("API key")).to_be_focused()


def test_what_the_worker_has_not_done_yet_is_not_called_done(browser, store):
    """The rig's worker lives but does not answer: the action is noted, the alarm still stands as it stood."""
    with serving(create_app(store)) as client, visiting(browser, address(client)) as visit:
        page = visit.go("#/alarms")
        page.get_by_role("button", name="Acknowledge").click()
        page.get_by_label("Your name").fill("A. Operator")
        page.get_by_role("dialog").get_by_role("button", name="Acknowledge").click()
        expect(page.get_by_text("to be acknowledged once its rig answers")).to_be_visible()
        expect(page.get_by_role("cell", name="unacknowledged")).to_be_visible()


def test_a_service_that_goes_away_is_said_and_comes_back(browser, store):
    """Kills figures of the past that look like those of now, and a page that has to be loaded anew."""
    with serving(create_app(store)) as client:
        port = client.base_url.port
        with visiting(browser, address(client), forgiven=("ERR_", "Failed to load")) as visit:
            page = visit.go()
            expect(page.locator("#state")).to_have_text("live")
            expect(page.locator("#banner")).to_be_hidden()
            client.server.stop()
            expect(page.locator("#banner")).to_contain_text("Not connected since")
            expect(page.locator("body")).to_have_class("stale")
            expect(page.locator(".tile")).to_have_count(6)  # the last figures stay
            run = make_run("late-1", "late")
            feed(opened(store, run), run, 1)
            with serving(create_app(store), port):
                expect(page.locator("#state")).to_have_text("live")
                expect(page.locator("#banner")).to_be_hidden()
                expect(page.get_by_role("heading", name="late")).to_be_visible()


def test_one_request_that_fails_does_not_cut_the_page_off_for_good(browser, store):
    """Kills figures that are called out of date while the stream of events goes on."""
    with serving(create_app(store)) as client, visiting(browser, address(client), ["ERR_"]) as visit:
        page = visit.go()
        expect(page.locator("#state")).to_have_text("live")
        page.route("**/api/v1/rigs", lambda route: route.abort("connectionreset"))
        expect(page.locator("#state")).to_have_text("not connected")
        page.unroute("**/api/v1/rigs")
        expect(page.locator("#state")).to_have_text("live", timeout=15_000)
        expect(page.locator("#banner")).to_be_hidden()


def test_what_has_no_figure_is_not_drawn_as_the_largest(browser, store):
    """Kills the noise of a recording without noise at 0 dB."""
    with serving(create_app(store)) as client, visiting(browser, address(client)) as visit:
        page = visit.go()
        script = page.locator("script[type=module]").get_attribute("src").replace("main.js", "views/diagnoses.js")
        draw = (
            "async ([source, node]) => [...(await import(source)).bar(node).children].map((e) => e.classList[0])"
        )
        levels = {"before_db": -20.0, "after_db": -40.0, "noise_db": None}
        found = page.evaluate(draw, [f"{address(client)}/{script}", levels])
        assert found == ["scale", "change", "before", "after"]
        found = page.evaluate(draw, [f"{address(client)}/{script}", {**levels, "after_db": None}])
        assert found == ["scale", "before"]


def test_a_recording_is_downloaded_under_its_name(browser, store, tmp_path):
    file = tmp_path / "beam-7.mcap"
    file.write_bytes(b"\x89MCAP0\r\n" + bytes(100_000))
    put_recording(store, RecordingEntry("7", "beam", "beam-1", str(file), START, START, "complete", 1))
    with store.write() as connection:
        token = keys.add(connection, "reader", KeyScope.READ)
    for access in (Access(), Access(keys=True)):
        with (
            serving(create_app(store, access=access)) as client,
            visiting(browser, address(client), forgiven=("401",)) as visit,
        ):
            page = visit.go("#/recordings")
            if access.keys:
                page.get_by_label("API key").fill(token)
                page.keyboard.press("Enter")
            with page.expect_download() as begun:
                page.get_by_role("button", name="Download 7").click()
            assert begun.value.suggested_filename == "beam-7.mcap"
            assert begun.value.path().read_bytes() == file.read_bytes()


def test_what_is_not_there_is_said(browser, store):
    with serving(create_app(store)) as client, visiting(browser, address(client), forgiven=("404",)) as visit:
        page = visit.go("#/nosuch")
        expect(page.get_by_text("There is no such page.")).to_be_visible()
        page = visit.go("#/rigs/nosuch")
        expect(page.get_by_text("there is no rig 'nosuch'")).to_be_visible()
        page = visit.go("#/rigs/bench")
        expect(page.get_by_text("No realisation is complete yet.")).to_be_visible()
        page = visit.go("#/rigs/bench/nodes/1")
        expect(page.get_by_text("No spectrum yet")).to_be_visible()
        page = visit.go("#/diagnoses")
        expect(page.get_by_text("Nothing has been diagnosed yet.")).to_be_visible()
        page = visit.go("#/webhooks")
        expect(page.get_by_text("There are no receivers.")).to_be_visible()


def test_an_empty_service_says_what_to_do(browser, tmp_path):
    with (
        serving(create_app(f"sqlite:///{tmp_path}/empty.db")) as client,
        visiting(browser, address(client)) as visit,
    ):
        expect(visit.go().get_by_text("No rig has been heard of yet.")).to_be_visible()


def test_deliveries_of_webhooks_are_seen(browser, store):
    """A receiver that fails once: what was tried, and what came of it."""
    with receiving(500) as receiver, delivering(store), serving(create_app(store)) as client:
        add(store, receiver.url)
        with visiting(browser, address(client)) as visit:
            page = visit.go("#/webhooks")
            page.get_by_role("button", name=f"Test: {receiver.url}").click()
            expect(page.get_by_text("A test message is on its way.")).to_be_visible()
            rows = page.get_by_role("region", name="Deliveries").locator("tbody tr")
            expect(rows.filter(has_text="retried")).to_contain_text("500")
            expect(rows.filter(has_text="delivered")).to_contain_text("204")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_is_accessible(browser, store, scheme):
    """Kills colours of too little contrast, controls without a name, roles that do not fit (axe-core's rules)."""
    place = f"#/alarms/{make_alarm(BEAM).id.replace('/', '%2F')}"
    with serving(create_app(store)) as client, visiting(browser, address(client), color_scheme=scheme) as visit:
        for view in ("", "#/rigs/beam", "#/rigs/beam/nodes/3", "#/alarms", place, "#/recordings", "#/webhooks"):
            page = visit.go(view)
            expect(page.locator("h1")).to_be_visible()
            expect(page.locator("#state")).to_have_text("live")
            found = Axe().run(page).response["violations"]
            assert [(view, each["id"], each["nodes"][0]["html"]) for each in found] == []


def test_events_are_read_however_the_stream_is_cut(browser, store):
    """Kills a line end, a letter or an event that is lost between two pieces."""
    text = (
        ': creak\r\nretry: 1000\n\nevent: alarm\ndata: {"a":\ndata:  1}\nid: 7\r\r\ndata: ö\n\nid: 8\n\ndata: cut'
    )
    wanted = [{"event": "alarm", "data": '{"a":\n 1}', "id": "7"}, {"data": "ö"}]
    with serving(create_app(store)) as client, visiting(browser, address(client)) as visit:
        page = visit.go()
        cuts = """async ([source, text]) => {
            const { Parser } = await import(source);
            const read = (pieces, parser = new Parser()) => pieces.flatMap((piece) => [...parser.take(piece)]);
            return [...text].map((_, i) => read([text.slice(0, i), text.slice(i)])).concat([read([...text])]);
        }"""
        script = page.locator("script[type=module]").get_attribute("src").replace("main.js", "stream.js")
        for read in page.evaluate(cuts, [f"{address(client)}/{script}", text]):
            assert [{key: value for key, value in event.items() if key != "retry"} for event in read] == wanted


def test_a_baseline_is_drawn_where_the_nonlinear_level_was(browser, store):
    """Kills a band on another scale than the level beside it: the started logarithm is undone."""
    noise, nonlinear = -97.0, -94.0
    total = 10 * log10(10 ** (noise / 10) + 10 ** (nonlinear / 10))
    level = replace(make_level("3"), noise_db=noise, total_db=total)
    mean = level_db(level, 10 ** (noise / 10))
    learnt = {"complete": True, "mean_db": mean, "deviation_db": 0.0, "reference_noise_db": noise}
    with serving(create_app(store)) as client, visiting(browser, address(client)) as visit:
        page = visit.go()
        script = page.locator("script[type=module]").get_attribute("src").replace("main.js", "levels.js")
        drawn = page.evaluate(
            "async ([source, learnt]) => (await import(source)).baselineLevels([learnt, { complete: false }])",
            [f"{address(client)}/{script}", learnt],
        )
    assert [(band["y"], band["to"]) for band in drawn] == [(pytest.approx(nonlinear), pytest.approx(nonlinear))]
