"""The event stream: what happens, as server-sent events that a client can resume without gaps.

One task of the application asks the store for the newest event id while anybody listens; each client reads the
events themselves from where it stands, so one that stalls holds up nobody and takes no memory here.
"""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Header, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from creak.api.describe import StoreOf, refusals
from creak.errors import StorageError
from creak.sinks import queries
from creak.sinks.database import Store

router = APIRouter(tags=["events"])
log = logging.getLogger(__name__)

_POLL_SECONDS = 0.25
_BATCH = 200
_RETRY_MS = 1000
_EXAMPLE = (
    "event: alarm\n"
    'data: {"id":"9f3c1b6e","rig":"beam","node":"3","class":"process","severity":"alarm","event":"raised"}\n'
    "id: 1042\n\n"
)


class EventFeed:
    """Tells listeners that there are new events, and when the service ends.

    Parameters
    ----------
    store : Store
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self._listeners = 0
        self._newest = 0
        self._closed = False
        self._news = asyncio.Event()
        self._wanted = asyncio.Event()

    @property
    def closed(self) -> bool:
        """True once the service ends."""
        return self._closed

    def close(self) -> None:
        """End all streams; called on the event loop."""
        self._closed = True
        self._announce()

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[None]:
        """Keep the store watched while the block lasts."""
        self._listeners += 1
        self._wanted.set()
        try:
            yield
        finally:
            self._listeners -= 1
            if not self._listeners:
                self._wanted.clear()

    async def wait(self, after: int) -> None:
        """Return once there is an event of a higher id, or the service ends."""
        while self._newest <= after and not self._closed:
            await self._news.wait()

    async def run(self) -> None:
        """Watch the store while anybody listens; runs as a task until it is cancelled."""
        while True:
            await self._wanted.wait()
            try:
                _, newest = await run_sync(_range, self._store)
            except StorageError as error:
                log.warning("the event stream waits for the store: %s", error)
            else:
                if newest > self._newest:
                    self._newest = newest
                    self._announce()
            await asyncio.sleep(_POLL_SECONDS)

    def _announce(self) -> None:
        self._news.set()
        self._news = asyncio.Event()


@dataclass(frozen=True)
class Start:
    """Where a stream begins.

    Parameters
    ----------
    after : int
        Id of the event before the first.
    lost : bool
        True if the client asked for events that are no longer kept, or that this store never had.
    """

    after: int
    lost: bool


def _start(
    store: StoreOf,
    last_event_id: Annotated[
        int | None,
        Header(ge=0, lt=2**63, description="Id of the event received last; browsers send it by themselves."),
    ] = None,
) -> Start:
    """Find where to begin, before the answer does, so that a failure is still an answer of its own."""
    oldest, newest = _range(store)
    if last_event_id is None:
        return Start(newest, lost=False)
    if last_event_id > newest:
        return Start(newest, lost=True)
    return Start(max(last_event_id, oldest - 1), lost=last_event_id < oldest - 1)


def _range(store: Store) -> tuple[int, int]:
    with store.read() as connection:
        return queries.event_range(connection)


def _read(store: Store, after: int) -> list[queries.Event]:
    with store.read() as connection:
        return queries.events(connection, after, _BATCH)


_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: {"description": "Events as they happen.", "content": {"text/event-stream": {"example": _EXAMPLE}}},
    **refusals(422),
}


@router.get("/events", response_class=EventSourceResponse, responses=_ANSWERS)
async def stream_events(
    request: Request, store: StoreOf, start: Annotated[Start, Depends(_start)]
) -> AsyncIterator[ServerSentEvent]:
    """Stream what happens: `run` (begun or ended), `levels`, `alarm`, `fault`, each with JSON data and an id.

    A client that reconnects with `Last-Event-ID` misses nothing as long as the events are kept (some thousands);
    if they are not, the stream begins with an event `reset`, after which everything is to be read anew.
    """
    feed: EventFeed = request.app.state.feed
    after = start.after
    yield ServerSentEvent(comment="creak", retry=_RETRY_MS)
    if start.lost:
        yield ServerSentEvent(event="reset", raw_data="{}", id=str(after))
    async with feed.listening():
        while not feed.closed:
            try:
                batch = await run_sync(_read, store, after)
            except StorageError as error:
                log.warning("an event stream ends: %s", error)
                return  # the client comes back with the last id it has
            for event in batch:
                yield ServerSentEvent(event=event.kind, raw_data=event.payload, id=str(event.id))
                after = event.id
            if len(batch) < _BATCH:
                await feed.wait(after)


@asynccontextmanager
async def watched(feed: EventFeed) -> AsyncIterator[None]:
    """Run the feed's task while the block lasts."""
    task = asyncio.create_task(feed.run(), name="event feed")
    task.add_done_callback(lambda ended: _ended(feed, ended))
    try:
        yield
    finally:
        feed.close()
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task


def _ended(feed: EventFeed, task: asyncio.Task[None]) -> None:
    feed.close()  # without the task nobody would hear anything, so nobody is left waiting
    if not task.cancelled() and (error := task.exception()) is not None:
        log.error("the event stream failed", exc_info=error)
