"""Routes of alarms and recordings."""

from typing import Annotated, Any

from fastapi import APIRouter, Query, Response

from creak.api.describe import AlarmId, OfNode, OfRig, StoreOf, TimeText, refusals, time_of
from creak.api.etags import IF_NONE_MATCH, etag, matches
from creak.api.models import AlarmDetail, AlarmPage, RecordingPage
from creak.api.paging import CursorText, Limit, read_cursor, write_cursor
from creak.api.problems import unknown_alarm
from creak.records import AlarmState
from creak.sinks import queries

router = APIRouter()
Json = dict[str, Any]


@router.get("/alarms", response_model=AlarmPage, responses=refusals(422), tags=["alarms"])
def list_alarms(
    *,
    store: StoreOf,
    state: Annotated[list[AlarmState] | None, Query(description="Any of these states.")] = None,
    rig: OfRig = None,
    node: OfNode = None,
    since: TimeText = None,
    cursor: CursorText = None,
    limit: Limit = 100,
) -> Json:
    """List alarm occurrences as they stand, the one raised last first.

    `since`: raised at that recorded time or later.
    """
    states = tuple(sorted(set(state or ())))
    of = ["alarms", [item.value for item in states], rig, node, since]
    place = read_cursor(cursor, of, (int, int))
    wanted = queries.AlarmFilter(states, rig, node, time_of(since, "since"))
    with store.read() as connection:
        page = queries.alarms(connection, wanted, None if place is None else (place[0], place[1]), limit)
    return {"items": page.items, "next": write_cursor(page.end, of)}


@router.get(
    "/alarms/{alarm}",
    response_model=AlarmDetail,
    responses={304: {"description": "It is as the client has it."}, **refusals(404, 422)},
    tags=["alarms"],
)
def get_alarm(store: StoreOf, alarm: AlarmId, response: Response, if_none_match: IF_NONE_MATCH = None) -> Any:
    """Return one alarm, with every change it went through; its `ETag` is that of its newest change."""
    with store.read() as connection:
        found = queries.alarm(connection, alarm)
        change = queries.alarm_change(connection, alarm)
    if found is None or change is None:
        raise unknown_alarm(alarm)
    tag = {"ETag": etag(change)}
    if if_none_match is not None and matches(if_none_match, change, "if-none-match"):
        return Response(status_code=304, headers=tag)
    response.headers.update(tag)
    return found


@router.get("/recordings", response_model=RecordingPage, responses=refusals(422), tags=["recordings"])
def list_recordings(store: StoreOf, rig: OfRig = None, cursor: CursorText = None, limit: Limit = 100) -> Json:
    """List recordings, the one begun last first."""
    of = ["recordings", rig]
    place = read_cursor(cursor, of, (int,))
    with store.read() as connection:
        page = queries.recordings(connection, rig, None if place is None else place[0], limit)
    return {"items": page.items, "next": write_cursor(page.end, of)}
