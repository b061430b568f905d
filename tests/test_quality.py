"""The gates of pyproject.toml, run with the tests."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "service", "tests", "deploy"],
        ["ruff", "format", "--check", "service", "tests", "deploy"],
        ["mypy"],
        ["lint-imports"],
    ],
    ids=" ".join,
)
def test_gate(command):
    done = subprocess.run([BIN / command[0], *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_modules_keep_one_subject():
    """No module grows past about 400 lines (records.py, the one list of all records, is the longest)."""
    for path in (ROOT / "service").rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 500, path
