"""How routes describe themselves in the OpenAPI document, and the parameters they share."""

from typing import Annotated, Any

from fastapi import Depends, Path, Query, Request
from pydantic import AfterValidator

from creak.api.guard import SLASH
from creak.api.models import Problem
from creak.api.problems import MEDIA_TYPE, bad_parameter
from creak.codec import parse_time
from creak.errors import InputError
from creak.records import Scope
from creak.sinks.database import Store

_MEANINGS = {
    400: "The path cannot be read.",
    404: "There is no such thing.",
    409: "It cannot be done as things stand.",
    410: "The file is no longer there.",
    422: "A parameter holds what it must not hold.",
    500: "The service failed.",
    503: "The store cannot be read at present.",
}


def refusals(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documented problems of a route: the given statuses, beside those that every route may answer."""
    return {
        status: {
            "description": _MEANINGS[status],
            "content": {
                MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}, "example": Problem.example}
            },
        }
        for status in sorted({400, *statuses, 500, 503})
    }


async def _store(request: Request) -> Store:
    store: Store = request.app.state.store
    return store


def plain_name(text: str) -> str:
    """Return a name of the path with its slashes, as it was meant."""
    return text.replace(SLASH, "/")


StoreOf = Annotated[Store, Depends(_store)]
"""The store of the application."""

_Plain = Query(max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$")
RigName = Annotated[str, Path(description="Name of the rig."), AfterValidator(plain_name)]
NodeName = Annotated[str, Path(description="Name of the node."), AfterValidator(plain_name)]
AlarmId = Annotated[str, Path(description="Id of the alarm."), AfterValidator(plain_name)]
OfRig = Annotated[str | None, _Plain]
OfNode = Annotated[str | None, _Plain]
ScopeOf = Annotated[
    Scope,
    Query(description="`window`: the last complete realisations, as one watches live; `run`: all of the run."),
]
TimeText = Annotated[str | None, Query(max_length=64, examples=["2026-05-01T08:00:00Z"])]


def time_of(text: str | None, name: str) -> int | None:
    """Return the recorded time that a parameter holds, ns since the Unix epoch.

    Raises
    ------
    ProblemError
        If it is no time.
    """
    try:
        return None if text is None else parse_time(text)
    except InputError as error:
        raise bad_parameter("query", name, str(error)) from error
