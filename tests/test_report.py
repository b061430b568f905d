"""The report of a diagnosis: words that say what the figures say, one page, and a browser that can show it."""

import base64
import os
import re
import shutil
import subprocess
from html.parser import HTMLParser
from xml.etree import ElementTree

import matplotlib.image
import numpy as np
import pytest

from creak.codec.diagnosis_json import diagnosis_json
from creak.gap.records import Verdict
from creak.mechanics.vocabulary import VOCABULARY
from creak.report import POLICY, words
from creak.report.figures import AFTER, BEFORE
from creak.report.page import write_page
from diagnosed import AWKWARD, diagnosis, validation
from store_records import make_run


def page(verdict=Verdict.EXPLAINED, holding=None):
    return write_page(diagnosis(verdict), holding, make_run(), "a.mcap", "model.toml")


class Words(HTMLParser):
    """Text and addresses of a page whose elements are closed in the order in which they were opened."""

    def __init__(self, text):
        super().__init__()
        self.text, self.sources, self.open = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        assert tag not in {"b", "script", "link", "iframe", "object"}
        if tag not in {"meta", "img", "br"}:
            self.open.append(tag)
        self.sources += [value for key, value in attrs if key in {"src", "href", "action", "data"}]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


@pytest.mark.parametrize("verdict", list(Verdict))
def test_a_page_is_whole_and_loads_nothing(verdict):
    """Kills a name that breaks the page, a picture from elsewhere, and an element that is not closed."""
    text = page(verdict, validation())
    read = Words(text)
    assert AWKWARD in " ".join(read.text)
    assert read.sources
    assert all(source.startswith("data:image/svg+xml;base64,") for source in read.sources)
    assert f'http-equiv="Content-Security-Policy" content="{POLICY}"' in text
    assert "http://" not in text
    assert "url(" not in text


def test_pictures_are_svg_that_loads_nothing_and_shows_names_as_they_are():
    sources = Words(page()).sources
    assert len(sources) == 4  # nodes, bands, one curve, waterfall
    pictures = [base64.b64decode(source.partition(",")[2]).decode() for source in sources]
    for picture in pictures:
        root = ElementTree.fromstring(picture)
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert not re.search(r'href="(?!#)', picture)
    shown = ["".join(ElementTree.fromstring(picture).itertext()) for picture in pictures]
    assert all(AWKWARD in text for text in (shown[0], shown[1], shown[3]))
    assert page() == page()  # the same for the same diagnosis: no clock, no random ids


def test_the_page_names_what_was_found_and_what_was_not_tested():
    text = " ".join(Words(page(holding=validation(holds=True))).text)
    for said in ("Verdict: explained", "a cubic spring", "Coulomb friction", "the model says 1", "a clearance"):
        assert said in text
    assert "35000 → 36120 ± 88 N/m" in text
    assert "The correction holds there too." in text
    untried = text[text.index("Not tried:") : text.index("Tried:")]
    assert "hysteresis" in untried
    assert "cubic stiffness" not in untried
    outside = " ".join(Words(page(Verdict.UNKNOWN)).text)
    assert "No effect of the vocabulary explains it" in outside
    assert "cubic" not in outside.partition("What was not tested")[0]


def test_words():
    assert set(words._PHRASES) == set(VOCABULARY)  # every effect can be told
    for kind in VOCABULARY.values():
        for name in kind.parameter_names():
            assert (kind.effect, name) in words._UNITS or name in {"gain", "limit", "width", "share", "step"} | {
                "yield_input",
                "damping_ratio",
            }
    assert words.place(("ground", "2")) == words.place(("2", "ground")) == "between node 2 and ground"
    assert words.place(("1",), "actuator_gain") == "at the actuator of node 1"
    assert words.place(("1",), "resonator") == words.place(("1", "ground"), "mass") == "at node 1"


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (1.0003e8, 2.1e5, "1.0003e+08 ± 4.1e+05 N"),
        (2.0, 0.02, "2.000 ± 0.039 N"),
        (-36120.4, 45.0, "-36120 ± 88 N"),
        (0.5, float("nan"), "0.5 N"),
        (1.0, 30.0, "1.0 ± 59 N"),
        (0.0, 1.0, "0 N"),
    ],
)
def test_a_quantity_has_the_digits_that_its_interval_allows(value, error, text):
    assert words.quantity(value, error, "N") == text


def test_json_has_the_contracts_keys_and_no_number_that_is_none():
    document = diagnosis_json(diagnosis(), validation())
    assert list(document)[:8] == [
        *(
            "verdict",
            "gap",
            "nodes",
            "where",
            "causes",
            "alternatives",
            "linear_corrections",
            "held_out_realisations",
        ),
    ]
    assert list(document["gap"]) == ["before_db", "after_db", "noise_db", "closed"]
    shares = ["linear_share", "nonlinear_share", "noise_share"]
    assert list(document["nodes"][0]) == ["name", "before_db", "after_db", "noise_db", *shares]
    assert list(document["where"][0])[:3] == ["at", "share", "band_hz"]
    cause = ["effect", "at", "parameters", "standard_errors", "probability", "gap_after_db"]
    assert list(document["causes"][0])[:6] == cause
    assert {*cause, "instead_of"} <= set(document["alternatives"][0])
    moved = {"element": "1-2", "parameter": "stiffness", "from": 35000.0, "to": 36120.0, "standard_error": 45.0}
    assert document["linear_corrections"] == [moved]
    assert document["causes"][1]["standard_errors"]["velocity"] is None
    assert diagnosis_json(diagnosis(Verdict.UNKNOWN))["gap"]["closed"] is None


def test_a_browser_shows_the_pictures(tmp_path):
    """Kills a page whose own policy keeps its pictures or styles away."""
    browser = shutil.which("chromium")
    if browser is None:
        absent = "chromium is not installed"
        pytest.fail(absent) if os.environ.get("CI") == "true" else pytest.skip(absent)
    (tmp_path / "page.html").write_text(page())
    shot = tmp_path / "page.png"
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}"]
    command += ["--host-resolver-rules=MAP * ~NOTFOUND", "--window-size=1000,3000", f"--screenshot={shot}"]
    subprocess.run([*command, f"file://{tmp_path / 'page.html'}"], check=True, capture_output=True, timeout=120)
    picture = matplotlib.image.imread(shot)[..., :3]

    def rows_with(color):
        wanted = [int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        return np.flatnonzero((np.abs(picture - wanted).max(axis=-1) < 0.02).any(axis=1))

    assert np.ptp(rows_with(BEFORE)) > 500  # markers of the first picture, and the bar of the waterfall far below
    assert np.ptp(rows_with(AFTER)) > 1000
