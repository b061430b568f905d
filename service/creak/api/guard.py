"""The outermost layer: paths with odd characters, headers of every answer, and the last resort for failures."""

import logging
from urllib.parse import unquote_to_bytes

from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from creak.api.problems import ProblemError, answer, internal_error

log = logging.getLogger(__name__)

SLASH = "\x1f"
"""Stands for a slash inside a name while routes are matched; no name may hold it, so nothing is ambiguous."""

_PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_API_POLICY = "default-src 'none'; frame-ancestors 'none'"
_ALWAYS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def routed_path(raw: bytes) -> str | None:
    """Return the path as routes are to see it, `SLASH` for a ``%2F``; None if it holds what no name may hold."""
    segments = []
    for segment in raw.split(b"/"):
        try:
            text = unquote_to_bytes(segment).decode("utf-8")
        except UnicodeDecodeError:
            return None
        if any(character < " " or character == "\x7f" for character in text):
            return None
        segments.append(text.replace("/", SLASH))
    return "/".join(segments)


class Guard:
    """ASGI middleware around the whole application."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        started = False

        async def guarded(message: Message) -> None:
            nonlocal started
            if message["type"] == "http.response.start":
                started = True
                _add_headers(MutableHeaders(scope=message))
            await send(message)

        path = routed_path(scope.get("raw_path") or scope["path"].encode())
        if path is None:
            detail = "the path holds control characters or is not UTF-8"
            await answer(ProblemError(400, "bad-path", "Bad path", detail), scope)(scope, receive, guarded)
            return
        try:
            await self.app({**scope, "path": path}, receive, guarded)
        except Exception:
            if started:
                raise  # the answer has begun and can only be cut off; the server logs why
            log.exception("a request failed: %s", scope["path"])
            await answer(internal_error(), scope)(scope, receive, guarded)


def _add_headers(headers: MutableHeaders) -> None:
    for name, value in _ALWAYS.items():
        headers[name] = value
    page = headers.get("content-type", "").startswith("text/html")
    headers.setdefault("Content-Security-Policy", _PAGE_POLICY if page else _API_POLICY)
    headers.setdefault("Cache-Control", "no-store")
