"""Routes with which operators act on nodes, whether these have ever alarmed or not."""

import time
from typing import Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Response

from creak.alarm_records import Action, ActionKind
from creak.api.describe import NodeName, RigName, StoreOf, refusals
from creak.api.health import worker_lives
from creak.api.models import Node
from creak.api.operate import ActionBody, done, refused, wait_for_worker
from creak.api.rigs import run_of
from creak.records import Scope
from creak.sinks import actions, queries
from creak.sinks.database import Store

router = APIRouter(prefix="/rigs/{rig}/nodes/{node}", tags=["rigs"])
Json = dict[str, Any]

_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "Done; the node as it now stands."},
    202: {
        "description": "Noted: the worker of the rig does not answer at present and will do it; the node as it "
        "stands.",
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Node"}}},
    },
    **refusals(404, 409, 413, 422),
}


@router.post("/relearn", response_model=Node, responses=_ANSWERS)
async def relearn(*, store: StoreOf, rig: RigName, node: NodeName, body: ActionBody, response: Response) -> Json:
    """Have new baselines learnt of a node whose machine was changed on purpose.

    Those in force stay so until the new ones are complete; see `GET /rigs/{rig}/baselines`. A node without a
    baseline is refused with 409.
    """
    return await _act(store, rig, node, ActionKind.RELEARN, body, response)


@router.post("/suppress", response_model=Node, responses=_ANSWERS)
async def suppress(*, store: StoreOf, rig: RigName, node: NodeName, body: ActionBody, response: Response) -> Json:
    """Suppress the process alarm of a node, which has no meaning as the plant runs now, until `unsuppress`."""
    return await _act(store, rig, node, ActionKind.SUPPRESS, body, response)


@router.post("/unsuppress", response_model=Node, responses=_ANSWERS)
async def unsuppress(
    *, store: StoreOf, rig: RigName, node: NodeName, body: ActionBody, response: Response
) -> Json:
    """End the suppression; a node that is not suppressed stays as it is."""
    return await _act(store, rig, node, ActionKind.UNSUPPRESS, body, response)


@router.post("/retire", response_model=Node, responses=_ANSWERS)
async def retire(*, store: StoreOf, rig: RigName, node: NodeName, body: ActionBody, response: Response) -> Json:
    """Take the process alarm of a node out of service, for maintenance, until `reinstate`."""
    return await _act(store, rig, node, ActionKind.RETIRE, body, response)


@router.post("/reinstate", response_model=Node, responses=_ANSWERS)
async def reinstate(*, store: StoreOf, rig: RigName, node: NodeName, body: ActionBody, response: Response) -> Json:
    """Put the process alarm of a node into service again; one that is in service stays as it is."""
    return await _act(store, rig, node, ActionKind.REINSTATE, body, response)


async def _act(store: Store, rig: str, node: str, kind: ActionKind, body: ActionBody, response: Response) -> Json:
    """Have an action carried out as those of alarms are: by the worker while it lives, or else here."""

    def begin() -> str | None:
        with store.write() as connection:
            run = run_of(connection, rig, node)
            action = Action("", kind, body.by, body.comment, node=node)
            if worker_lives(run, time.time_ns()):
                return actions.ask(connection, rig, action)
            now = run["last"] or run["start"]
            conflict = actions.carry_out_of_node(connection, run, action, queries.alarm_rules(run), now)
            if conflict is not None:
                raise refused(conflict)
            return None

    def look(asked: str) -> bool:
        with store.read() as connection:
            return done(*actions.outcome(connection, asked))

    def standing() -> Json:
        with store.read() as connection:
            run = run_of(connection, rig, node)
            return next(item for item in queries.nodes(connection, run, Scope.WINDOW) if item["name"] == node)

    await wait_for_worker(await run_sync(begin), look, response)
    return await run_sync(standing)
