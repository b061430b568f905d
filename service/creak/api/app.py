"""The application: all routes over one store."""

from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.openapi.utils import get_openapi

from creak import __version__
from creak.api import (
    alarms,
    baselines,
    downloads,
    events,
    health,
    jobs,
    metrics,
    node_actions,
    operate,
    page,
    problems,
    rigs,
    structure,
    webhooks,
)
from creak.api.access import Access, Gate
from creak.api.answers import Answers
from creak.api.events import EventFeed, watched
from creak.api.guard import Guard
from creak.api.models import Answer, Problem
from creak.sinks.database import Store, open_store

_DESCRIPTION = """
Levels, alarms and recordings of the rigs that creak monitors.

Levels are dB re 1 unit squared, `10 log10` of a power; ratios are in dB. Times are ISO 8601 and, where nothing
else is said, *recorded* time: that of the samples. Live figures are those of the last complete realisations
(`scope=window`, the default); `scope=run` gives those of the whole run.

Lists are `{"items": [...], "next": cursor or null}`: ask again with `cursor=` for the page that follows. Every
error is a problem of RFC 9457, `application/problem+json`. Beyond loopback every request needs a key,
`Authorization: Bearer creak_...`, made with `creak key add`.
"""


class Service(FastAPI):
    """FastAPI with creak's own OpenAPI document."""

    def openapi(self) -> dict[str, Any]:
        """Return the document, with the schema of a problem that all routes refer to."""
        if self.openapi_schema is None:
            document = get_openapi(
                title=self.title, version=self.version, description=self.description, routes=self.routes
            )
            template = "#/components/schemas/{model}"
            schema = Problem.model_json_schema(ref_template=template)
            schemas = document.setdefault("components", {}).setdefault("schemas", {})
            schemas.update(schema.pop("$defs", {}))
            schemas["Problem"] = schema
            _add_examples(document)
            self.openapi_schema = document
        return self.openapi_schema


def create_app(
    store: Store | str,
    *,
    rigs_expected: Sequence[str] = (),
    access: Access | None = None,
    models_of: Mapping[str, Path] | None = None,
    data: Path | None = None,
) -> FastAPI:
    """Make the application.

    Parameters
    ----------
    store : Store or str
        The store, or its URL; a store that is opened here is closed when the application ends.
    rigs_expected : sequence of str
        Rigs without which the service is not ready; by default those whose runs go on.
    access : Access
        Keys, limits, and where receivers of webhooks may live; by default as it is safe on loopback.
    models_of : mapping of str to Path, optional
        Model file of each rig that has one, against which its recordings are diagnosed.
    data : Path, optional
        Directory of the recordings, of whose file system the metrics tell.

    Raises
    ------
    ConfigurationError, StorageError
        If the store cannot be opened.
    """
    owned = isinstance(store, str)
    opened = open_store(store) if isinstance(store, str) else store
    feed = EventFeed(opened)

    @asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        try:
            async with watched(feed):
                yield
        finally:
            if owned:
                opened.close()

    app = Service(
        title="creak",
        version=__version__,
        description=_DESCRIPTION,
        lifespan=lifespan,
        docs_url=None,  # these pages load scripts from elsewhere
        redoc_url=None,
        redirect_slashes=False,
    )
    app.state.store = opened
    app.state.feed = feed
    app.state.rigs = tuple(rigs_expected)
    app.state.access = access or Access()
    app.state.models = dict(models_of or {})
    app.state.data = data
    problems.install(app)
    app.add_middleware(Answers, store=opened)
    app.add_middleware(Gate, store=opened, access=app.state.access)
    app.add_middleware(Guard)
    api = APIRouter(prefix="/api/v1")
    for part in (rigs, structure, baselines, node_actions, alarms, operate, downloads, webhooks, jobs, events):
        api.include_router(part.router)
    app.include_router(api)
    for outside in (health, metrics, page):
        app.include_router(outside.router)
    return app


def _add_examples(document: dict[str, Any]) -> None:
    """Give every JSON body the example of its model; put in earlier, it would lose the keys that are null."""
    bodies = {model.__name__: model for model in _models(Answer)}
    for path in document["paths"].values():
        for operation in path.values():
            told = [answer for status, answer in operation["responses"].items() if status.startswith("2")]
            for part in (*told, operation.get("requestBody", {})):
                content = part.get("content", {}).get("application/json")
                if content is not None:
                    content["example"] = bodies[content["schema"]["$ref"].rsplit("/", 1)[1]].example


def _models(root: type[Answer]) -> Iterator[type[Answer]]:
    for model in root.__subclasses__():
        yield model
        yield from _models(model)
