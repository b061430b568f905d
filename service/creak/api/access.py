"""Who may do what, how often and with how much: keys, rates, sizes, and the audit log.

On loopback no key is needed, as anybody who can connect there is on the machine already; what is kept out is a web
page that the machine's browser has loaded from elsewhere. Beyond loopback every request needs a key but those for
what holds no data.
"""

import asyncio
import ipaddress
import logging
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

from anyio.to_thread import run_sync
from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from creak.api.problems import ProblemError, answer
from creak.errors import StorageError
from creak.sinks import audit, keys
from creak.sinks.database import Store
from creak.sinks.keys import Key, KeyScope

log = logging.getLogger(__name__)

_SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
_OPEN = frozenset({"/", "/healthz", "/readyz", "/openapi.json"})
_ADMIN = ("/api/v1/webhooks", "/api/v1/audit")
_CLIENTS = 10_000
_BODY_SECONDS = 10.0
_KEY_SECONDS = 5.0  # so long a removed key may still be good


@dataclass(frozen=True)
class Access:
    """What the API lets through.

    Parameters
    ----------
    keys : bool
        True if requests need a key.
    allow : sequence of str
        Networks in which receivers of webhooks may live, beyond the public ones.
    per_second : float
        Requests a second that one client may make in the long run, twice as many at once.
    body_bytes : int
        Longest body of a request.
    """

    keys: bool = False
    allow: Sequence[str] = ()
    per_second: float = 500.0
    body_bytes: int = 65_536


class Rates:
    """Token buckets by client; the clients that were heard of longest ago are forgotten first.

    Parameters
    ----------
    per_second : float
    burst : float
    """

    def __init__(self, per_second: float, burst: float) -> None:
        self._rate = per_second
        self._burst = burst
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()

    def take(self, client: str, now: float) -> float:
        """Take a token; 0, or the seconds until there is one."""
        tokens, wait = self._tokens(client, now), self.wait(client, now)
        self._buckets.pop(client, None)
        self._buckets[client] = (tokens - 1.0 if wait == 0 else tokens, now)
        while len(self._buckets) > _CLIENTS:
            self._buckets.popitem(last=False)
        return wait

    def wait(self, client: str, now: float) -> float:
        """Seconds until there is a token, none of which is taken; 0 if there is one."""
        tokens = self._tokens(client, now)
        return 0.0 if tokens >= 1.0 else (1.0 - tokens) / self._rate

    def _tokens(self, client: str, now: float) -> float:
        tokens, at = self._buckets.get(client, (self._burst, now))
        return min(self._burst, tokens + (now - at) * self._rate)


class Gate:
    """ASGI middleware that answers for itself what must not come further.

    Parameters
    ----------
    app : ASGIApp
    store : Store
    access : Access
    """

    def __init__(self, app: ASGIApp, store: Store, access: Access) -> None:
        self.app = app
        self._store = store
        self._access = access
        self._rates = Rates(access.per_second, 2 * access.per_second)
        self._failures = Rates(1.0, 20.0)  # of guessing keys
        self._known: dict[str, tuple[Key, float]] = {}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        headers, method, path = Headers(scope=scope), scope["method"], scope["path"]
        address = scope["client"][0] if scope.get("client") else ""
        who = ""

        async def noted(message: Message) -> None:
            if message["type"] == "http.response.start" and _worth_noting(method, message["status"]):
                await self._note(who, address, method, path, message["status"])
            await send(message)

        try:
            if path not in _OPEN and not path.startswith("/static/"):
                key = await self._key(headers, address)
                who = "" if key is None else key.name
                self._limit(address if key is None else key.id)
                self._admit(key, headers, method, path)
            body = await self._body(headers, receive)
        except ProblemError as problem:
            await answer(problem, scope)(scope, receive, noted)
            return
        except StorageError as error:
            log.warning("the store failed: %s", error)
            refusal = ProblemError(503, "store-unavailable", "Store unavailable", "keys cannot be read at present")
            await answer(refusal, scope)(scope, receive, noted)
            return
        await self.app(scope, receive if body is None else _replay(body, receive), noted)

    async def _key(self, headers: Headers, address: str) -> Key | None:
        """Return the key of a request; None if it has none and needs none."""
        token = headers.get("x-api-key", "")
        scheme, _, credentials = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer":
            token = credentials.strip()
        if not token:
            if self._access.keys:
                raise _unauthorized("this needs a key: Authorization: Bearer creak_...")
            return None
        now = time.monotonic()
        known = self._known.get(token)
        if known is not None and now < known[1]:
            return known[0]
        wait = self._failures.wait(address, now)
        if wait > 0:
            raise _too_many(wait, "too many keys were tried from this address")

        def look() -> Key | None:
            with self._store.read() as connection:
                return keys.find(connection, token)

        key = await run_sync(look)
        if key is None:
            self._failures.take(address, time.monotonic())
            raise _unauthorized("this is no key")
        if len(self._known) > _CLIENTS:
            self._known.clear()
        self._known[token] = (key, now + _KEY_SECONDS)
        return key

    def _limit(self, client: str) -> None:
        wait = self._rates.take(client, time.monotonic())
        if wait > 0:
            raise _too_many(wait, f"more than {self._access.per_second:g} requests a second")

    def _admit(self, key: Key | None, headers: Headers, method: str, path: str) -> None:
        if key is None:
            _keep_pages_out(headers, method)
            return
        needed = _needed(method, path)
        if not key.scope.covers(needed):
            detail = f"this needs a key of scope {needed.value}; {key.name!r} has {key.scope.value}"
            raise ProblemError(403, "scope-too-small", "Scope too small", detail)

    async def _body(self, headers: Headers, receive: Receive) -> bytes | None:
        """Read the body of a request, up to its limit; None if it has none."""
        length, limit = headers.get("content-length"), self._access.body_bytes
        if length is None and "transfer-encoding" not in headers:
            return None
        too_long = ProblemError(413, "body-too-long", "Body too long", f"a body may have {limit} bytes")
        if length is not None and length.isdigit() and int(length[:20]) > limit:
            raise too_long
        body = b""
        try:
            async with asyncio.timeout(_BODY_SECONDS):
                while True:
                    message = await receive()
                    if message["type"] == "http.disconnect":
                        return body
                    body += bytes(message.get("body", b""))
                    if len(body) > limit:
                        raise too_long
                    if not message.get("more_body", False):
                        return body
        except TimeoutError:
            detail = f"the body did not come within {_BODY_SECONDS:g} s"
            raise ProblemError(408, "request-timeout", "Request timeout", detail) from None

    async def _note(self, who: str, address: str, method: str, path: str, status: int) -> None:
        def write() -> None:
            with self._store.write() as connection:
                audit.note(connection, who, address, method, path, status)

        try:
            await run_sync(write)
        except StorageError as error:
            log.warning(
                "not in the audit log: %s %s %s by %r from %s (%s)", status, method, path, who, address, error
            )


def _worth_noting(method: str, status: int) -> bool:
    return (method not in _SAFE and status != 429) or status in {401, 403}


def _needed(method: str, path: str) -> KeyScope:
    if path.startswith(_ADMIN):
        return KeyScope.ADMIN
    if method in _SAFE:
        return KeyScope.READ
    return KeyScope.OPERATE if method == "POST" else KeyScope.ADMIN


def _keep_pages_out(headers: Headers, method: str) -> None:
    """Refuse what a page from elsewhere makes a browser on this machine ask."""
    host = headers.get("host", "")
    name = host.rsplit(":", 1)[0] if not host.endswith("]") else host
    if name.lower().rstrip(".") != "localhost" and not _is_address(name.strip("[]")):
        detail = f"no keys are asked for here, so the API is to be called by an address or localhost, not {host!r}"
        raise ProblemError(421, "misdirected-request", "Misdirected request", detail)
    if method not in _SAFE and headers.get("sec-fetch-site", "none") not in {"none", "same-origin"}:
        raise ProblemError(403, "cross-site", "Cross-site request", "a page of another site must not ask for this")


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def _unauthorized(detail: str) -> ProblemError:
    return ProblemError(401, "unauthorized", "Unauthorized", detail, headers={"WWW-Authenticate": "Bearer"})


def _too_many(wait: float, detail: str) -> ProblemError:
    seconds = str(max(1, round(wait + 0.5)))
    return ProblemError(429, "too-many-requests", "Too many requests", detail, headers={"Retry-After": seconds})


def _replay(body: bytes, receive: Receive) -> Receive:
    """Give the body that was read once more, then what else comes."""
    given = False

    async def again() -> Message:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again
