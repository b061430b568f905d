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
    400: "The path or the body cannot be read.",
    401: "A key is needed, or the one given is none.",
    403: "The key's scope is too small, or a page of another site asks.",
    404: "There is no such thing.",
    408: "The body did not come in time.",
    409: "What is asked for does not fit what is there.",
    410: "The file is no longer there.",
    412: "It has changed since the client saw it.",
    413: "The body is too long.",
    416: "The file has no such range of bytes.",
    421: "Without keys the API is called by an address or localhost.",
    422: "A parameter holds what it must not hold.",
    429: "Too many requests.",
    500: "The service failed.",
    503: "The store cannot be read at present.",
}


_ALWAYS = (400, 401, 403, 408, 413, 421, 429, 500, 503)


def refusals(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the documented problems of a route: the given statuses, beside those that every route may answer."""
    return {
        status: {
            "description": _MEANINGS[status],
            "content": {
                MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}, "example": Problem.example}
            },
        }
        for status in sorted({*_ALWAYS, *statuses})
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
