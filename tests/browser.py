"""Debian's Chromium for tests of the page, and pages that keep an account of what went wrong in them."""

import os
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import sync_playwright

CHROMIUM = Path("/usr/bin/chromium")
FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
DEADLINE = 90_000.0  # ms after which something hangs; not a figure
_VIOLATIONS = "addEventListener('securitypolicyviolation', (e) => console.error(`policy: ${e.violatedDirective}`))"


@contextmanager
def chromium():
    """A browser without a window; skips the test where there is none."""
    if not CHROMIUM.exists():
        absent = f"there is no {CHROMIUM}"
        pytest.fail(absent) if os.environ.get("CI") == "true" else pytest.skip(absent)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


class Visit:
    """One visitor's page at an address; ``complaints`` holds all that a tidy page does not do."""

    def __init__(self, browser, address, **options):
        self.context = browser.new_context(viewport={"width": 1280, "height": 800}, **options)
        self.context.set_default_timeout(DEADLINE)
        self.context.add_init_script(_VIOLATIONS)
        self.address = address
        self.complaints = []
        self.page = self.context.new_page()
        self.page.on("console", self._told)
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", self._asked)
        self.page.on("dialog", lambda dialog: (self.complaints.append(dialog.message), dialog.dismiss()))

    def go(self, view=""):
        """Open a view by its hash, on a fresh page: what is seen is not of the view before."""
        self.page.goto("about:blank")
        self.page.goto(f"{self.address}/{view}")
        return self.page

    def _told(self, message):
        if message.type in {"error", "warning"}:
            self.complaints.append(message.text)

    def _asked(self, request):
        if not request.url.startswith((self.address, "data:", "blob:")):
            self.complaints.append(f"asked {urlsplit(request.url).netloc}")


@contextmanager
def visiting(browser, address, forgiven=(), **options):
    """A visit that ends without a complaint but those that hold one of the given words."""
    visit = Visit(browser, address, **options)
    yield visit
    visit.context.close()
    assert [told for told in visit.complaints if not any(word in told for word in forgiven)] == []
