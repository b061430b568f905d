"""Model files: the examples load, and what is wrong is said in one line."""

from pathlib import Path

import numpy as np
import pytest

from creak.config.model import load_model, parse_model
from creak.config.rig import load_rig
from creak.errors import ConfigurationError
from creak.mechanics.effects import CubicStiffness
from creak.mechanics.structure import Lumped, Matrices, MeasuredResponse
from creak.mechanics.system import assemble

EXAMPLES = Path(__file__).parents[1] / "deploy" / "examples"

LUMPED = """
kind = "lumped"
[[masses]]
name = "1"
mass = 1.0
[[links]]
between = ["ground", "1"]
stiffness = 2e4
damping = 8
[[effects]]
effect = "clearance"
at = ["1", "ground"]
stiffness = 1e5
gap = 1e-3
"""
MATRICES = """
kind = "matrices"
mass = [[1.0, 0], [0, 2.0]]
damping = "c.csv"
stiffness = "all.npz"
inputs = {"1" = 0}
outputs = {"1" = 0, "2" = 1}
"""
BEAM = """
kind = "beam"
length = 0.5
width = 0.02
thickness = 0.002
youngs_modulus = 2.0e11
density = 7850
damping_ratio = 0.01
elements = 8
[[stations]]
name = "1"
position = 0.1
"""


@pytest.mark.parametrize("effect", ["clearance", "hysteresis", "quadratic_stiffness", "one_sided_stop"])
def test_the_ground_may_come_first_where_the_law_is_odd(effect):
    """Kills an even law that is turned round with its sign unchanged."""
    parameters = {
        "hysteresis": "stiffness = 1e5\nyield_displacement = 1e-3",
        "quadratic_stiffness": "coefficient = 1e5",
    }
    text = LUMPED.replace("clearance", effect).replace(
        "stiffness = 1e5\ngap = 1e-3", parameters.get(effect, "stiffness = 1e5\ngap = 1e-3")
    )
    swapped = text.replace('at = ["1", "ground"]', 'at = ["ground", "1"]')
    assert swapped != text
    if effect in ("clearance", "hysteresis"):
        assert parse_model(swapped, "model.toml").effects == parse_model(text, "model.toml").effects
    else:
        with pytest.raises(ConfigurationError, match="in this order"):
            parse_model(swapped, "model.toml")


@pytest.mark.parametrize(
    ("folder", "name", "effects"),
    [
        ("three-mass", "model.toml", (CubicStiffness(("3", "ground"), 1e8),)),
        ("three-mass", "model-linear.toml", ()),
        ("beam", "model.toml", ()),
        ("beam", "model-cubic.toml", (CubicStiffness(("3", "ground"), 4e7),)),
    ],
)
def test_examples_fit_their_rigs(folder, name, effects):
    """The README starts with these files."""
    model = load_model(EXAMPLES / folder / name)
    assert model.effects == effects
    system = assemble(model, load_rig(EXAMPLES / folder / "rig.toml"))
    assert system.outputs.shape[0] == 3
    assert len(system.elements) == len(effects)


def test_three_masses_are_the_paper_s():
    """All figures of the paper's study hang on these numbers."""
    model = load_model(EXAMPLES / "three-mass" / "model-linear.toml")
    assert isinstance(model, Lumped)
    assert [mass.mass for mass in model.masses] == [1.0, 0.8, 1.2]
    np.testing.assert_array_equal(
        model.body().stiffness, [[55e3, -35e3, 0], [-35e3, 85e3, -50e3], [0, -50e3, 130e3]]
    )
    np.testing.assert_array_equal(model.body().damping, [[16, -8, 0], [-8, 16, -8], [0, -8, 16]])


def test_matrices_come_from_files_beside_the_model(tmp_path):
    """Looked up in the working directory instead, they would not be found, or be another model's."""
    np.savetxt(tmp_path / "c.csv", [[3.0, 1.0], [1.0, 4.0]], delimiter=",")
    np.savez(tmp_path / "all.npz", mass=np.eye(2), stiffness=np.diag([5.0, 6.0]))
    (tmp_path / "model.toml").write_text(MATRICES)
    model = load_model(tmp_path / "model.toml")
    assert isinstance(model, Matrices)
    np.testing.assert_array_equal(model.mass, [[1, 0], [0, 2]])
    np.testing.assert_array_equal(model.damping, [[3, 1], [1, 4]])
    np.testing.assert_array_equal(model.stiffness, [[5, 0], [0, 6]])
    assert model.outputs == {"1": 0, "2": 1}


def test_measured_response_is_kept_for_the_diagnosis():
    assert parse_model('kind = "frf"\nrecording = "healthy.mcap"', "m.toml") == MeasuredResponse("healthy.mcap")


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        (LUMPED, "2e4", "'abc'", "links[0].stiffness: 'abc'"),
        (LUMPED, "2e4", "'2e4'", "links[0].stiffness: '2e4'"),
        (LUMPED, "2e4", "true", "links[0].stiffness: True"),
        (LUMPED, "2e4", "-2e4", "links[0].stiffness: -20000.0, must be finite and 0 or greater"),
        (LUMPED, "mass = 1.0", "mass = 0", "masses[0].mass: 0"),
        (LUMPED, "mass = 1.0", "", "masses[0].mass: is missing"),
        (LUMPED, "damping = 8", "dampnig = 8", "links[0].dampnig: is not a known key"),
        (LUMPED, '["ground", "1"]', '["ground", "2"]', "links[0].between: '2' is no mass; known are '1'"),
        (LUMPED, '["ground", "1"]', '["1"]', "links[0].between"),
        (LUMPED, "lumped", "lumpy", "kind: 'lumpy' is not known; allowed are lumped, matrices, beam, frf"),
        (LUMPED, 'kind = "lumped"', "", "kind: is missing"),
        (LUMPED, '"clearance"', '"clearence"', "effects[0].effect: 'clearence' is not known; allowed are"),
        (LUMPED, "gap = 1e-3", "", "effects[0].gap: is missing"),
        (LUMPED, "gap = 1e-3", "gap = -1e-3", "effects[0].gap: -0.001, must not be negative"),
        (LUMPED, "gap = 1e-3", "gap = nan", "effects[0].gap: nan, must be finite"),
        (LUMPED, "gap = 1e-3", "gap = '1 mm'", "effects[0].gap: '1 mm', must be a number"),
        (LUMPED, "gap = 1e-3", "gap = 1e-3\nk = 1", "effects[0].k: is no parameter of clearance, which takes"),
        (LUMPED, 'at = ["1", "ground"]', 'at = ["1"]', "effects[0].at: ['1'], must name a node and another node"),
        (LUMPED, 'at = ["1", "ground"]', 'at = ["4", "ground"]', "effects[0].at: '4' is no node; known are '1'"),
        (LUMPED, 'at = ["1", "ground"]', "at = 1", "effects[0].at: 1, must be a list of node names"),
        (LUMPED, "[[links]]", "[[links]", "is not TOML"),
        (MATRICES, '"c.csv"', "[[1, 2], [3]]", "damping[1]: 1 values, must be a row of 2 numbers"),
        (MATRICES, '"c.csv"', '"none.npy"', "damping: 'none.npy' cannot be read: No such file"),
        (MATRICES, '"c.csv"', '"model.toml"', "damping: 'model.toml' holds no matrix of real numbers"),
        (MATRICES, '"c.csv"', '"text.csv"', "damping: 'text.csv' holds no matrix of real numbers"),
        (MATRICES, '"1" = 0}', '"1" = 2}', "inputs.1: 2, must be a degree of freedom, 0 to 1"),
        (BEAM, "elements = 8", "elements = 8.5", "elements: 8.5"),
        (BEAM, "position = 0.1", "position = 0.6", "stations[0].position: 0.6, must lie on the beam, 0 to 0.5"),
        (BEAM, "position = 0.1", "position = 0.1\nsensor = 1", "stations[0].sensor: 1"),
        (BEAM, "thickness = 0.002", "thickness = 0", "thickness: 0.0, must be finite and greater than 0"),
    ],
)  # fmt: skip
def test_says_in_one_line_what_is_wrong(tmp_path, text, old, new, message):
    """File, key, value and what is allowed; never a traceback from a library below."""
    (tmp_path / "text.csv").write_text("a,b\nc,d\n")
    np.savetxt(tmp_path / "c.csv", np.eye(2), delimiter=",")
    np.savez(tmp_path / "all.npz", stiffness=np.eye(2))
    assert old in text
    path = tmp_path / "model.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(ConfigurationError) as caught:
        load_model(path)
    assert str(caught.value).startswith(f"{path}: {message}")
    assert "\n" not in str(caught.value)
