"""The page in a browser, over a real demo: from opening it to the alarm of node 3 and what is done about it."""

import re
import subprocess
import time

import httpx
import pytest
from playwright.sync_api import expect
from test_service import CREAK, wait_for

from browser import DEADLINE, chromium, visiting
from processes import free_port

expect.set_options(timeout=DEADLINE)
SHADES = """(canvas) => new Set(new Uint32Array(
    canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data.buffer)).size"""


@pytest.fixture(scope="module")
def browser():
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def demo(tmp_path_factory, browser):
    """A demo that has just begun; gives its address."""
    place = tmp_path_factory.mktemp("demo")
    port = free_port()
    process = subprocess.Popen(
        [*CREAK, "demo", "--port", str(port), "--output", "out"],
        cwd=place,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}"
    try:
        wait_for("the demo answers", lambda: httpx.get(f"{address}/api/v1/rigs/beam").status_code == 200, process)
        yield address
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture
def visit(browser, demo):
    with visiting(browser, demo) as visit:
        yield visit


def rest(address, path):
    return httpx.get(f"{address}/api/v1{path}").raise_for_status().json()


def test_spectra_are_drawn_and_go_on_by_themselves(visit):
    """Kills a page that shows a moment of the past: the demo plays its first realisations in two seconds each."""
    page = visit.go("#/rigs/beam/nodes/3")
    charts = page.locator(".plot canvas")
    expect(charts).to_have_count(4)
    expect(page.get_by_text("Classical", exact=False).first).to_be_visible()
    told = page.get_by_text(re.compile(r"\d+ realisations?, recorded until"))
    expect(told).to_be_visible()
    before = told.text_content()
    expect(told).not_to_have_text(before)
    expect(page.locator("#state")).to_have_text("live")
    for index in (0, 1):  # both have drawn something: their pixels are not of one colour
        assert charts.nth(index).evaluate(SHADES) > 10
    hide = page.get_by_role("button", name="nonlinear").first
    hide.click()
    expect(hide).to_have_attribute("aria-pressed", "false")
    page.locator(".plot").first.focus()
    page.keyboard.press("ArrowRight")
    expect(page.locator(".readout").first).to_have_text(re.compile(r"Hz: signal .* dB"))


def test_the_alarm_of_node_3_is_seen_acknowledged_and_diagnosed(visit, demo):
    """What the page is for, with nothing but its own buttons."""
    page = visit.go()
    expect(page.get_by_role("heading", name="beam")).to_be_visible()
    expect(page.locator(".tile")).to_have_count(3)
    row = page.locator(".urgent tbody tr")
    expect(row).to_have_count(1)
    expect(row).to_contain_text("beam / 3")
    expect(page.locator("#alarm-count")).to_contain_text("1")
    expect(page.locator(".tile.unacknowledged")).to_contain_text("3")
    expect(page).to_have_title(re.compile(r"^\(1\) Fleet"))
    row.get_by_role("button", name="Acknowledge").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Your name").fill("A. Operator")
    dialog.get_by_label("Comment").fill("seen; <b>the bearing</b> is ordered")
    dialog.get_by_role("button", name="Acknowledge").click()
    expect(dialog).to_have_count(0)
    expect(page.locator(".urgent")).to_have_count(0)
    expect(page.locator(".tile.acknowledged")).to_contain_text("acknowledged")
    (alarm,) = rest(demo, "/alarms")["items"]
    assert (alarm["node"], alarm["state"], alarm["by"]) == ("3", "acknowledged", "A. Operator")
    page.get_by_role("link", name="Alarms").click()
    page.get_by_role("button", name="Diagnose").click()
    expect(page.get_by_role("heading", name="Diagnosis: beam")).to_be_visible()
    (job,) = rest(demo, "/diagnoses")["items"]
    assert job["request"]["alarm"] == alarm["id"]
    page.get_by_role("button", name="Cancel").click()  # how one ends is seen in test_diagnoses.py
    expect(page.get_by_text("cancelled").first).to_be_visible()
    page.goto(f"{demo}/#/alarms/{alarm['id']}")
    expect(page.get_by_text("seen; <b>the bearing</b> is ordered")).to_be_visible()
    expect(page.get_by_role("row").filter(has_text="acknowledged")).not_to_have_count(0)


def test_the_element_that_distorts_is_marked_in_the_structure(visit):
    page = visit.go("#/rigs/beam")
    expect(page.locator("svg.structure a.node")).to_have_count(3)
    expect(page.locator("svg.structure .share-4")).to_have_text(re.compile("3 – ground"))
    assert page.locator("svg.structure .beam").count() == 1
    page.get_by_role("link", name="Node 3").click()
    expect(page).to_have_url(re.compile("#/rigs/beam/nodes/3$"))


def test_all_of_it_works_by_keyboard(visit, demo):
    """Kills a button that only a pointer reaches, a focus that is lost, and keys that nobody is told of."""
    page = visit.go()
    expect(page.locator(".tile")).to_have_count(3)
    press = page.keyboard.press
    press("Tab")
    expect(page.locator("#skip")).to_be_focused()
    press("Enter")
    expect(page.get_by_role("heading", name="Fleet")).to_be_focused()
    press("?")
    expect(page.get_by_role("dialog")).to_contain_text("go to alarms")
    press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    press("g")
    press("a")
    expect(page.get_by_role("heading", name="Alarms")).to_be_focused()
    shelve = page.get_by_role("button", name="Shelve")
    for _ in range(20):
        if shelve.evaluate("(element) => element === document.activeElement"):
            break
        press("Tab")
    expect(shelve).to_be_focused()
    press("Enter")
    expect(page.get_by_label("Your name")).to_be_focused()
    page.keyboard.type("B. Operator")
    press("Tab")
    press("ArrowUp")
    press("ArrowUp")
    press("Shift+Tab")
    press("Enter")
    unshelve = page.get_by_role("button", name="Unshelve")
    expect(unshelve).to_be_visible()
    (alarm,) = rest(demo, "/alarms")["items"]
    last = rest(demo, "/rigs/beam")["last"]
    hours = seconds(alarm["shelved_until"]) - seconds(last)
    assert (alarm["state"], alarm["by"]) == ("shelved", "B. Operator")
    assert 3000 < hours <= 3600  # an hour of recorded time from then on
    unshelve.focus()
    press("Enter")
    page.get_by_role("dialog").get_by_role("button", name="Unshelve").press("Enter")
    expect(page.get_by_text("acknowledged", exact=True)).to_be_visible()


def seconds(text):
    return time.mktime(time.strptime(text[:19], "%Y-%m-%dT%H:%M:%S"))


def test_dark_and_light(browser, demo):
    """Kills a chart or a page that stays light in the dark, and a choice that is forgotten."""
    with visiting(browser, demo, color_scheme="dark") as visit:
        page = visit.go("#/rigs/beam/nodes/3")
        expect(page.locator(".plot canvas")).to_have_count(4)
        shade = "() => getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)[0]"
        assert page.evaluate(shade) < 40
        page.keyboard.press("t")  # from automatic to dark
        page.keyboard.press("t")  # to light
        assert page.evaluate(shade) > 200
        page.reload()
        assert page.evaluate(shade) > 200


def test_a_tablet_shows_it_without_scrolling_sideways(browser, demo):
    for width in (820, 390):
        with visiting(browser, demo) as visit:
            visit.page.set_viewport_size({"width": width, "height": 1000})
            for view in ("", "#/rigs/beam", "#/rigs/beam/nodes/3", "#/alarms", "#/recordings"):
                page = visit.go(view)
                expect(page.locator("h1")).to_be_visible()
                expect(page.locator(".card, .tile").first).to_be_visible()
                assert page.evaluate("() => document.documentElement.scrollWidth") <= width, view
                small = page.locator("button:visible, nav a:visible").evaluate_all(
                    "(all) => all.filter((e) => e.getBoundingClientRect().height < 40).map((e) => e.textContent)"
                )
                assert small == []  # what is touched is large enough for a finger
