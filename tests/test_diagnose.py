"""``creak diagnose`` as its users meet it: the document, the words, the files, and one line for what is wrong."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import gap_rig
from creak.cli import run
from creak.config.model import load_model

THREE = Path(__file__).parents[1] / "deploy" / "examples" / "three-mass"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A directory with a small rig, its model, and recordings of a truth with a cubic spring and of the model."""
    place = tmp_path_factory.mktemp("gap")
    gap_rig.write(place)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert run(gap_rig.simulate("truth.mcap")) == 0
        assert run(gap_rig.simulate("loud.mcap", rms=40, realisations=3, seed=2)) == 0
        assert run(gap_rig.simulate("healthy.mcap", model="model.toml")) == 0
        assert run(gap_rig.simulate("one.mcap", realisations=1)) == 0
    return place


@pytest.fixture
def place(made, monkeypatch):
    monkeypatch.chdir(made)
    return made


def diagnosed(capsys, *words):
    capsys.readouterr()
    assert run(["diagnose", "--json", *map(str, words)]) == 0
    captured = capsys.readouterr()
    return json.loads(captured.out)  # one JSON document and nothing else


def only_cause(document):
    (cause,) = document["causes"]
    return cause["effect"], sorted(cause["at"])


def test_the_missing_spring_is_found_and_the_corrected_model_has_no_gap(place, capsys):
    """What the command is for, from recording to corrected model, in its document, report and words."""
    words = ("truth.mcap", "--model", "model.toml")
    files = ("--report", "gap.html", "--save-model", "better.toml")
    document = diagnosed(capsys, *words, *files)
    assert document["verdict"] == "explained"
    assert only_cause(document) == ("cubic_stiffness", ["2", "ground"])
    (cause,) = document["causes"]
    assert cause["parameters"]["coefficient"] == pytest.approx(gap_rig.COEFFICIENT, rel=0.02)
    assert sorted(document["where"][0]["at"]) == ["2", "ground"]
    assert document["gap"]["closed"] > 0.995
    assert document["gap"]["after_db"] <= document["gap"]["noise_db"] + 1
    assert document["held_out_realisations"] >= 1
    for node in document["nodes"]:
        assert node["linear_share"] + node["nonlinear_share"] + node["noise_share"] == pytest.approx(1)
    assert document["validation"] is None
    (curve,) = document["curves"]
    force, fitted = np.array(curve["force"]), np.array(curve["fitted"])
    assert np.var(force - fitted) < 0.15 * np.var(force)  # the law lies over the measurement, but for its noise
    page = (place / "gap.html").read_text()
    assert "Verdict: explained" in page
    assert "a cubic spring between node 2 and ground" in page
    (spring,) = load_model(place / "better.toml").effects
    assert spring.coefficient == pytest.approx(cause["parameters"]["coefficient"], rel=1e-9)
    again = diagnosed(capsys, "truth.mcap", "--model", "better.toml")
    assert (again["verdict"], again["causes"], again["gap"]["closed"]) == ("no_gap", [], None)


def test_it_holds_at_another_amplitude(place, capsys):
    """A spring of the right kind does; the report and the document say so."""
    words = ("truth.mcap", "--model", "model.toml", "--validate", "loud.mcap", "--report", "holds.html")
    document = diagnosed(capsys, *words)
    assert document["validation"]["holds"] is True
    assert document["validation"]["gap"]["after_db"] < document["validation"]["gap"]["before_db"] - 10
    assert document["validation"]["conclusion"] in (place / "holds.html").read_text()


def test_without_gap_it_says_so_in_words(place, capsys):
    capsys.readouterr()
    assert run(["diagnose", "healthy.mcap", "--model", "model.toml"]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("verdict: no gap\n")
    assert "agree within noise" in captured.out
    assert captured.err == ""  # no progress where there is no terminal


def test_one_realisation_says_what_is_not_claimed(place, capsys):
    """There is nothing to hold out, so nothing is proven; that is said and not passed over."""
    document = diagnosed(capsys, "one.mcap", "--model", "model.toml")
    assert document["held_out_realisations"] == 0
    assert "aside" in " ".join(document["not_claimed"])


def test_some_realisations_alone(place, capsys):
    document = diagnosed(
        capsys, "truth.mcap", "--model", "truth.toml", "--first-realisation", 1, "--last-realisation", 3
    )
    assert document["verdict"] == "no_gap"
    assert document["held_out_realisations"] < 3


BEFORE = {"rig.toml", "model.toml", "truth.toml"}
OTHER_NODES = gap_rig.MODEL.replace('"2"', '"end"')
UNSTABLE = gap_rig.MODEL + '[[effects]]\neffect = "damping"\nat = ["2", "ground"]\ncoefficient = -500.0\n'
OTHER_RIG = gap_rig.RIG.replace("1024.0", "2048.0")
IN_VOLTS = gap_rig.RIG.replace('output = "m"', 'output = "V"')


@pytest.fixture
def refused(place, tmp_path, capsys):
    """Gives what a refused command says, in a directory that the refusal leaves as it was."""

    def refuse(*words):
        before = {path.name for path in place.iterdir()}
        capsys.readouterr()
        assert run(["diagnose", *map(str, words)]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert captured.err.count("\n") == 1
        assert captured.err.startswith("creak: ")
        assert {path.name for path in place.iterdir()} == before
        return captured.err

    return refuse


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["truth.mcap"], ["--model"]),
        (["nowhere.mcap", "--model", "model.toml"], ["nowhere.mcap"]),
        (["truth.mcap", "--model", "nowhere.toml"], ["nowhere.toml"]),
        (["rig.toml", "--model", "model.toml"], ["rig.toml"]),
        (["truth.mcap", "--model", "rig.toml"], ["rig.toml", "kind"]),
        (["truth.mcap", "--model", "model.toml", "--report", "nowhere/x.html"], ["--report", "nowhere"]),
        (["truth.mcap", "--model", "model.toml", "--save-model", "."], ["--save-model", "directory"]),
        (["truth.mcap", "--model", "model.toml", "--validate", "nowhere.mcap"], ["nowhere.mcap"]),
        (["truth.mcap", "--model", "model.toml", "--first-realisation", "-1"], ["--first-realisation", "-1"]),
        (
            ["truth.mcap", "--model", "model.toml", "--first-realisation", "3", "--last-realisation", "2"],
            ["--last-realisation", "2"],
        ),
        (["truth.mcap", "--model", "model.toml", "--first-realisation", "99"], ["truth.mcap", "99"]),
    ],
)
def test_what_is_wrong_gets_one_line(refused, words, said):
    line = refused(*words)
    for word in said:
        assert word in line


def test_a_model_that_does_not_fit_is_refused_by_name(refused, tmp_path):
    """Kills a message that names neither file nor node, and a report that is begun all the same."""
    for name, text, said in (("nodes", OTHER_NODES, "'2' is not in the model"), ("unstable", UNSTABLE, "stable")):
        path = tmp_path / f"{name}.toml"
        path.write_text(text)
        line = refused("truth.mcap", "--model", path, "--report", "x.html", "--save-model", "x.toml")
        assert f"{name}.toml" in line
        assert said in line


def test_units_that_no_model_has_are_refused(refused, tmp_path):
    path = tmp_path / "volts.toml"
    path.write_text(IN_VOLTS)
    samples = tmp_path / "u.npz"
    _measurement(samples)
    assert run(["import", str(samples), "--rig", str(path), "--output", str(tmp_path / "volts.mcap")]) == 0
    line = refused(tmp_path / "volts.mcap", "--model", "model.toml")
    for word in ("volts.mcap", "nodes[0].output", "'V'"):
        assert word in line


def test_a_validation_of_another_rig_is_refused(refused, tmp_path):
    path = tmp_path / "faster.toml"
    path.write_text(OTHER_RIG)
    words = gap_rig.simulate(str(tmp_path / "faster.mcap"), realisations=1)
    words[words.index("rig.toml")] = str(path)
    assert run(words) == 0
    line = refused("truth.mcap", "--model", "model.toml", "--validate", tmp_path / "faster.mcap")
    assert "another rig" in line
    assert "faster.mcap" in line


def test_progress_is_told_to_a_program_that_asks(place, tmp_path):
    """Kills progress that goes backwards or never reaches the end; a service shows it to those who wait."""
    with (tmp_path / "progress").open("w+") as lines:
        words = ["diagnose", "healthy.mcap", "--model", "model.toml", "--progress-fd", str(_duplicate(lines))]
        assert run(words) == 0
        lines.seek(0)
        told = [line.split("\t") for line in lines.read().splitlines()]
    shares = [float(share) for share, _ in told]
    assert shares == sorted(shares)
    assert 0 <= shares[0] <= shares[-1] <= 1
    assert told[0][1].startswith("reading realisation 0")


def _duplicate(file):
    return os.dup(file.fileno())


def _measurement(path):
    rng = np.random.default_rng(1)
    u = np.tile(rng.standard_normal((4, 2, 1024)), 5)
    np.savez(path, u=u, y=u + 0.01 * rng.standard_normal(u.shape))


def test_the_three_masses(tmp_path, capsys):
    """The worked example: the model without the spring against a recording made with it."""
    recording = str(tmp_path / "x.mcap")
    words = [
        "simulate",
        "--model",
        str(THREE / "model.toml"),
        "--rig",
        str(THREE / "rig.toml"),
        "--output",
        recording,
    ]
    assert run([*words, "--realisations", "6", "--rms", "50", "--snr-db", "40", "--seed", "1"]) == 0
    document = diagnosed(capsys, recording, "--model", THREE / "model-linear.toml")
    assert document["verdict"] == "explained"
    assert only_cause(document) == ("cubic_stiffness", ["3", "ground"])
    assert document["causes"][0]["parameters"]["coefficient"] == pytest.approx(1e8, rel=0.01)
