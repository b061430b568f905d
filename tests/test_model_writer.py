"""Model files that are written: what is read back is the same model."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from creak.config.model import load_model, parse_model
from creak.config.model_writer import model_toml
from creak.mechanics.beam import Beam, Station
from creak.mechanics.effects import GROUND, Internal
from creak.mechanics.structure import Link, Lumped, Matrices, MeasuredResponse, PointMass
from creak.mechanics.vocabulary import VOCABULARY

texts = st.text(st.characters(codec="utf-8", exclude_characters="\r"), min_size=1, max_size=8).filter(
    lambda name: name != GROUND
)
names = st.lists(texts, min_size=2, max_size=4, unique=True)
signed = st.floats(allow_nan=False, allow_infinity=False)
size = st.floats(0, 1e300)
positive = st.floats(1e-300, 1e300)
share = st.floats(0, 1)


@st.composite
def effects(draw, nodes, driven, measured):
    """Any number of effects of the vocabulary at places that there are."""
    out = []
    for kind in draw(st.lists(st.sampled_from(list(VOCABULARY.values())), max_size=4)):
        values = {}
        for key in kind.parameter_names():
            allowed = positive if key in kind.positive else size if key in kind.not_negative else signed
            values[key] = draw(share if key == "share" else allowed)
        if issubclass(kind, Internal):
            first = draw(st.sampled_from(nodes))
            at = (first, draw(st.sampled_from([GROUND, *(n for n in nodes if n != first)])))
        elif kind.effect == "resonator":
            at = (draw(st.sampled_from(nodes)),)
        else:
            places = driven if kind.effect.startswith("actuator") else measured
            if not places:
                continue
            at = (draw(st.sampled_from(places)),)
        out.append(kind(at, **values))
    return tuple(out)


@st.composite
def lumped(draw):
    nodes = draw(names)
    masses = tuple(PointMass(name, draw(positive)) for name in nodes)
    ends = st.lists(st.sampled_from([GROUND, *nodes]), min_size=2, max_size=2, unique=True).map(tuple)
    links = tuple(draw(st.lists(st.builds(Link, ends, size, size), max_size=3)))
    return Lumped(masses, links, draw(effects(nodes, nodes, nodes)))


@st.composite
def beams(draw):
    nodes = draw(names)
    length = draw(st.floats(1e-3, 1e3))
    stations = tuple(
        draw(
            st.builds(
                Station,
                st.just(name),
                share.map(lambda part: part * length),
                size,
                size,
                size,
                st.booleans(),
                st.booleans(),
                positive,
            )
        )
        for name in nodes
    )
    driven = [station.name for station in stations if station.actuator]
    measured = [station.name for station in stations if station.sensor]
    there = draw(effects(nodes, driven, measured))
    numbers = [draw(positive) for _ in range(4)]
    return Beam(length, *numbers, draw(size), draw(st.integers(1, 1000)), stations, there)


@settings(max_examples=150, deadline=None)
@given(st.one_of(lumped(), beams(), st.builds(MeasuredResponse, texts)))
def test_what_is_written_reads_back_equal(model):
    """A rounded number, an unescaped name or a forgotten key would make the saved model another one."""
    assert parse_model(model_toml(model), "saved.toml") == model


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_matrices_read_back_equal(data):
    """The same for arrays, which do not compare as records do."""
    n = data.draw(st.integers(1, 4))
    square = st.lists(signed, min_size=n * n, max_size=n * n).map(lambda v: np.reshape(v, (n, n)))
    nodes = data.draw(names)
    where = {name: data.draw(st.integers(0, n - 1)) for name in nodes}
    mass = np.diag(data.draw(st.lists(st.floats(0.1, 1e5), min_size=n, max_size=n)))
    model = Matrices(
        mass, data.draw(square), data.draw(square), where, where, data.draw(effects(nodes, nodes, nodes))
    )
    back = parse_model(model_toml(model), "saved.toml")
    assert isinstance(back, Matrices)
    for key in ("mass", "damping", "stiffness"):
        np.testing.assert_array_equal(getattr(back, key), getattr(model, key))
    assert (back.inputs, back.outputs, back.effects) == (where, where, model.effects)


@pytest.mark.parametrize("folder", ["three-mass", "beam"])
def test_examples_survive_being_saved(folder, tmp_path):
    """The models of the README, through a file."""
    model = load_model(Path(__file__).parents[1] / "deploy" / "examples" / folder / "model.toml")
    (tmp_path / "saved.toml").write_text(model_toml(model))
    assert load_model(tmp_path / "saved.toml") == model
