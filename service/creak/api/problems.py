"""Every error of the API, as RFC 9457 problem details: one shape, whatever went wrong.

A problem carries ``type``, ``title``, ``status``, ``detail``, ``instance``; a refused parameter adds ``errors``.
"""

import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.types import Scope

from creak.errors import StorageError

MEDIA_TYPE = "application/problem+json"
log = logging.getLogger(__name__)


class ProblemError(Exception):
    """An answer that is a problem.

    Parameters
    ----------
    status : int
        HTTP status.
    kind : str
        What the type's URI ends in, for instance ``unknown-rig``.
    title : str
        The same for every problem of the kind.
    detail : str
        What is wrong this time.
    headers : mapping, optional
    more : mapping, optional
        Further members.
    """

    def __init__(
        self,
        status: int,
        kind: str,
        title: str,
        detail: str,
        *,
        headers: Mapping[str, str] | None = None,
        more: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(detail)
        self.status = status
        self.kind = kind
        self.title = title
        self.detail = detail
        self.headers = headers
        self.more = more

    def body(self, instance: str) -> dict[str, Any]:
        """Return the members of the problem."""
        return {
            "type": f"urn:problem-type:creak:{self.kind}",
            "title": self.title,
            "status": self.status,
            "detail": self.detail,
            "instance": instance,
            **(self.more or {}),
        }


def unknown_rig(name: str) -> ProblemError:
    """Tell that no rig of this name is in the store."""
    return ProblemError(404, "unknown-rig", "Unknown rig", f"there is no rig {name!r}")


def unknown_node(rig: str, name: str, known: list[str]) -> ProblemError:
    """Tell that the rig has no node of this name."""
    detail = f"rig {rig!r} has no node {name!r}; its nodes are {', '.join(map(repr, known))}"
    return ProblemError(404, "unknown-node", "Unknown node", detail)


def unknown_alarm(identifier: str) -> ProblemError:
    """Tell that no alarm has this id."""
    return ProblemError(404, "unknown-alarm", "Unknown alarm", f"there is no alarm {identifier!r}")


def no_estimate(rig: str, node: str, scope: str) -> ProblemError:
    """Tell that the node exists, but nothing is known of it yet."""
    detail = f"rig {rig!r} has no spectrum of node {node!r} over the {scope} yet: no realisation is complete"
    return ProblemError(404, "no-estimate", "Nothing estimated yet", detail)


def bad_parameter(location: str, name: str, problem: str) -> ProblemError:
    """Tell that a parameter holds what it must not hold."""
    errors = [{"in": location, "name": name, "problem": problem}]
    return _bad_parameters(errors)


def internal_error() -> ProblemError:
    """Tell that something failed that should not; the log says what."""
    return ProblemError(500, "internal-error", "Internal error", "the service failed; its log says where")


def _bad_parameters(errors: list[dict[str, str]]) -> ProblemError:
    detail = "; ".join(f"{error['in']} {error['name']}: {error['problem']}" for error in errors)
    return ProblemError(422, "bad-parameter", "Bad parameter", detail, more={"errors": errors})


def instance(scope: Scope) -> str:
    """Return the path that was asked for, as it was asked for."""
    raw = scope.get("raw_path")
    return raw.decode("ascii", "replace") if raw else quote(scope["path"])


def answer(problem: ProblemError, scope: Scope) -> JSONResponse:
    """Return a problem as a response."""
    return JSONResponse(
        problem.body(instance(scope)),
        status_code=problem.status,
        headers=None if problem.headers is None else dict(problem.headers),
        media_type=MEDIA_TYPE,
    )


def install(app: FastAPI) -> None:
    """Turn every exception that a route or the framework raises into a problem."""

    @app.exception_handler(ProblemError)
    async def _problem(request: Request, error: ProblemError) -> JSONResponse:
        return answer(error, request.scope)

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        status = HTTPStatus(error.status_code)
        detail = {
            404: f"there is nothing at {instance(request.scope)}",
            405: f"{request.method} is not possible here",
        }.get(status, str(error.detail))
        kind = status.phrase.lower().replace(" ", "-")
        return answer(ProblemError(status, kind, status.phrase, detail, headers=error.headers), request.scope)

    @app.exception_handler(RequestValidationError)
    async def _validation(request: Request, error: RequestValidationError) -> JSONResponse:
        errors = [
            {
                "in": str(item["loc"][0]),
                "name": ".".join(map(str, item["loc"][1:])),
                "problem": str(item["msg"]),
            }
            for item in error.errors()
        ]
        return answer(_bad_parameters(errors), request.scope)

    @app.exception_handler(StorageError)
    async def _storage(request: Request, error: StorageError) -> JSONResponse:
        log.error("the store failed: %s", error)
        detail = "the store cannot be read at present"
        problem = ProblemError(503, "store-unavailable", "Store unavailable", detail, headers={"Retry-After": "5"})
        return answer(problem, request.scope)
