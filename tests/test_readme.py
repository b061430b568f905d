"""The README is true: its commands run, its files are accepted, its set-up blocks are where they must be."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from creak.config.rig import parse_rig
from creak.config.service import parse_service
from creak.config.validation import parse_toml
from recorded import records, write

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def test_two_set_up_commands_and_no_more():
    main, tests = blocks("sh")
    assert main.count("\n") == tests.count("\n") == 1
    assert main.endswith("creak demo\n")
    assert ".venv/bin/pytest" in tests
    for block in (main, tests):
        assert block.startswith("python3 -m venv ")


@pytest.mark.parametrize("block", blocks("bash"), ids=lambda block: block.split("\n")[0][:30])
def test_examples_run(block, tmp_path):
    (tmp_path / "deploy").symlink_to(ROOT / "deploy")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block],
        cwd=tmp_path,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("block", blocks("python"), ids=lambda block: block.split("\n")[0][:30])
def test_notebook_examples_run(block, tmp_path, monkeypatch):
    write(tmp_path / "three-mass.mcap", records())
    monkeypatch.chdir(tmp_path)
    exec(block, {})


def test_example_files_are_accepted(tmp_path):
    rig, service = blocks("toml")
    assert parse_rig(rig, "README.md").name == "three-mass"
    assert parse_service(parse_toml(service, "README.md"), "README.md", tmp_path).rigs[0].window == 4


def test_ci_takes_the_test_command_and_nothing_else(tmp_path):
    """Kills a runner that also runs the examples, or that runs nothing and is green."""
    (tmp_path / ".ci").mkdir()
    (tmp_path / "README.md").write_text(README)
    script = tmp_path / ".ci" / "run"
    script.write_text((ROOT / ".ci" / "run").read_text().replace("exec bash", "exit 0; exec bash"))
    done = subprocess.run(["bash", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n", 1)[1] == blocks("sh")[1]
