"""Routes of rigs: what they are, what they say now, and what they said before."""

from enum import StrEnum
from typing import Annotated, Any

import sqlalchemy as sa
from fastapi import APIRouter, Query

from creak.api.describe import NodeName, OfNode, RigName, ScopeOf, StoreOf, TimeText, refusals, time_of
from creak.api.models import ElementPage, HistoryPage, Node, NodePage, RigDetail, RigPage, Spectrum
from creak.api.paging import CursorText, Limit, read_cursor, write_cursor
from creak.api.problems import no_estimate, unknown_node, unknown_rig
from creak.records import Scope
from creak.sinks import queries

router = APIRouter(prefix="/rigs", tags=["rigs"])
Json = dict[str, Any]


class Order(StrEnum):
    """Which end of a list comes first."""

    NEWEST = "newest"
    OLDEST = "oldest"


@router.get("", response_model=RigPage, responses=refusals(422))
def list_rigs(store: StoreOf, cursor: CursorText = None, limit: Limit = 100) -> Json:
    """List all rigs by name, each with its current run."""
    place = read_cursor(cursor, ["rigs"], (str,))
    with store.read() as connection:
        page = queries.rigs(connection, None if place is None else place[0], limit)
    return {"items": page.items, "next": write_cursor(page.end, ["rigs"])}


@router.get("/{rig}", response_model=RigDetail, responses=refusals(404, 422))
def get_rig(store: StoreOf, rig: RigName) -> Json:
    """Return one rig: its run, its file, its limits and its newest faults."""
    with store.read() as connection:
        found = queries.rig(connection, rig)
    if found is None:
        raise unknown_rig(rig)
    return found


@router.get("/{rig}/nodes", response_model=NodePage, responses=refusals(404, 422))
def list_nodes(
    store: StoreOf, rig: RigName, scope: ScopeOf = Scope.WINDOW, cursor: CursorText = None, limit: Limit = 100
) -> Json:
    """List all nodes of a rig, with the keys of `creak replay --json`, and their alarms."""
    of = ["nodes", rig, scope.value]
    place = read_cursor(cursor, of, (int,))
    with store.read() as connection:
        items = queries.nodes(connection, run_of(connection, rig), scope)
    first = 0 if place is None else max(place[0], 0)
    rest = first + limit
    return {
        "items": items[first:rest],
        "next": write_cursor((rest,) if rest < len(items) else None, of),
    }


@router.get("/{rig}/nodes/{node}", response_model=Node, responses=refusals(404, 422))
def get_node(store: StoreOf, rig: RigName, node: NodeName, scope: ScopeOf = Scope.WINDOW) -> Json:
    """Return one node: its levels and its alarm; levels are null until the first realisation is complete."""
    with store.read() as connection:
        run = run_of(connection, rig, node)
        return next(item for item in queries.nodes(connection, run, scope) if item["name"] == node)


@router.get("/{rig}/nodes/{node}/spectrum", response_model=Spectrum, responses=refusals(404, 422))
def get_spectrum(store: StoreOf, rig: RigName, node: NodeName, scope: ScopeOf = Scope.WINDOW) -> Json:
    """Return a node's levels line by line, of the newest estimate."""
    with store.read() as connection:
        found = queries.spectrum(connection, run_of(connection, rig, node), node, scope)
    if found is None:
        raise no_estimate(rig, node, scope.value)
    return found


@router.get("/{rig}/elements", response_model=ElementPage, responses=refusals(404, 422))
def list_elements(
    store: StoreOf, rig: RigName, scope: ScopeOf = Scope.WINDOW, cursor: CursorText = None, limit: Limit = 100
) -> Json:
    """List where distortion acts: between which nodes, or between a node and the ground."""
    of = ["elements", rig, scope.value]
    place = read_cursor(cursor, of, (int,))
    with store.read() as connection:
        found = queries.elements(connection, run_of(connection, rig), scope)
    first = 0 if place is None else max(place[0], 0)
    rest = first + limit
    more = (rest,) if rest < len(found["items"]) else None
    return {**found, "items": found["items"][first:rest], "next": write_cursor(more, of)}


@router.get("/{rig}/history", response_model=HistoryPage, responses=refusals(404, 422))
def list_history(
    *,
    store: StoreOf,
    rig: RigName,
    node: OfNode = None,
    since: TimeText = None,
    until: TimeText = None,
    scope: ScopeOf = Scope.WINDOW,
    order: Annotated[Order, Query(description="Which rows come first, as they were written.")] = Order.NEWEST,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> Json:
    """List levels that the nodes had, over all runs of the rig.

    Recorded times from `since` on and before `until`.
    """
    of = ["history", rig, node, since, until, scope.value, order.value]
    place = read_cursor(cursor, of, (int,))
    wanted = queries.HistoryFilter(rig, scope, node, time_of(since, "since"), time_of(until, "until"))
    with store.read() as connection:
        run_of(connection, rig, node)
        after = None if place is None else place[0]
        page = queries.history(connection, wanted, after, limit, oldest=order is Order.OLDEST)
    return {"items": page.items, "next": write_cursor(page.end, of)}


def run_of(connection: sa.Connection, rig: str, node: str | None = None) -> queries.Row:
    """Return the current run of a rig that has a given node.

    Raises
    ------
    ProblemError
        If there is no such rig, or it has no such node.
    """
    run = queries.current_run(connection, rig)
    if run is None:
        raise unknown_rig(rig)
    known = [item["name"] for item in run["nodes"]]
    if node is not None and node not in known:
        raise unknown_node(rig, node, known)
    return run
