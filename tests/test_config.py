"""Configuration: the contract's files, and one clear line for everything else."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from creak.config.rig import load_rig, parse_rig, rig_toml
from creak.config.service import load_service
from creak.errors import ConfigurationError
from creak.records import Node, Rig

RIG = """
name = "three-mass"
sample_rate = 5000.0
period_samples = 8192
transient_periods = 2
band = [5.0, 100.0]
grid = "full"
hold = "band-limited"
network = "dense"
[[nodes]]
name = "1"
input = "N"
output = "m"
[[nodes]]
name = "2"
output = "m/s"
"""


def test_the_rig_of_the_contract():
    rig = parse_rig(RIG, "rig.toml")
    assert (rig.n, rig.q, rig.driven, rig.square) == (2, 1, (0,), False)
    assert (rig.lines[0], rig.lines[-1]) == (9, 163)
    assert rig.nodes[1] == Node("2", "m/s", None)
    assert rig.network is None


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("sample_rate = 5000.0", "", ["sample_rate", "is missing"]),
        ("sample_rate = 5000.0", "sample_rate = -1.0", ["sample_rate", "-1.0", "greater than 0"]),
        ("sample_rate = 5000.0", "sample_rate = nan", ["sample_rate", "nan"]),
        ("8192", "8192.5", ["period_samples", "8192.5", "integer"]),
        ("transient_periods = 2", "transient_periods = -1", ["transient_periods", "-1"]),
        ("band =", "bandwidth =", ["bandwidth", "not a known key"]),
        ("[5.0, 100.0]", "[5.0, 3000.0]", ["band", "3000", "2500"]),
        ("[5.0, 100.0]", "[0.0, 100.0]", ["band", "0"]),
        ("[5.0, 100.0]", "[5.0, 5.1]", ["band", "no line", "0.61"]),
        ('"full"', '"even"', ["grid", "even", "full", "random-odd"]),
        ('"band-limited"', '"linear"', ["hold", "linear", "zero-order"]),
        ('"dense"', '"sparse"', ["network", "sparse", "dense"]),
        ('"dense"', '[["1", "7"]]', ["network", "'7'", "1, 2"]),
        ('"dense"', '[["1", "1"]]', ["network", "itself"]),
        ('name = "2"', 'name = "1"', ["nodes", "'1'", "twice"]),
        ('name = "2"', "name = 2", ["nodes[1].name", "quotes"]),
        ('name = "2"', 'name = "ground"', ["ground"]),
        ('input = "N"', "", ["none is driven"]),
        ('output = "m/s"', "", ["nodes[1].output", "is missing"]),
        ('output = "m/s"', 'output = "m/s"\nunit = "m"', ["nodes[1].unit", "not a known key"]),
        ("band = [5.0, 100.0]", "lines = [9, 10]", ["lines", "grid"]),
        ('band = [5.0, 100.0]\ngrid = "full"', "lines = [10, 9]", ["lines", "9", "rise"]),
        ('band = [5.0, 100.0]\ngrid = "full"', "lines = [9, 4096]", ["lines", "[4096]", "4095"]),
        ("sample_rate = 5000.0", "sample_rate = true", ["sample_rate", "True", "number"]),
        ("sample_rate = 5000.0", 'sample_rate = "5000"', ["sample_rate", "'5000'", "number"]),
        ("sample_rate = 5000.0", "sample_rate = 1e-9", ["sample_rate", "1e-09", "longer"]),
        ("8192", "99999999999999999999", ["period_samples", "99999999999999999999", "16777216"]),
        ("[[nodes]]", "[[nodes]", ["TOML", "line"]),
    ],
)
def test_a_wrong_rig_gets_one_line_with_file_key_and_what_is_allowed(old, new, words):
    assert old in RIG
    with pytest.raises(ConfigurationError) as caught:
        parse_rig(RIG.replace(old, new, 1), "some/rig.toml")
    line = str(caught.value)
    assert line.startswith("some/rig.toml: ")
    assert "\n" not in line
    for word in words:
        assert word in line


name = st.text(st.characters(codec="utf-8", exclude_characters="/\n\r", exclude_categories=("C", "Z")), min_size=1)


@given(
    st.lists(name.filter(lambda s: s != "ground" and len(s) <= 64), min_size=1, max_size=4, unique=True),
    st.floats(1.0, 1e6),
    st.sampled_from(["band-limited", "zero-order"]),
    st.booleans(),
)
def test_a_rig_survives_its_own_text(names, rate, hold, dense):
    """Kills a name or a float that is written so that it reads back differently."""
    rig = Rig(
        name=names[0],
        sample_rate=rate,
        period_samples=64,
        transient_periods=1,
        lines=(1, 5, 9),
        nodes=tuple(Node(n, "m", "N" if i == 0 else None) for i, n in enumerate(names)),
        hold=hold,
        network=None if dense or len(names) < 2 else ((names[0], names[1]),),
    )
    assert parse_rig(rig_toml(rig), "rig.toml") == rig


SERVICE = """
data = "var"
[server]
host = "127.0.0.1"
port = 8300
[store]
url = "sqlite:///var/creak.db"
[webhooks]
allow = ["10.20.0.0/16"]
[[rigs]]
rig = "rig.toml"
model = "model.toml"
[rigs.source]
kind = "simulated"
"""


@pytest.fixture
def service_file(tmp_path, monkeypatch):
    import os

    for key in os.environ:
        if key.upper().startswith("CREAK_"):
            monkeypatch.delenv(key)

    def write(text=SERVICE):
        path = tmp_path / "creak.toml"
        path.write_text(text)
        return path

    return write


def test_the_service_of_the_contract(service_file, tmp_path):
    settings = load_service(service_file())
    assert settings.server.port == 8300
    assert settings.data == tmp_path / "var"
    assert settings.store_url == f"sqlite:///{tmp_path}/var/creak.db"
    assert settings.rigs[0].model == tmp_path / "model.toml"


def test_the_environment_overrides_the_file(service_file, monkeypatch):
    """Kills a variable that is read as text where a list or a number is meant."""
    monkeypatch.setenv("CREAK_SERVER__PORT", "8400")
    monkeypatch.setenv("CREAK_WEBHOOKS__ALLOW", '["127.0.0.0/8"]')
    monkeypatch.setenv("CREAK_STREAM__URL", "tls://broker:4222")
    settings = load_service(service_file())
    assert settings.stream.url == "tls://broker:4222"
    assert (settings.server.port, settings.server.host) == (8400, "127.0.0.1")
    assert settings.webhooks.allow == ["127.0.0.0/8"]


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("CREAK_SERVER__PORT", "eighty", ["CREAK_SERVER__PORT", "server.port", "eighty"]),
        ("CREAK_SERVER__PRT", "1", ["CREAK_SERVER__PRT", "server.prt", "not a known key"]),
        ("CREAK_WEBHOOKS__ALLOW", '["here"]', ["CREAK_WEBHOOKS__ALLOW", "here"]),
        ("CREAK_WEBHOOKS__ALLOW", "here", ["CREAK_WEBHOOKS__ALLOW", "webhooks.allow", "'here'", "JSON"]),
    ],
)
def test_a_wrong_variable_is_named(service_file, monkeypatch, variable, value, words):
    monkeypatch.setenv(variable, value)
    with pytest.raises(ConfigurationError) as caught:
        load_service(service_file())
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("port = 8300", "port = 83000", ["server.port", "83000", "65535"]),
        ('kind = "simulated"', 'kind = "simulatd"', ["rigs[0].source.kind: 'simulatd'", "'simulated'"]),
        ('kind = "simulated"', 'kind = "simulated"\npace = -2', ["rigs[0].source.pace: -2", "greater than 0"]),
        ('kind = "simulated"', 'kind = "recording"\nfiles = []', ["rigs[0].source.files: [] is", "should have"]),
        ('kind = "simulated"', 'kind = "stream"\npace = 2', ["pace", "not a known key"]),
        ('data = "var"', 'data = "var"\nstream = {url = "http://here"}', ["stream.url", "http://here", "nats"]),
        ('data = "var"', 'data = "var"\nstream = {name = "a.b"}', ["stream.name", "a.b"]),
        ('data = "var"', 'data = "var"\nstream = {lease_seconds = 0.1}', ["stream.lease_seconds", "0.1"]),
        ('data = "var"', 'data = "var"\nstream = {send = "all"}', ["stream.send", "all", "sums"]),
        ('kind = "simulated"', 'kind = "simulated"\npase = 2', ["pase", "not a known key"]),
        ('model = "model.toml"', "", ["model", "simulated source needs one"]),
        ('model = "model.toml"', 'model = "m.toml"\nlimits = {windows = 2, exceeding = 3}', ["exceeding", "3"]),
        ('"10.20.0.0/16"', '"10.20.0.0/99"', ["webhooks.allow", "10.20.0.0/99"]),
        ('data = "var"', 'dta = "var"', ["dta", "not a known key"]),
    ],
)
def test_a_wrong_service_file_gets_one_line(service_file, old, new, words):
    assert old in SERVICE
    with pytest.raises(ConfigurationError) as caught:
        load_service(service_file(SERVICE.replace(old, new, 1)))
    line = str(caught.value)
    assert "creak.toml: " in line
    assert "\n" not in line
    for word in words:
        assert word in line


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(ConfigurationError, match=r"nowhere\.toml: cannot be read"):
        load_rig(tmp_path / "nowhere.toml")


def test_the_service_file_of_the_container_is_accepted(service_file):
    """Kills an image that is built but does not start."""
    settings = load_service(Path(__file__).parents[1] / "deploy" / "container" / "creak.toml")
    assert settings.data == Path("/var/lib/creak")
