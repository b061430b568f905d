"""The command as its users meet it: figures of the paper, and one line for whatever is wrong."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import two_masses
from creak.cli import run
from creak.sources.recording import Recording

EXAMPLES = Path(__file__).parents[1] / "deploy" / "examples"
THREE = EXAMPLES / "three-mass"

SMALL = {"rate": 256.0, "transient": 3, "band": (2.0, 60.0)}  # of two masses


@pytest.fixture
def small(tmp_path, monkeypatch):
    """A directory with a small rig and its model."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(two_masses.rig(**SMALL))
    (tmp_path / "model.toml").write_text(two_masses.model(20.0))
    return tmp_path


def replayed(capsys, *files):
    capsys.readouterr()
    assert run(["replay", "--json", *map(str, files)]) == 0
    return json.loads(capsys.readouterr().out)  # one JSON document and nothing else


def ratios(document, key="total_to_noise_db"):
    return [node[key] for node in document["nodes"]]


def test_the_papers_three_masses(tmp_path, capsys):
    """The paper's study: located at node 3, where the classical analysis shows all three nodes alike."""
    for name in ("model.toml", "model-linear.toml"):
        arguments = ["simulate", "--model", THREE / name, "--rig", THREE / "rig.toml", "--realisations", 10]
        arguments += ["--rms", 50, "--snr-db", 40, "--seed", 1, "--output", tmp_path / f"{name}.mcap"]
        assert run([str(a) for a in arguments]) == 0
    cubic = replayed(capsys, tmp_path / "model.toml.mcap")
    assert max(ratios(cubic)[:2]) < 0.5
    assert abs(ratios(cubic)[2] - 16) < 1
    assert all(26 <= r <= 29 for r in ratios(cubic, "classical_total_to_noise_db"))
    assert [node["alarm"] for node in cubic["nodes"]] == ["normal", "normal", "unacknowledged"]
    assert (cubic["frames"], cubic["experiments"], cubic["realisations"]) == (60, 30, 10)
    assert cubic["located"] is True
    linear = replayed(capsys, tmp_path / "model-linear.toml.mcap")
    for key in ("total_to_noise_db", "classical_total_to_noise_db"):
        assert max(abs(r) for r in ratios(linear, key)) < 0.5


def test_simulate_is_the_same_file_for_the_same_seed(small, capsys):
    """Kills a clock or a random number that leaks into a recording."""
    base = ["simulate", "--model", "model.toml", "--rig", "rig.toml", "--realisations", "2", "--snr-db", "40"]
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        assert run([*base, "--seed", seed, "--output", f"{name}.mcap"]) == 0
    a, b, c = ((small / f"{name}.mcap").read_bytes() for name in "abc")
    assert a == b
    assert a != c


def test_one_realisation_and_one_period_still_say_what_they_can(small, capsys):
    base = ["simulate", "--model", "model.toml", "--rig", "rig.toml", "--snr-db", "40", "--output", "a.mcap"]
    assert run([*base, "--realisations", "1"]) == 0
    one = replayed(capsys, "a.mcap")
    assert ratios(one) == [None, None]
    assert ratios(one, "noise_db") != [None, None]
    assert "two realisations" in one["unavailable"][0]
    assert run([*base, "--realisations", "3", "--steady-periods", "1"]) == 0
    assert "two steady periods" in replayed(capsys, "a.mcap")["unavailable"][0]


SIMULATE = ["simulate", "--model", "model.toml", "--rig", "rig.toml", "--output", "x.mcap"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["repaly"], ["repaly", "replay"]),
        (["replay"], ["Missing", "files"]),
        (["replay", "--jsn", "x.mcap"], ["--jsn", "--json"]),
        (["replay", "nowhere.mcap"], ["nowhere.mcap"]),
        (["replay", "rig.toml"], ["rig.toml"]),
        (["serve", "nowhere.toml"], ["nowhere.toml", "cannot be read"]),
        ([*SIMULATE, "--seed", str(2**63)], ["--seed", str(2**63)]),
        ([*SIMULATE, "--realisations", str(10**12)], ["--realisations", str(10**12)]),
        ([*SIMULATE, "--rms", "much"], ["--rms", "number"]),
        ([*SIMULATE, "--rms", "-1"], ["--rms", "-1"]),
        ([*SIMULATE, "--snr-db", "nan"], ["--snr-db", "nan"]),
        ([*SIMULATE, "--realisations", "0"], ["--realisations", "0"]),
        ([*SIMULATE, "--start", "yesterday"], ["--start", "yesterday", "ISO 8601"]),
        ([*SIMULATE[:-1], "nowhere/x.mcap"], ["nowhere", "directory"]),
        ([*SIMULATE[:-1], "."], ["directory"]),
        ([*SIMULATE[:-1], "/proc/x.mcap"], ["--output", "/proc/x.mcap", "cannot be written"]),
        (["simulate", "--model", "no.toml", "--rig", "rig.toml", "--output", "x.mcap"], ["no.toml"]),
        (["simulate", "--model", "rig.toml", "--rig", "rig.toml", "--output", "x.mcap"], ["rig.toml"]),
        (["import", "nowhere.npz", "--rig", "rig.toml", "--output", "x.mcap"], ["nowhere.npz"]),
    ],
)
def test_what_is_wrong_gets_one_line_and_exit_code_2(small, capsys, arguments, words):
    """Kills a traceback, a message of several lines, and a recording that was begun all the same."""
    assert run(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("creak: ")
    for word in words:
        assert word in captured.err
    assert {path.name for path in small.iterdir()} == {"rig.toml", "model.toml"}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('input = "N"', 'input = "A"', ["nodes[0].input", "'A'", "N"]),  # what force is an ampere?
        ('output = "m"', 'output = "mm"', ["nodes[0].output", "'mm'", "m/s"]),
        ('name = "2"', 'name = "7"', ["nodes[1].name", "'7'", "'1', '2'"]),
    ],
)
def test_a_rig_that_does_not_fit_the_model_is_refused(small, capsys, old, new, words):
    (small / "rig.toml").write_text(two_masses.rig(**SMALL).replace(old, new, 1))
    assert run(SIMULATE) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    for word in words:
        assert word in line


SERVED = """
[[rigs]]
rig = "rig.toml"
model = "model.toml"
[rigs.source]
kind = "recording"
files = ["x.mcap"]
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"rig.toml"', '"no.toml"', ["creak.toml: rigs[0].rig", "no.toml"]),
        ('"model.toml"', '"no.toml"', ["creak.toml: rigs[0].model", "no.toml"]),
        ('"model.toml"', '"rig.toml"', ["rig.toml: kind", "missing"]),
        ('"x.mcap"', '"no.mcap"', ["creak.toml: rigs[0].source.files[0]", "no.mcap"]),
    ],
)
def test_a_file_that_a_service_file_names_is_looked_for_at_once(small, capsys, old, new, words):
    """Kills a model that is found missing at the first diagnosis."""
    assert run([*SIMULATE, "--realisations", "1"]) == 0
    capsys.readouterr()
    (small / "creak.toml").write_text(SERVED.replace(old, new, 1))
    assert run(["serve", "creak.toml"]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    for word in words:
        assert word in line


def test_no_command_is_told_so(capsys):
    assert run([]) == 2
    captured = capsys.readouterr()
    assert "simulate" in captured.out
    assert captured.err == "creak: a command is missing; those above are allowed\n"


INTERRUPTING = """
import sys
class Interrupting:
    def find_spec(self, name, *rest):
        if name == "creak.cli.commands":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupting())
from creak.__main__ import main
main()
"""


def test_an_interrupt_is_one_line_even_while_modules_are_imported():
    """Kills the traceback of a Ctrl-C in the first second."""
    told = subprocess.run([sys.executable, "-c", INTERRUPTING], capture_output=True, text=True, check=False)
    assert (told.returncode, told.stdout, told.stderr) == (130, "", "creak: interrupted\n")


def test_an_interrupt_of_a_command_is_one_line(small, capsys, monkeypatch):
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("creak.cli.recordings.load_rig", interrupted)
    assert run(SIMULATE) == 130
    assert capsys.readouterr().err == "creak: interrupted\n"


def test_an_ascii_terminal_gets_its_tables(small):
    """Kills the traceback of a character that the terminal's encoding lacks."""
    assert run([*SIMULATE, "--realisations", "2", "--snr-db", "40"]) == 0
    told = subprocess.run(
        [sys.executable, "-m", "creak", "replay", "x.mcap"],
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
        capture_output=True,
        check=False,
    )
    assert (told.returncode, told.stderr) == (0, b"")
    assert b"8 frames of 2 realisations" in told.stdout


def test_a_failed_run_leaves_no_recording(small, capsys):
    """Kills a half-written file: a motion that grows without bound is found in the middle of the run."""
    unstable = (
        two_masses.model(20.0) + '[[effects]]\neffect = "damping"\nat = ["2", "ground"]\ncoefficient = -500.0\n'
    )
    (small / "unstable.toml").write_text(unstable)
    arguments = ["simulate", "--model", "unstable.toml", "--rig", "rig.toml", "--realisations", "2"]
    assert run([*arguments, "--output", "x.mcap"]) in (1, 2)
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(small.glob("*.mcap"))
    assert not list(small.glob(".*.part"))


def test_a_cut_recording_says_so(small, capsys):
    assert run([*SIMULATE, "--realisations", "3", "--snr-db", "40"]) == 0
    whole = (small / "x.mcap").read_bytes()
    (small / "cut.mcap").write_bytes(whole[: len(whole) * 2 // 3])
    document = replayed(capsys, "cut.mcap")
    assert document["truncated"] is True
    assert 0 < document["realisations"] < 3
    assert document["frames"] == document["realisations"] * 4
    (small / "cut.mcap").write_bytes(whole[:-1])
    assert run(["replay", "cut.mcap", "--json"]) == 0
    captured = capsys.readouterr()
    assert json.loads(captured.out)["truncated"] is True
    assert (
        captured.err == "creak: cut.mcap: has no end: it was cut after a whole chunk, or is still being written\n"
    )


def test_start_sets_the_recorded_time(small):
    assert run([*SIMULATE, "--realisations", "1", "--start", "2026-05-01T08:30:00Z"]) == 0
    frames = list(Recording(small / "x.mcap").frames())
    assert frames[0].time == 1777624200 * 10**9
    assert frames[1].time - frames[0].time == 10**9


DATA = Path(__file__).parents[2] / "shared" / "data"


def imported(example, files, tmp_path, capsys):
    """Reorder, import and replay as the README of an example says."""
    missing = [file for file in files if not (DATA / file).exists()]
    if missing:
        absent = f"{DATA / missing[0]} is absent"
        pytest.fail(absent) if os.environ.get("CI") == "true" else pytest.skip(absent)
    arguments = [EXAMPLES / example / "reorder.py", *(DATA / file for file in files), tmp_path / "measured.npz"]
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
    arguments = ["import", tmp_path / "measured.npz", "--rig", EXAMPLES / example / "rig.toml"]
    assert run([*map(str, arguments), "--output", str(tmp_path / "x.mcap")]) == 0
    return replayed(capsys, tmp_path / "x.mcap")


def test_the_fine_steering_mirror_has_three_hysteretic_actuators(tmp_path, capsys):
    files = [f"fine-steering-mirror/{name}_300mV_train.npy" for name in "uy"]
    document = imported("fine-steering-mirror", files, tmp_path, capsys)
    assert ratios(document) == pytest.approx([15.5, 15.0, 12.1], abs=0.1)
    assert ratios(document, "classical_total_to_noise_db") == pytest.approx([13.4, 11.5, 13.1], abs=0.1)
    assert (document["frames"], document["realisations"], document["located"]) == (12, 2, True)


def test_the_two_mass_bench_has_one_input_and_is_not_located(tmp_path, capsys):
    document = imported("two-mass-bench", ["two-mass-bench/MultisineTypeB.mat"], tmp_path, capsys)
    assert document["located"] is False
    assert ratios(document, "noise_db") == [None, None]
    assert ratios(document, "classical_noise_db") == pytest.approx([-35.1, -35.2], abs=0.1)
    assert document["frames"] == 19


def test_benchmarks_are_listed_and_run(capsys):
    """Kills a benchmark that nobody runs any more."""
    assert run(["bench"]) == 0
    assert "estimator" in capsys.readouterr().out
    assert run(["bench", "estimatr"]) == 2
    assert "estimator" in capsys.readouterr().err
    done = subprocess.run(
        [sys.executable, "-m", "creak.cli", "bench", "replay", "--json", "--realisations=2", "--repetitions=1"],
        capture_output=True,
        check=True,
        text=True,
    )
    assert {"bare reader", "replay"} < {row["what"] for row in json.loads(done.stdout)["rows"]}
