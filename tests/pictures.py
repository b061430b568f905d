"""Makes the README's pictures of the page: ``python tests/pictures.py deploy/pictures``."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import httpx

from browser import chromium, visiting

_REALISATIONS = 10  # of the demo, after which its quick past is over
_WAIT = 300.0


def main(folder):
    """Take them of a demo whose alarm stands."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-m", "creak.cli", "demo", "--port", "8399", "--output", place]
        demo = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        address = "http://127.0.0.1:8399"
        try:
            _until(lambda: httpx.get(f"{address}/api/v1/rigs/beam").json()["realisations"] >= _REALISATIONS)
            with chromium() as browser, visiting(browser, address, reduced_motion="reduce") as visit:
                for name, view, height in (("dashboard", "", 860), ("node", "#/rigs/beam/nodes/3", 1240)):
                    visit.page.set_viewport_size({"width": 1280, "height": height})
                    visit.go(view).wait_for_timeout(2000)
                    visit.page.screenshot(path=folder / f"{name}.png")
        finally:
            demo.terminate()
            demo.wait(30)


def _until(true):
    end = time.monotonic() + _WAIT
    while time.monotonic() < end:
        try:
            if true():
                return
        except (httpx.TransportError, KeyError):
            pass
        time.sleep(0.5)
    raise SystemExit("the demo did not come so far")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
