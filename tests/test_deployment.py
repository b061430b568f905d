"""What is deployed beside the service fits it: rules, dashboards, compose file and units, each by its own tool.

Figures and rows that rules and dashboards ask for are asked of a real server over a store with two rigs.
"""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.cog.plugins import register_default_plugins
from grafana_foundation_sdk.models.dashboard import Dashboard
from prometheus_client.parser import text_string_to_metric_families

from api_client import get, serving
from creak.api import create_app
from creak.config.service import load_service
from creak.sinks import jobs, receivers
from creak.sinks.database import open_store
from store_records import fill_beam

ROOT = Path(__file__).parents[1]
DEPLOY = ROOT / "deploy"
PROMETHEUS = DEPLOY / "prometheus"
DASHBOARDS = sorted((DEPLOY / "grafana" / "dashboards").glob("*.json"))
COMPOSE = yaml.safe_load((ROOT / "docker-compose.yml").read_text())
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))

PROVISIONED = ("up", "ALERTS")  # what Prometheus makes itself
VARIABLES = {
    "${rig}": "beam",
    "${__from:date:iso}": "1970-01-01T00:00:00Z",
    "${__to:date:iso}": "2100-01-01T00:00:00Z",
}


def tool(*names):
    """Path of a program that is not ours; Debian's packages that bring it are prometheus, podman and systemd."""
    for name in names:
        found = shutil.which(name) or shutil.which(name, path=str(Path(sys.executable).parent))
        if found:
            return found
    return pytest.skip(f"{names[0]} is not installed")


def checked(*command, cwd=None):
    done = subprocess.run([*map(str, command)], cwd=cwd, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    store = open_store(f"sqlite:///{tmp_path_factory.mktemp('deployed')}/creak.db")
    with store.write() as connection:
        failing = receivers.add(connection, "https://a.example/", (), (), "standard", "whsec_a")
        receivers.update(connection, failing.id, failing_since_at=7)
    fill_beam(store)
    jobs.put(store, jobs.Task("diagnosis", ("beam.mcap",), "model.toml"), {"recording": "x"}, now=0, waiting=1)
    with serving(create_app(store, data=ROOT)) as client:
        yield client
    store.close()


@pytest.fixture(scope="module")
def figures(client):
    """Labels of every sample that the service offers, by name."""
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def targets(kind):
    for path in DASHBOARDS:
        for panel in json.loads(path.read_text())["panels"]:
            for target in panel["targets"]:
                if target["datasource"]["type"] == kind:
                    yield f"{path.stem}: {panel['title']}", target


RULES = yaml.safe_load((PROMETHEUS / "alerts.yml").read_text())["groups"][0]["rules"]
EXPRESSIONS = [(rule["alert"], rule["expr"]) for rule in RULES] + [
    (where, target["expr"]) for where, target in targets("prometheus")
]

ROWS = list(targets("yesoreyeram-infinity-datasource"))


def test_prometheus_accepts_its_configuration_and_the_rules_speak_when_they_should():
    promtool = tool("promtool")
    checked(promtool, "check", "config", "--syntax-only", "prometheus.yml", cwd=PROMETHEUS)
    checked(promtool, "check", "rules", "alerts.yml", cwd=PROMETHEUS)
    checked(promtool, "test", "rules", "alerts.test.yml", cwd=PROMETHEUS)


def test_every_rule_is_tested_quiet_and_speaking():
    tests = yaml.safe_load((PROMETHEUS / "alerts.test.yml").read_text())["tests"]
    cases = [case for test in tests for case in test["alert_rule_test"]]
    for rule in RULES:
        of_rule = [bool(case.get("exp_alerts")) for case in cases if case["alertname"] == rule["alert"]]
        assert set(of_rule) == {True, False}, rule["alert"]


def test_expressions_of_dashboards_are_promql(tmp_path):
    rules = [{"record": f"r{i}", "expr": expression} for i, (_, expression) in enumerate(EXPRESSIONS)]
    file = tmp_path / "rules.yml"
    file.write_text(yaml.safe_dump({"groups": [{"name": "dashboards", "rules": rules}]}))
    checked(tool("promtool"), "check", "rules", file)


@pytest.mark.parametrize(("where", "expression"), EXPRESSIONS, ids=[where for where, _ in EXPRESSIONS])
def test_expressions_ask_for_what_there_is(where, expression, figures):
    """Kills a figure or a label that is called otherwise: the panel would be empty and the alert silent."""
    outside = re.sub(r"\{[^}]*\}|by \([^)]*\)", "", expression)
    names = set(re.findall(r"\b(?:creak_|process_)\w+", outside))
    assert names or expression.startswith(PROVISIONED)
    assert names <= figures.keys()
    offered = {"job", "instance", "alertname"}.union(*(figures[name] for name in names))
    assert set(re.findall(r"(\w+)\s*(?:=~|!=|!~|=)\s*\"", expression)) <= offered
    for group in re.findall(r"by \(([^)]*)\)", expression):
        assert set(group.replace(" ", "").split(",")) <= offered


@pytest.mark.parametrize(("where", "target"), ROWS, ids=[where for where, _ in ROWS])
def test_rows_are_there_with_the_columns_that_are_shown(where, target, client):
    """Kills a path, a parameter or a column of another name, asked of the service itself."""

    def filled(text):
        for variable, value in VARIABLES.items():
            text = text.replace(variable, value)
        return text

    path = filled(target["url"])
    params = {item["key"]: filled(item["value"]) for item in target["url_options"]["params"]}
    document = client.get("/openapi.json").json()["paths"]
    known = {
        parameter["name"]
        for template, operations in document.items()
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", template), path)
        for parameter in operations["get"].get("parameters", [])
    }
    assert params.keys() <= known
    rows = get(client, path, **params)[target["root_selector"]]
    assert rows
    for column in target["columns"]:
        assert column["selector"] in rows[0]
        if column["type"] == "timestamp":
            assert rows[0][column["selector"]].endswith("Z")


def lost(given, kept, where=""):
    """Keys of a document that another does not have, and values that differ."""
    if isinstance(given, dict):
        for key, value in given.items():
            yield from lost(value, kept[key], f"{where}.{key}") if key in kept else (f"{where}.{key}",)
    elif isinstance(given, list):
        for index, pair in enumerate(zip(given, kept, strict=True)):
            yield from lost(*pair, f"{where}[{index}]")
    elif given != kept:
        yield where


@pytest.mark.parametrize("path", DASHBOARDS, ids=lambda path: path.stem)
def test_dashboards_are_understood_by_grafanas_own_schema(path):
    """Read and written again by Grafana's library, which drops what Grafana does not know."""
    register_default_plugins()
    dashboard = json.loads(path.read_text())
    assert list(lost(dashboard, json.loads(JSONEncoder().encode(Dashboard.from_json(dashboard))))) == []


def test_dashboards_use_the_data_sources_that_are_provisioned():
    provisioned = yaml.safe_load((DEPLOY / "grafana/provisioning/datasources/creak.yaml").read_text())
    sources = {(source["uid"], source["type"]) for source in provisioned["datasources"]}
    assert len(DASHBOARDS) == 3
    uids = set()
    for path in DASHBOARDS:
        dashboard = json.loads(path.read_text())
        uids.add(dashboard["uid"])
        for part in (*dashboard["panels"], *dashboard["templating"]["list"]):
            assert (part["datasource"]["uid"], part["datasource"]["type"]) in sources
        places = [panel["gridPos"] for panel in dashboard["panels"]]
        cells = [
            (x, y) for p in places for x in range(p["x"], p["x"] + p["w"]) for y in range(p["y"], p["y"] + p["h"])
        ]
        assert len(cells) == len(set(cells))  # no panel hides another
        assert max(x for x, _ in cells) < 24
    assert len(uids) == len(DASHBOARDS)
    home = COMPOSE["services"]["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"]
    provider = yaml.safe_load((DEPLOY / "grafana/provisioning/dashboards/creak.yaml").read_text())["providers"][0]
    assert home in {f"{provider['options']['path']}/{path.name}" for path in DASHBOARDS}


def test_the_compose_file_is_one(tmp_path):
    tool("podman", "docker")  # without which neither of the two says anything
    compose = tool("podman-compose", "docker-compose")
    seen = yaml.safe_load(checked(compose, "--file", ROOT / "docker-compose.yml", "config", cwd=ROOT))
    assert seen["services"].keys() == COMPOSE["services"].keys()


def test_the_compose_file_fits_together():
    """Kills a file that is mounted from nowhere, a published port, a service name that nobody has."""
    services = COMPOSE["services"]
    assert services.keys() >= {"creak", "postgres", "nats", "prometheus", "grafana"}
    for name, service in services.items():
        for volume in service.get("volumes", []):
            source = volume.partition(":")[0]
            assert (ROOT / source).exists() if source.startswith(".") else source in COMPOSE["volumes"], name
        for port in service.get("ports", []):
            assert port.startswith("127.0.0.1:"), name
        assert set(service.get("depends_on", {})) <= services.keys()
    scrape = yaml.safe_load((PROMETHEUS / "prometheus.yml").read_text())["scrape_configs"][0]
    port = load_service(DEPLOY / "container" / "creak.toml").server.port
    assert scrape["static_configs"] == [{"targets": [f"creak:{port}"]}]
    assert scrape["authorization"]["credentials_file"] == "/run/creak/key"


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_systemd_accepts_its_units(unit, tmp_path):
    creak = str(Path(sys.executable).with_name("creak"))
    copy = tmp_path / unit.name
    copy.write_text(
        unit.read_text().replace("/opt/creak/bin/creak", creak if Path(creak).exists() else "/usr/bin/true")
    )
    analyse = tool("systemd-analyze")
    assert checked(analyse, "verify", "--man=no", copy) == ""
    text = unit.read_text()
    assert "Type=notify" in text
    assert re.search(r"^WatchdogSec=\d+$", text, re.MULTILINE)
    # 0 is what a service may do least with, 10 all; without the hardening it is 9.6.
    checked(analyse, "security", "--offline=yes", "--no-pager", "--threshold=25", copy)
