"""The route that tells what a rig looks like: its nodes, what joins them, and where they lie."""

import logging
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, Request
from pydantic import Field

from creak.api.describe import RigName, StoreOf, refusals
from creak.api.models import Answer
from creak.api.problems import unknown_rig
from creak.config.model import load_model
from creak.config.validation import parse_toml
from creak.errors import ConfigurationError
from creak.mechanics.beam import Beam
from creak.mechanics.effects import GROUND
from creak.mechanics.structure import Lumped
from creak.sinks import queries

router = APIRouter(prefix="/rigs", tags=["rigs"])
log = logging.getLogger(__name__)
Json = dict[str, Any]


class Place(Answer):
    """A node of the structure."""

    name: str
    driven: bool
    position: float | None = Field(description="Along the beam, m; null where there is no beam.")


class Structure(Answer):
    """A rig as it can be drawn."""

    rig: str
    source: Literal["model", "rig"] = Field(description="What says how the nodes are joined: model or rig file.")
    length: float | None = Field(description="Of the beam, m; null where there is none.")
    dense: bool = Field(description="Any node may act on any other, so no edges are listed.")
    nodes: list[Place]
    edges: list[list[str]] = Field(description="Pairs that are joined: two nodes, or a node and `ground`.")


Structure.example = {
    "rig": "beam",
    "source": "model",
    "length": 0.5,
    "dense": False,
    "nodes": [
        {"name": "1", "driven": True, "position": 0.0},
        {"name": "2", "driven": True, "position": 0.25},
    ],
    "edges": [["1", "2"], ["1", "ground"], ["2", "ground"]],
}


@router.get("/{rig}/structure", response_model=Structure, responses=refusals(404, 422))
def get_structure(request: Request, store: StoreOf, rig: RigName) -> Json:
    """Return how a rig is to be drawn, after its model if it has one, otherwise after its file."""
    with store.read() as connection:
        run = queries.current_run(connection, rig)
    if run is None:
        raise unknown_rig(rig)
    model: Path | None = request.app.state.models.get(rig)
    try:
        drawn = None if model is None else _modelled(run, model)
    except ConfigurationError as error:
        log.warning("a rig is drawn without its model: %s", error)
        drawn = None
    return drawn or _given(run)


def _modelled(run: queries.Row, path: Path) -> Json | None:
    """Return the structure after the model; None if that does not say what joins the nodes."""
    model = load_model(path)
    names = {node["name"] for node in run["nodes"]}
    if isinstance(model, Beam):
        stations = sorted((s for s in model.stations if s.name in names), key=lambda station: station.position)
        edges = [(one.name, other.name) for one, other in pairwise(stations)]
        edges += [(s.name, GROUND) for s in stations if s.suspension_stiffness or s.suspension_damping]
        return _drawn(run, "model", edges, {s.name: s.position for s in stations}, model.length)
    if isinstance(model, Lumped):
        ends = names | {GROUND}
        return _drawn(run, "model", [link.between for link in model.links if set(link.between) <= ends])
    return None


def _given(run: queries.Row) -> Json:
    """Return the structure after the network of the rig file."""
    network = parse_toml(run["configuration"], f"rig {run['rig']}").get("network", "dense")
    return _drawn(run, "rig", None if network == "dense" else network)


def _drawn(
    run: queries.Row,
    source: str,
    edges: Sequence[Sequence[str]] | None,
    positions: Mapping[str, float] | None = None,
    length: float | None = None,
) -> Json:
    nodes = [
        {
            "name": node["name"],
            "driven": node["input"] is not None,
            "position": (positions or {}).get(node["name"]),
        }
        for node in run["nodes"]
    ]
    return {
        "rig": run["rig"],
        "source": source,
        "length": length,
        "dense": edges is None,
        "nodes": nodes,
        "edges": [list(pair) for pair in edges or ()],
    }
