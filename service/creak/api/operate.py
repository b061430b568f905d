"""Routes with which operators change alarms."""

import time
from collections.abc import Callable
from typing import Annotated, Any

import anyio
from anyio.to_thread import run_sync
from fastapi import APIRouter, Response
from pydantic import AfterValidator, ConfigDict, Field

from creak.alarm_records import Action, ActionKind, Conflict
from creak.api.describe import AlarmId, StoreOf, refusals
from creak.api.etags import IF_MATCH, etag, version_of
from creak.api.health import worker_lives
from creak.api.models import Alarm, Answer
from creak.api.problems import ProblemError, unknown_alarm
from creak.codec import alarm_json, parse_time
from creak.errors import InputError
from creak.sinks import actions, queries
from creak.sinks.database import Store
from creak.sinks.service_alarms import SERVICE

router = APIRouter(prefix="/alarms", tags=["alarms"])
Json = dict[str, Any]

_WAIT_SECONDS = 3.0
_LOOK_SECONDS = 0.05
_LINE = r"^[^\x00-\x1f\x7f]+$"
_TEXT = r"^[^\x00-\x08\x0b\x0c\x0e-\x1f\x7f]*$"


def _time(text: str) -> str:
    try:
        parse_time(text)
    except InputError as error:
        raise ValueError(str(error)) from None
    return text


class ActionBody(Answer):
    """Who asks, and why."""

    model_config = ConfigDict(extra="forbid", strict=True)
    by: str = Field(min_length=1, max_length=200, pattern=_LINE, description="Who does it.")
    comment: str = Field(default="", max_length=2000, pattern=_TEXT, description="Why.")


class UnshelveBody(ActionBody):
    """Who asks, and why; all of it may be left out."""

    by: str = Field(default="anonymous", min_length=1, max_length=200, pattern=_LINE, description="Who does it.")


class ShelveBody(ActionBody):
    """Who asks, why, and until when."""

    until: Annotated[str, AfterValidator(_time)] = Field(
        max_length=64, description="Recorded time at which the shelving ends, ISO 8601."
    )


ActionBody.example = {"by": "A. Operator", "comment": "seen; the bearing is ordered"}
UnshelveBody.example = ActionBody.example
_NAMELESS = UnshelveBody()
ShelveBody.example = {**ActionBody.example, "until": "2026-05-01T16:00:00Z"}

_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "Done; the alarm as it now stands."},
    202: {
        "description": "Noted: the worker of the rig does not answer at present and will do it; the alarm as it "
        "stands.",
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/Alarm"}}},
    },
    **refusals(404, 409, 412, 413, 422),
}


@router.post("/{alarm}/acknowledge", response_model=Alarm, responses=_ANSWERS)
async def acknowledge(
    *, store: StoreOf, alarm: AlarmId, body: ActionBody, response: Response, if_match: IF_MATCH = None
) -> Json:
    """Acknowledge an alarm; once more does no harm. An occurrence that is over is refused with 409."""
    return await _act(store, alarm, ActionKind.ACKNOWLEDGE, body, response, if_match)


@router.post("/{alarm}/shelve", response_model=Alarm, responses=_ANSWERS)
async def shelve(
    *, store: StoreOf, alarm: AlarmId, body: ShelveBody, response: Response, if_match: IF_MATCH = None
) -> Json:
    """Shelve an alarm until a recorded time; shelving it again moves that time."""
    return await _act(store, alarm, ActionKind.SHELVE, body, response, if_match, parse_time(body.until))


@router.post("/{alarm}/unshelve", response_model=Alarm, responses=_ANSWERS)
async def unshelve(
    *,
    store: StoreOf,
    alarm: AlarmId,
    body: UnshelveBody = _NAMELESS,
    response: Response,
    if_match: IF_MATCH = None,
) -> Json:
    """End the shelving of an alarm before its time; one that is not shelved stays as it is. No body is needed."""
    return await _act(store, alarm, ActionKind.UNSHELVE, body, response, if_match)


@router.post("/{alarm}/suppress", response_model=Alarm, responses=_ANSWERS)
async def suppress(
    *, store: StoreOf, alarm: AlarmId, body: ActionBody, response: Response, if_match: IF_MATCH = None
) -> Json:
    """Suppress an alarm that has no meaning as the plant runs now, until `unsuppress`."""
    return await _act(store, alarm, ActionKind.SUPPRESS, body, response, if_match)


@router.post("/{alarm}/unsuppress", response_model=Alarm, responses=_ANSWERS)
async def unsuppress(
    *, store: StoreOf, alarm: AlarmId, body: ActionBody, response: Response, if_match: IF_MATCH = None
) -> Json:
    """End the suppression of an alarm; one that is not suppressed stays as it is."""
    return await _act(store, alarm, ActionKind.UNSUPPRESS, body, response, if_match)


@router.post("/{alarm}/retire", response_model=Alarm, responses=_ANSWERS)
async def retire(
    *, store: StoreOf, alarm: AlarmId, body: ActionBody, response: Response, if_match: IF_MATCH = None
) -> Json:
    """Take an alarm out of service, for maintenance, until `reinstate`."""
    return await _act(store, alarm, ActionKind.RETIRE, body, response, if_match)


@router.post("/{alarm}/reinstate", response_model=Alarm, responses=_ANSWERS)
async def reinstate(
    *, store: StoreOf, alarm: AlarmId, body: ActionBody, response: Response, if_match: IF_MATCH = None
) -> Json:
    """Put an alarm into service again; one that is in service stays as it is."""
    return await _act(store, alarm, ActionKind.REINSTATE, body, response, if_match)


@router.post("/{alarm}/relearn", response_model=Alarm, responses=_ANSWERS)
async def relearn(
    *, store: StoreOf, alarm: AlarmId, body: ActionBody, response: Response, if_match: IF_MATCH = None
) -> Json:
    """Have new baselines learnt of the alarm's node, whose machine was changed on purpose.

    Those in force stay so until the new ones are complete; see `GET /rigs/{rig}/baselines`. A node without a
    baseline, and an alarm about data, are refused with 409.
    """
    return await _act(store, alarm, ActionKind.RELEARN, body, response, if_match)


async def _act(
    store: Store,
    identifier: str,
    kind: ActionKind,
    body: ActionBody,
    response: Response,
    if_match: str | None,
    until: int | None = None,
) -> Json:
    """Have an action carried out: by the worker of the rig, or here if there is none.

    The worker's monitor is the one that knows the alarm, so it decides while it lives; the answer waits for it a
    moment. Without a worker the row in the store is all there is, and one transaction changes it.
    """

    def begin(orphan: bool = False) -> str | None:
        with store.write() as connection:
            standing = queries.alarm_change(connection, identifier, to_change=True)
            if standing is None:
                raise unknown_alarm(identifier)
            seen = None if if_match is None else version_of(if_match, standing)
            if kind is ActionKind.ACKNOWLEDGE and standing.acknowledged:
                return None  # done already, whoever did it
            action = Action(identifier, kind, body.by, body.comment, until, seen)
            run = queries.current_run(connection, standing.rig)
            if run is not None and worker_lives(run, time.time_ns()) and not orphan:
                return actions.ask(connection, standing.rig, action)
            service = standing.rig == SERVICE
            rules, now = queries.alarm_rules(run), time.time_ns() if service or run is None else run["last"] or 0
            conflict = actions.carry_out(connection, action, rules, now)
            if conflict is not None:
                raise refused(conflict)
            return None

    def look(asked: str) -> bool:
        with store.read() as connection:
            status, reason = actions.outcome(connection, asked)
        if status == actions.STALE and kind is not ActionKind.RELEARN and of_an_earlier_run():
            begin(orphan=True)  # the monitor that lives now began afresh, and will never know it
            return True
        return done(status, reason)

    def of_an_earlier_run() -> bool:
        with store.read() as connection:
            return queries.alarm_is_of_an_earlier_run(connection, identifier)

    def standing() -> Json:
        with store.read() as connection:
            change = queries.alarm_change(connection, identifier)
            if change is None:
                raise unknown_alarm(identifier)
            response.headers["ETag"] = etag(change)
            return alarm_json(change)

    await wait_for_worker(await run_sync(begin), look, response)
    return await run_sync(standing)


def done(status: str, reason: str) -> bool:
    """Tell whether an action has been carried out.

    Raises
    ------
    ProblemError
        If it was refused.
    """
    if status in {actions.STALE, actions.NOT_ALLOWED}:
        raise refused(Conflict("stale" if status == actions.STALE else "not_allowed", reason))
    return status == actions.DONE


async def wait_for_worker(asked: str | None, look: Callable[[str], bool], response: Response) -> None:
    """Wait a moment for the answer to an action, if it was asked of a worker; the status says whether it came.

    Parameters
    ----------
    asked : str or None
        Id of the action; None if it is done.
    look : callable
        Tells whether it is done, or raises.
    response : Response
    """
    if asked is None:
        return
    response.status_code = 202
    with anyio.move_on_after(_WAIT_SECONDS):
        while not await run_sync(look, asked):
            await anyio.sleep(_LOOK_SECONDS)
        response.status_code = 200


def refused(conflict: Conflict) -> ProblemError:
    """Return the problem that a conflict is."""
    title = "Stale alarm" if conflict.kind == "stale" else "Not allowed"
    return ProblemError(409, f"alarm-{conflict.kind.replace('_', '-')}", title, conflict.reason)
