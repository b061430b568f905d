"""What a CAN source must say when its DBC, its signals or its bus will not do: one clear line each."""

import pytest

import can_rigs
from conftest import make_rig, make_run
from creak.cli import run as creak
from creak.config.service import parse_service
from creak.errors import ConfigurationError
from creak.sources.can_load import frame_seconds

RUN = make_run(make_rig(2, samples=64, lines=range(2, 10)))
GOOD = can_rigs.one_frame(2)


@pytest.mark.parametrize(
    ("text", "signals", "keys", "problem"),
    [
        (GOOD, {"inputs": {"1": "Samples.F"}}, {}, r"inputs\.1: 'Samples\.F': message 'Samples' of .* no signal"),
        (GOOD, {"responses": {"9": "Samples.Y_1_{}"}}, {}, r"signals\.responses: '9' is no node"),
        (GOOD, {"responses": {"1": "Samples.Y_2_{}"}}, {}, r"Samples\.Y_2_0 is named for two channels"),
        (GOOD, {"responses": {"1": "Samples.Y_1_0"}}, {}, r"Samples\.Y_1_0 has 1 samples in a frame, .* has 4"),
        (GOOD, {"period": "Samples.Period"}, {}, r"experiment: is missing"),
        (GOOD.replace("Counter", "Zaehler"), {}, {}, r"has no signal called 'Counter'"),
        (can_rigs.one_frame(2, counter_bits=5, crc=0), {}, {}, r"wraps after 32 samples, .* 64 ends: too short"),
        (GOOD, {"wraps": 1000}, {}, r"wraps after 1000 samples, which is no whole number of periods \(64"),
        (can_rigs.one_frame(2, counter_bits=16).replace("Realisation", "R"), {}, {}, r"or name markers"),
        (GOOD.replace(" U_", " I_"), {}, {}, r"rig\.dbc: cannot be analysed: no signal is an input"),
        (GOOD, {}, {"fd": False}, r"source\.fd: is false, but message 'Samples' is longer than 8 bytes"),
        (GOOD, {"checksum": ["Samples.Period"]}, {}, r"checksum: Samples\.Period: should be 8, 16 or 32 bits"),
    ],
)  # fmt: skip
def test_one_line_says_what_is_wrong(text, signals, keys, problem, tmp_path):
    with pytest.raises((ConfigurationError, ValueError), match=problem) as found:
        can_rigs.mapping(tmp_path, RUN, text, signals, **keys)
    if isinstance(found.value, ConfigurationError):
        assert "\n" not in str(found.value)


def test_a_rate_that_the_bus_cannot_carry_is_refused_with_how_much(tmp_path):
    """64 Hz, two messages a sample: 64 x 135 bits at most with 11 bits of identifier, 64 x 160 with 29."""
    text, signals = can_rigs.LAYOUTS["sync"]
    with pytest.raises(ConfigurationError, match=r"bitrate: 128 frames a second need \d+% .*: \d+% over") as found:
        can_rigs.mapping(tmp_path, RUN, text(2), signals, bitrate=10_000, fd=False)
    standard = frame_seconds(8, extended=False, fd=False, bitrate=1, data_bitrate=1)
    extended = frame_seconds(8, extended=True, fd=False, bitrate=1, data_bitrate=1)
    assert (standard, extended) == (135, 160)  # the figures of R. I. Davis et al.
    assert f"{64 * (standard + extended) / 10_000:.0%}" in str(found.value)
    can_rigs.mapping(tmp_path, RUN, text(2), signals, bitrate=20_000, fd=False)


@pytest.mark.parametrize(
    ("interface", "problem"),
    [
        (
            'interface = "socketcan"\nchannel = "can97"',
            "source.channel: 'can97' of socketcan cannot be opened",
        ),
        ('interface = "carrier"\nchannel = "x"', "rigs[0].source.interface: 'carrier' is not allowed"),
        ('channel = "x"', "rigs[0].source: interface: give either"),
        ('logs = ["no.blf"]', "no.blf: cannot be read: No such file or directory"),
        ('logs = ["no.csv"]', "no.csv: suffix .csv, expected one of .blf"),
    ],
)
def test_an_interface_or_a_log_that_does_not_exist(interface, problem, tmp_path, capsys):
    from creak.config.rig import rig_toml

    (tmp_path / "rig.toml").write_text(rig_toml(RUN.rig))
    (tmp_path / "rig.dbc").write_text(GOOD)
    (tmp_path / "creak.toml").write_text(
        'data = "var"\n[[rigs]]\nrig = "rig.toml"\n[rigs.source]\nkind = "can"\ndbc = "rig.dbc"\nfd = true\n'
        + interface
    )
    assert creak(["serve", str(tmp_path / "creak.toml")]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert problem in err
    assert not (tmp_path / "var").exists()


def test_paths_count_from_the_service_file(tmp_path):
    tables = {"rigs": [{"rig": "r.toml", "source": {"kind": "can", "dbc": "a.dbc", "logs": ["x.blf"]}}]}
    source = parse_service(tables, "creak.toml", tmp_path).rigs[0].source
    assert (source.dbc, source.logs) == (tmp_path / "a.dbc", [tmp_path / "x.blf"])


def test_the_beams_files_fit_together():
    """Kills a DBC, a service file or a firmware text that the service would refuse, or whose figures are wrong."""
    from pathlib import Path

    from creak.config.rig import load_rig
    from creak.config.service import load_service
    from creak.sources.can_frames import checksum
    from creak.sources.can_mapping import map_signals
    from creak.sources.can_sources import can_run
    from creak.sources.dbc import Database

    folder = Path(__file__).parents[1] / "deploy" / "can"
    table = load_service(folder / "creak.toml").rigs[0]
    run = can_run(table.source, load_rig(table.rig))
    given = map_signals(Database(table.source.dbc), table.source, run, "creak.toml", "source")
    bare = table.source.model_copy(update={"signals": type(table.source.signals)()})
    assert map_signals(Database(table.source.dbc), bare, run, "creak.toml", "source") == given
    assert [part.samples for part in given.parts] == [4]
    load = 1024 * frame_seconds(64, extended=False, fd=True, bitrate=5e5, data_bitrate=2e6)
    assert f"{load:.0%}" == "42%"
    assert checksum(b"123456789", 32) == 0xCBF43926
    assert checksum(b"123456789", 16) == 0x29B1
    assert checksum(b"123456789", 8) == 0x4B
