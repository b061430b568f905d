"""Models of kind ``frf``: a measured response stands for the structure, and a diagnosis tells what has changed."""

import json

import numpy as np
import pytest

import gap_rig
from creak.cli import run
from creak.config.model import load_model
from creak.errors import ConfigurationError, MeasurementError
from creak.gap.diagnose import diagnose
from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.reference import measure, widened
from creak.mechanics.effects import (
    GROUND,
    CoulombFriction,
    CubicStiffness,
    Damping,
    Mass,
    Resonator,
    Stiffness,
)
from creak.mechanics.response import Response
from creak.mechanics.steady import simulate_steady
from creak.mechanics.structure import MeasuredResponse
from creak.mechanics.system import assemble
from creak.records import Node, Rig
from gap_recordings import CHAIN, RIG, recording, rig_of

LINEAR = (
    Stiffness(("1", "2"), 4e3),
    Damping(("3", GROUND), 12.0),
    Mass(("2", GROUND), 0.15),
    Resonator(("3",), 0.2, 30.0, 0.03),
)
OUTPUTS = [("m", "band-limited"), ("m/s", "band-limited"), ("m/s^2", "band-limited"), ("m", "zero-order")]


def exact(rig):
    """The chain's response as a recording without noise would hold it."""
    hold = 1.0
    if rig.hold == "zero-order":
        turn = np.pi * rig.frequencies / rig.sample_rate
        hold = (np.exp(-1j * turn) * np.sinc(turn / np.pi))[:, None, None]
    S = assemble(CHAIN, rig).response(rig.frequencies) * hold
    none = np.zeros((rig.period_samples // 2 + 1, rig.n))
    return Response(rig, S, none, none, np.tile(np.eye(rig.q), (len(S), 1, 1)))


@pytest.mark.parametrize(("output", "hold"), OUTPUTS)
def test_linear_effects_on_a_measured_structure_are_those_on_the_structure(output, hold):
    """(1 + S dZ)^-1 S is exact: line by line the same as springs, dampers and resonators on the matrices."""
    rig = rig_of(output, hold)
    measured = assemble(MeasuredResponse("x", LINEAR, response=exact(rig)), rig)
    known = assemble(apply(CHAIN, Hypothesis(LINEAR)), rig)
    for loads, others in ((measured.outputs.T, known.outputs.T), (measured.inputs, known.inputs)):
        ours = measured.receptance(rig.frequencies, loads)
        theirs = known.receptance(rig.frequencies, others)
        if loads is measured.inputs and hold == "zero-order":
            turn = np.pi * rig.frequencies / rig.sample_rate
            theirs = theirs * (np.exp(-1j * turn) * np.sinc(turn / np.pi))[:, None, None]
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


def test_beyond_the_band_a_structure_of_masses_goes_on_as_it_is():
    """Between driven masses Z = K + s C + s^2 M everywhere, so DC and harmonics above the band are exact."""
    frequencies = np.array([0.0, 1.0, 150.0, 450.0, 900.0])
    measured = assemble(MeasuredResponse("x", response=exact(RIG)), RIG)
    known = assemble(CHAIN, RIG)
    theirs = known.receptance(frequencies, known.outputs.T)
    np.testing.assert_allclose(
        measured.receptance(frequencies, measured.outputs.T), theirs, rtol=1e-6, atol=1e-6 * np.abs(theirs).max()
    )


def test_a_nonlinear_effect_on_a_measured_structure_moves_it_as_the_structure():
    """The harmonic solver on the measured response: harmonics, mean and memory as with the matrices."""
    effects = (CubicStiffness(("3", GROUND), 3e8), CoulombFriction(("1", "2"), 5.0, 0.02))
    rng = np.random.default_rng(3)
    u = np.zeros((2, 3, RIG.period_samples // 2 + 1), complex)
    u[..., list(RIG.lines)] = np.exp(2j * np.pi * rng.random((2, 3, len(RIG.lines))))
    u = 50 * np.fft.irfft(u) / np.fft.irfft(u).std()
    ours, theirs = (
        simulate_steady(assemble(model, RIG), u, RIG.sample_rate, RIG.hold, oversampling=4).y
        for model in (MeasuredResponse("x", effects, response=exact(RIG)), apply(CHAIN, Hypothesis(effects)))
    )
    assert np.std(ours - theirs) < 1e-5 * np.std(theirs)  # between: the solver's tolerance, and continuation


@pytest.fixture(scope="module")
def reference():
    return MeasuredResponse("healthy", response=measure(RIG, recording(realisations=4, seed=7)))


@pytest.mark.parametrize(
    "effect",
    [
        None,
        CubicStiffness(("3", GROUND), 3e8),
        Stiffness(("2", "3"), -5e3),
    ],
)
def test_what_has_changed_since_is_named_with_its_place(reference, effect):
    """Kills a reference whose own noise is taken for a change, and one on which laws are judged elsewhere."""
    data = recording(() if effect is None else (effect,), realisations=5)
    found = diagnose(RIG, reference, data)
    if effect is None:
        assert found.verdict == "no_gap"
        return
    assert found.verdict == "explained"
    (cause,) = found.causes
    assert (cause.effect, cause.at) == (effect.effect, effect.at)
    for name, value in effect.parameters().items():
        assert abs(cause.parameters[name] - value) < 5 * cause.standard_errors[name]
        assert cause.standard_errors[name] < 1e-3 * abs(value)  # 40 dB, 12 experiments, 195 lines


def test_the_distortion_that_a_machine_always_had_is_no_change():
    """A healthy machine that is a little nonlinear: its own level is not held against it, a greater one is."""
    slight, more = CubicStiffness(("3", GROUND), 1e7), CubicStiffness(("3", GROUND), 2e8)
    model = MeasuredResponse("healthy", response=measure(RIG, recording((slight,), realisations=8, seed=7)))
    assert diagnose(RIG, model, recording((slight,), realisations=5)).verdict == "no_gap"
    (cause,) = diagnose(RIG, model, recording((more,), realisations=5)).causes
    assert (cause.effect, cause.at) == ("cubic_stiffness", ("3", GROUND))


def test_units_that_are_no_motion_are_diagnosed_too(reference):
    """Volts per volt: the coefficient is then in the input's unit over the output's, cubed."""
    data = recording((CubicStiffness(("3", GROUND), 3e8),), realisations=5)
    rig = Rig(**{**vars(RIG), "nodes": tuple(Node(node.name, "V", "V") for node in RIG.nodes)})
    healthy = reference.response
    model = MeasuredResponse(
        "x", response=Response(rig, healthy.S, healthy.variance, healthy.distortion, healthy.leverage)
    )
    (cause,) = diagnose(rig, model, data).causes
    assert (cause.effect, cause.parameters["coefficient"]) == ("cubic_stiffness", pytest.approx(3e8, rel=0.01))


def test_the_variance_of_a_change_is_stated_with_that_of_the_reference():
    """Over seeds the whitened difference of two healthy recordings is 1: the reference's noise counts."""
    power = []
    for seed in range(4):
        model = MeasuredResponse("x", response=measure(RIG, recording(realisations=2, seed=seed)))
        data = widened(RIG, model, recording(realisations=3, seed=100 + seed))
        U = np.fft.rfft(data.u)[..., list(RIG.lines)].transpose(2, 0, 1) / RIG.period_samples
        rest = data.Y[:, list(RIG.lines)].transpose(1, 0, 2) - U @ model.response.S.transpose(0, 2, 1)
        power.append(np.mean(np.abs(rest) ** 2 / data.variance[list(RIG.lines), None]))
    # 195 lines, 3 nodes: 3 % each by chance; variances of few periods put the mean up to 10 % above 1.
    assert 0.93 < np.mean(power) < 1.15


def test_what_cannot_be_a_reference():
    other = Rig(**{**vars(RIG), "period_samples": 1024})
    with pytest.raises(
        ConfigurationError, match="period_samples: 1024 is not that of the model's recording, 2048"
    ):
        assemble(MeasuredResponse("x", response=exact(RIG)), other)
    still = Rig(**{**vars(RIG), "nodes": (*RIG.nodes[:2], Node("3", "m"))})
    held = exact(RIG)
    with pytest.raises(ConfigurationError, match="'3' has no input"):
        assemble(
            MeasuredResponse(
                "x",
                (CubicStiffness(("3", GROUND), 1.0),),
                response=Response(
                    still, held.S[..., :2], held.variance, held.distortion, held.leverage[:, :2, :2]
                ),
            ),
            still,
        )
    data = recording(realisations=1)
    alike = type(data)(**{**vars(data), "u": np.repeat(data.u[:1], 3, axis=0)})
    with pytest.raises(MeasurementError, match="do not tell the inputs apart at line 10"):
        measure(RIG, alike)


def test_from_a_healthy_recording_to_the_cause_by_two_commands(tmp_path, monkeypatch, capsys):
    """The commands, a file between them in another folder, the corrected model, and the short way."""
    gap_rig.write(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert run(gap_rig.simulate("healthy.mcap", model="model.toml", seed=5)) == 0
    assert run(gap_rig.simulate("today.mcap")) == 0
    (tmp_path / "models").mkdir()
    assert run(["model", "healthy.mcap", "--output", "models/healthy.toml"]) == 0
    assert load_model(tmp_path / "models/healthy.toml") == MeasuredResponse("../healthy.mcap")
    capsys.readouterr()

    def diagnosed(*words):
        assert run(["diagnose", "today.mcap", "--json", *words]) == 0
        return json.loads(capsys.readouterr().out)

    by_file = diagnosed("--model", "models/healthy.toml", "--save-model", "today.toml")
    assert by_file["verdict"] == "explained"
    (cause,) = by_file["causes"]
    assert (cause["effect"], cause["at"]) == ("cubic_stiffness", ["2", "ground"])
    assert cause["parameters"]["coefficient"] == pytest.approx(gap_rig.COEFFICIENT, rel=0.02)
    assert diagnosed("--model", "today.toml")["verdict"] == "no_gap"
    assert diagnosed("--healthy", "today.mcap", "--last-healthy", "2")["verdict"] == "no_gap"
    assert run(["diagnose", "today.mcap"]) == 2
    assert "give a model file, or a healthy recording with --healthy" in capsys.readouterr().err
    (tmp_path / "models/healthy.toml").write_text('kind = "frf"\nrecording = "gone.mcap"\n')
    assert run(["diagnose", "today.mcap", "--model", "models/healthy.toml"]) == 2
    assert "models/healthy.toml: recording: 'gone.mcap' is not there" in capsys.readouterr().err
