"""The table of all keys is that of the code: complete, current, and true of what the service then reads."""

import json
import tomllib
from pathlib import Path

import pytest

from creak.cli import run
from creak.config.reference import service_keys
from creak.config.service import ServiceSettings, parse_service

KEYS = service_keys()
LEAST = {"rigs": [{"rig": "rig.toml", "source": {"kind": "recording", "files": ["a.mcap"]}}]}
ALONE = [key for key in KEYS if key.environment and key.name != "rigs"]
PATHS = {"data", "stream.credentials"}
OTHER = {
    "stream.url": "tls://elsewhere:4222",
    "stream.name": "other",
    "stream.credentials": "worker.creds",
    "stream.send": "frames",
    "data": "elsewhere",
    "server.host": "::1",
    "store.url": "sqlite:////tmp/x.db",
    "webhooks.allow": ["10.0.0.0/8"],
}


def found(settings, name):
    for part in name.replace("[]", ".0").split("."):
        settings = settings[int(part)] if part.isdigit() else getattr(settings, part)
    return settings


def test_the_written_table_is_current(capsys):
    """Made with: creak configuration > deploy/CONFIGURATION.md"""
    assert run(["configuration"]) == 0
    written = Path(__file__).parents[1] / "deploy" / "CONFIGURATION.md"
    assert capsys.readouterr().out == written.read_text(encoding="utf-8")


def test_as_a_document(capsys):
    assert run(["configuration", "--json"]) == 0
    assert [key["name"] for key in json.loads(capsys.readouterr().out)] == [key.name for key in KEYS]


def test_every_key_is_told_and_explained():
    """Kills a table of settings that the walk passes over, and a key that nobody has described."""
    names = {(key.name, key.kind) for key in KEYS}
    assert len(names) == len(KEYS)
    assert {key.name.split(".")[0].removesuffix("[]") for key in KEYS} == set(ServiceSettings.model_fields)
    assert {key.kind for key in KEYS} >= {"", "simulated", "recording", "can"}
    assert [key.name for key in KEYS if not key.meaning and not key.name.endswith(".kind")] == []


@pytest.mark.parametrize("key", ALONE, ids=lambda key: key.name)
def test_the_variable_of_a_key_overrides_it(key, monkeypatch, tmp_path):
    before = found(parse_service(LEAST, "test", tmp_path), key.name)
    other = OTHER[key.name] if key.name in OTHER else (before or 0) + 1
    monkeypatch.setenv(key.environment, json.dumps(other) if isinstance(other, list) else str(other))
    after = found(parse_service(LEAST, "test", tmp_path), key.name)
    assert after == (tmp_path / other if key.name in PATHS else other) != before


@pytest.mark.parametrize(
    "key", [key for key in KEYS if not key.kind and key.name != "data"], ids=lambda key: key.name
)
def test_a_default_is_what_a_file_without_the_key_gives(key, tmp_path):
    if key.default == "required":
        return
    value = found(parse_service(LEAST, "test", tmp_path), key.name)
    told = tomllib.loads(f"x = {key.default}")["x"] if key.default else None
    assert value == told or (told is None and value == [])
