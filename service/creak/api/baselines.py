"""The route that shows what has been learnt of each node, and what is being learnt to replace it."""

from math import log10
from typing import Any

from fastapi import APIRouter
from pydantic import Field

from creak.api.describe import OfNode, RigName, StoreOf, refusals
from creak.api.models import Answer, Decibels
from creak.api.paging import CursorText, Limit, read_cursor, write_cursor
from creak.api.problems import unknown_node, unknown_rig
from creak.baseline import Baseline as Learnt
from creak.codec import moment_json, time_json
from creak.sinks import baselines, queries

router = APIRouter(prefix="/rigs", tags=["rigs"])
Json = dict[str, Any]


class Reference(Answer):
    """What was learnt from healthy windows that share no data."""

    realisations: int = Field(description="Realisations learnt from.")
    windows: int = Field(description="Windows that they make.")
    mean_db: Decibels = Field(
        description="Mean nonlinear level over the windows, dB on the started scale of the baseline: 0 is none."
    )
    deviation_db: Decibels = Field(description="Its standard deviation from window to window; null before two.")
    reference_noise_db: float = Field(description="Noise level when learning began: the scale's unit.")
    since: str | None = Field(description="Recorded time of the first window learnt from.")
    updated: str | None = Field(description="Recorded time of the last one; a complete baseline is frozen there.")


class Baseline(Reference):
    """A node's baseline in one operating state."""

    node: str
    state_rms: float = Field(description="RMS of the excitation, in units of the inputs: the operating state.")
    complete: bool = Field(
        description="In force and frozen; else it is being learnt, and nothing is judged by it."
    )
    successor: Reference | None = Field(description="What is being learnt to replace it.")


class BaselinePage(Answer):
    """Baselines of a rig, by node and operating state."""

    rig: str
    time: str | None = Field(description="Recorded time of the last complete realisation, which they include.")
    items: list[Baseline]
    next: str | None


_REFERENCE = {
    "realisations": 80,
    "windows": 20,
    "mean_db": 6.1,
    "deviation_db": 0.4,
    "reference_noise_db": -97.1,
    "since": "2026-05-01T08:00:24.000000Z",
    "updated": "2026-05-01T08:14:24.000000Z",
}
Reference.example = _REFERENCE
Baseline.example = {**_REFERENCE, "node": "3", "state_rms": 0.02, "complete": True, "successor": None}
BaselinePage.example = {
    "rig": "beam",
    "time": "2026-05-01T09:00:00.000000Z",
    "items": [Baseline.example],
    "next": None,
}


@router.get("/{rig}/baselines", response_model=BaselinePage, responses=refusals(404, 422))
def list_baselines(
    store: StoreOf, rig: RigName, node: OfNode = None, cursor: CursorText = None, limit: Limit = 100
) -> Json:
    """List what has been learnt of the nodes, one entry a node and operating state.

    A complete baseline is frozen; `POST /alarms/{alarm}/relearn` has another one learnt in its place.
    """
    of = ["baselines", rig, node]
    place = read_cursor(cursor, of, (int,))
    with store.read() as connection:
        run = queries.current_run(connection, rig)
        if run is None:
            raise unknown_rig(rig)
        known = [item["name"] for item in run["nodes"]]
        if node is not None and node not in known:
            raise unknown_node(rig, node, known)
        found, time = baselines.as_of(connection, rig)
    items = [_shown(each) for each in found if node in {None, each.node}]
    first = 0 if place is None else max(place[0], 0)
    rest = first + limit
    return {
        "rig": rig,
        "time": moment_json(time),
        "items": items[first:rest],
        "next": write_cursor((rest,) if rest < len(items) else None, of),
    }


def _shown(baseline: Learnt) -> Json:
    return {
        **_reference(baseline),
        "node": baseline.node,
        "state_rms": baseline.state_rms,
        "complete": baseline.complete,
        "successor": None if baseline.successor is None else _reference(baseline.successor),
    }


def _reference(baseline: Learnt) -> Json:
    windows = baseline.reference.count
    return {
        "realisations": baseline.realisations,
        "windows": windows,
        "mean_db": baseline.mean_db if windows else None,
        "deviation_db": baseline.deviation_db,
        "reference_noise_db": 10.0 * log10(baseline.reference_power),
        "since": time_json(baseline.since) if windows else None,
        "updated": time_json(baseline.updated) if windows else None,
    }
