"""The beam: against the analytic solution, its reduction, and the rig that the examples describe."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.errors import ConfigurationError
from creak.mechanics.beam import Beam, Station
from creak.mechanics.system import assemble

EXAMPLE = Path(__file__).parents[1] / "deploy" / "examples" / "beam"
PLAIN = Beam(0.5, 0.02, 0.002, 2.1e11, 7850.0, 0.01, 24, (Station("1", 0.2, actuator=True, sensor=True),))


def natural_frequencies(body):
    return np.sqrt(np.maximum(eigh(body.stiffness, body.mass, eigvals_only=True), 0)) / (2 * np.pi)


def poles(body):
    """Undamped frequency and damping ratio of every oscillating mode, slowest first."""
    size = len(body.mass)
    inverse = np.linalg.inv(body.mass)
    state = np.block(
        [[np.zeros((size, size)), np.eye(size)], [-inverse @ body.stiffness, -inverse @ body.damping]]
    )
    roots = np.linalg.eigvals(state)
    roots = roots[roots.imag > 0]
    roots = roots[np.argsort(np.abs(roots))]
    return np.abs(roots) / (2 * np.pi), -roots.real / np.abs(roots)


def test_free_beam_has_the_frequencies_of_the_textbook():
    """Free-free Euler-Bernoulli: (βL)² / (2π L²) √(EI/ρA), βL = 4.730, 7.853, 10.996, after two free motions."""
    found = natural_frequencies(PLAIN.full())
    wave = np.array([4.730041, 7.853205, 10.995608])
    expected = wave**2 / (2 * np.pi * 0.5**2) * np.sqrt(2.1e11 * 0.002**2 / 12 / 7850)
    assert np.all(found[:2] < 0.01)
    np.testing.assert_allclose(found[2:5], expected, rtol=1e-4)


def test_every_mode_has_the_given_damping_and_a_free_motion_none():
    """Mass-proportional damping would brake the free motions; stiffness-proportional would grow with frequency."""
    body = PLAIN.full()
    np.testing.assert_allclose(poles(body)[1][-20:], 0.01, rtol=1e-6)
    rigid = np.zeros(len(body.mass))
    rigid[::2] = 1.0
    assert np.abs(body.damping @ rigid).max() < 1e-6 * np.abs(body.damping).max()


def test_stations_lie_on_mesh_nodes():
    """A station between nodes would move to the nearest one, and the first bending mode with it."""
    stations = tuple(Station(str(i), position) for i, position in enumerate((0.0, 0.013, 0.237, 0.499, 0.5)))
    mesh = replace(PLAIN, stations=stations, elements=7).mesh()
    assert np.all(np.diff(mesh) > 0)
    for station in stations:
        assert np.abs(mesh - station.position).min() == 0


def test_example_is_the_beam_of_the_paper():
    """First internal bending mode at 32.5 Hz; suspension modes at a few Hz, gone before the steady periods."""
    rig = load_rig(EXAMPLE / "rig.toml")
    frequency, ratio = poles(load_model(EXAMPLE / "model.toml").full())
    assert frequency[2] == pytest.approx(32.5, abs=0.2)
    assert np.all((frequency[:2] > 2) & (frequency[:2] < 10))
    assert np.all(ratio[:2] >= 0.05)
    settle = rig.transient_periods * rig.period_samples / rig.sample_rate
    decay_db = 20 * np.log10(np.e) * np.max(-ratio * 2 * np.pi * frequency) * settle
    assert decay_db < -100


@pytest.mark.parametrize("name", ["model.toml", "model-cubic.toml"])
def test_reduction_stays_far_below_the_noise(name):
    """15 coordinates stand for 66, with an error below -100 dB in S and in S⁻¹; the noise lies at -40 dB.

    Modes alone, without residual flexibility, leave -94 dB in S but -26 dB in S⁻¹, and the network is made
    of S⁻¹.
    """
    rig = load_rig(EXAMPLE / "rig.toml")
    model = load_model(EXAMPLE / name)
    full = model.full()
    s = 2j * np.pi * rig.frequencies[:, None, None]
    inputs = np.column_stack([full.actuators[node.name] for node in rig.nodes])
    outputs = np.array([full.sensors[node.name] for node in rig.nodes])
    exact = outputs @ np.linalg.solve(full.stiffness + s * full.damping + s**2 * full.mass, inputs)
    system = assemble(model, rig)
    reduced = system.response(rig.frequencies)
    assert len(system.mass) < 20
    for found, expected in ((reduced, exact), (np.linalg.inv(reduced), np.linalg.inv(exact))):
        error = np.sum(np.abs(found - expected) ** 2, axis=0) / np.sum(np.abs(expected) ** 2, axis=0)
        assert np.max(10 * np.log10(error)) < -100


def test_refuses_stations_beside_the_beam():
    """And effects at an actuator that is none."""
    with pytest.raises(ConfigurationError, match=r"stations\[0\].position: 0.6, must lie on the beam"):
        replace(PLAIN, stations=(Station("1", 0.6),))
