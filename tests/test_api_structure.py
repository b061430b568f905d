"""How a rig is to be drawn: after its model, or after what its file says of its network."""

from dataclasses import replace
from pathlib import Path

import pytest

from api_client import V1, assert_problem, get, serving
from conftest import make_rig
from creak.api import create_app
from creak.sinks.database import open_store
from store_records import make_run, opened

ROOT = Path(__file__).parents[1]
BEAM = ROOT / "service/creak/examples/beam/model.toml"
MASSES = ROOT / "deploy/examples/three-mass/model.toml"


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    place = tmp_path_factory.mktemp("structure")
    store = open_store(f"sqlite:///{place}/creak.db")
    for name in ("beam", "masses", "dense", "gone"):
        opened(store, make_run(f"{name}-1", name))
    pairs = make_rig(name="pairs", network=(("1", "2"), ("2", "3")), q=2)
    opened(store, make_run("pairs-1", rig=pairs))
    odd = replace(
        pairs, name="odd/ rig", nodes=tuple(replace(n, name=f"<b>{n.name}/") for n in pairs.nodes), network=None
    )
    opened(store, make_run("odd-1", rig=odd))
    models = {"beam": BEAM, "masses": MASSES, "gone": place / "nosuch.toml"}
    with serving(create_app(store, models_of=models)) as client:
        yield client
    store.close()


def test_a_beam_is_drawn_along_its_length(client):
    body = get(client, f"{V1}/rigs/beam/structure")
    assert (body["source"], body["length"], body["dense"]) == ("model", 0.5, False)
    assert [(node["name"], node["position"]) for node in body["nodes"]] == [("1", 0.0), ("2", 0.25), ("3", 0.5)]
    ground = [[name, "ground"] for name in "123"]
    assert body["edges"] == [["1", "2"], ["2", "3"], *ground]  # not the stations that are no nodes


def test_masses_are_joined_by_their_links(client):
    body = get(client, f"{V1}/rigs/masses/structure")
    assert (body["source"], body["length"]) == ("model", None)
    assert {tuple(sorted(pair)) for pair in body["edges"]} == {
        ("1", "ground"),
        ("1", "2"),
        ("2", "3"),
        ("3", "ground"),
    }


def test_without_a_model_the_rig_file_says_what_is_joined(client):
    """Kills a rig that is not drawn as its model is missing, broken or of a kind that says nothing."""
    body = get(client, f"{V1}/rigs/pairs/structure")
    assert (body["source"], body["dense"], body["edges"]) == ("rig", False, [["1", "2"], ["2", "3"]])
    assert [node["driven"] for node in body["nodes"]] == [True, True, False]
    for name in ("dense", "gone", "odd%2F%20rig"):
        body = get(client, f"{V1}/rigs/{name}/structure")
        assert (body["source"], body["dense"], body["edges"]) == ("rig", True, [])
    assert body["nodes"][0]["name"] == "<b>1/"


def test_an_unknown_rig_is_a_problem(client):
    assert_problem(client.get(f"{V1}/rigs/nosuch/structure"), 404, "unknown-rig")
