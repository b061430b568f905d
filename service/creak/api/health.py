"""Whether the process is alive, and whether the service is of use."""

import time
from typing import Any

from fastapi import APIRouter, Request

from creak import __version__
from creak.api.describe import StoreOf, refusals
from creak.api.models import Health, Readiness
from creak.api.problems import MEDIA_TYPE, ProblemError
from creak.records import RunStatus
from creak.sinks import queries
from creak.sinks.store import BEAT_SECONDS, RUNNING

router = APIRouter(tags=["service"])

_WORKER_SILENT = 3 * BEAT_SECONDS
_RIG_SILENT = 60.0
_RIG_SILENT_PERIODS = 5

_NOT_READY: dict[str, Any] = {
    "type": "urn:problem-type:creak:not-ready",
    "title": "Not ready",
    "status": 503,
    "detail": "rig 'beam': its worker has not written for 31 s",
    "instance": "/readyz",
}


@router.get("/healthz", response_model=Health)
async def healthz() -> dict[str, str]:
    """Answer that the process is alive; touches nothing else."""
    return {"status": "alive", "version": __version__}


@router.get(
    "/readyz",
    response_model=Readiness,
    responses={
        **refusals(),
        503: {
            "description": "The store cannot be reached, or a rig is not measured.",
            "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}, "example": _NOT_READY}},
        },
    },
)
def readyz(request: Request, store: StoreOf) -> dict[str, Any]:
    """Answer whether the store can be read and every rig has been heard of lately, or has completed its run."""
    with store.read() as connection:
        runs = {run["rig"]: run for run in queries.current_runs(connection)}
    watched = request.app.state.rigs or tuple(name for name, run in runs.items() if run["status"] == RUNNING)
    now = time.time_ns()
    complaints = [
        f"rig {name!r}: {complaint}" for name in watched if (complaint := _complaint(runs.get(name), now))
    ]
    if complaints:
        raise ProblemError(503, "not-ready", "Not ready", "; ".join(complaints), headers={"Retry-After": "5"})
    return {"status": "ready", "rigs": list(watched)}


def worker_lives(run: queries.Row, now: int) -> bool:
    """Tell whether a worker measures a run at a wall-clock time in ns, as far as the store knows."""
    return bool(run["status"] == RUNNING and now - run["beat_at"] <= _WORKER_SILENT * 1e9)


def _complaint(run: queries.Row | None, now: int) -> str:
    """Return what is wrong with a rig's run at a wall-clock time in ns; empty if nothing is."""
    if run is None:
        return "no worker has opened a run yet"
    if run["status"] == RunStatus.COMPLETED:
        return ""
    if run["status"] != RUNNING:
        return f"its run ended as {run['status']}" + (f" ({run['message']})" if run["message"] else "")
    beat = (now - run["beat_at"]) / 1e9
    if beat > _WORKER_SILENT:
        return f"its worker has not written for {beat:.0f} s"
    if run["heard_at"] is None:
        return "it has not sent a frame yet"
    silence = (now - run["heard_at"]) / 1e9
    if silence > max(_RIG_SILENT, _RIG_SILENT_PERIODS * run["period_samples"] / run["sample_rate"]):
        return f"it has sent no frame for {silence:.0f} s"
    return ""
