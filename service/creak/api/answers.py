"""Answers that are kept, ready to send, for as long as nothing in the store has changed.

Many clients ask for the same few figures, and a rig has new ones once in a while.
"""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from creak.errors import StorageError
from creak.sinks.database import Store

_PREFIX = "/api/v1/"
_CONDITIONS = ("if-none-match", "if-match", "range")
_MOST = 1_000
_LONGEST_BYTES = 262_144


class Answers:
    """ASGI middleware that answers a question once more without asking the routes.

    Only whole JSON answers with status 200 are kept, and none where the store cannot tell whether it has changed.

    Parameters
    ----------
    app : ASGIApp
    store : Store
    """

    def __init__(self, app: ASGIApp, store: Store) -> None:
        self.app = app
        self._store = store
        self._version: int | None = None
        self._kept: dict[tuple[str, bytes], tuple[Message, Message]] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if not _may_be_kept(scope):
            await self.app(scope, receive, send)
            return
        question = scope["path"], scope["query_string"]
        version = self._newest()
        kept = self._kept.get(question)
        if kept is not None:
            start, body = kept
            await send({**start, "headers": list(start["headers"])})  # layers above add theirs
            await send(body)
            return
        start = {}

        async def noted(message: Message) -> None:
            nonlocal start
            if message["type"] == "http.response.start":
                start = {**message, "headers": list(message["headers"])}
            elif version is not None and version == self._version and _worth_keeping(start, message):
                if len(self._kept) >= _MOST:
                    self._kept.clear()
                self._kept[question] = start, message
            await send(message)

        await self.app(scope, receive, noted)

    def _newest(self) -> int | None:
        """Return the version of the store, and forget the answers of any other; None if it cannot be told."""
        try:
            version = self._store.version()
        except StorageError:
            version = None  # the route says what is wrong
        if version is None or version != self._version:
            self._kept.clear()
            self._version = version
        return version


def _may_be_kept(scope: Scope) -> bool:
    if scope["type"] != "http" or scope["method"] != "GET" or not scope["path"].startswith(_PREFIX):
        return False
    headers = Headers(scope=scope)
    return not any(name in headers for name in _CONDITIONS)


def _worth_keeping(start: Message, message: Message) -> bool:
    """Tell whether a message is all of an answer, and one that may be given again."""
    return (
        start.get("status") == 200
        and not message.get("more_body", False)
        and len(message.get("body", b"")) <= _LONGEST_BYTES
        and Headers(raw=start["headers"]).get("content-type") == "application/json"
        and int(Headers(raw=start["headers"]).get("content-length", "-1")) == len(message.get("body", b""))
    )
