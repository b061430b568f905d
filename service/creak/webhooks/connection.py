"""One request to one address: no redirect, no proxy, no second look-up, and an end to time and size."""

import asyncio
import contextlib
import ssl
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import h11

from creak.webhooks.addresses import Address, Target

_HEAD_BYTES = 16_384
_BODY_BYTES = 65_536
_DRAIN_SECONDS = 0.5


class DeliveryError(Exception):
    """No answer came; says why in one line."""


@dataclass(frozen=True)
class Answer:
    """What a receiver said; its body is read up to a limit and thrown away."""

    status_code: int
    retry_after: str | None


def tls_context() -> ssl.SSLContext:
    """Return the context of all connections; it trusts what the operating system trusts."""
    return ssl.create_default_context()


async def post(
    target: Target,
    addresses: Sequence[Address],
    headers: Mapping[str, str],
    body: bytes,
    *,
    tls: ssl.SSLContext,
    seconds: float,
) -> Answer:
    """Send one request.

    Parameters
    ----------
    target : Target
        Gives name (for TLS and the ``Host`` header), port and path.
    addresses : sequence
        To which connections may be made; the first that takes one is used.
    headers, body
        Beside ``Host``, ``Content-Length`` and ``Connection``.
    tls : ssl.SSLContext
    seconds : float
        For everything together, so that an answer that trickles in ends as well.

    Raises
    ------
    DeliveryError
        If there was no answer in time, or none that is HTTP.
    """
    try:
        async with asyncio.timeout(seconds):
            reader, writer = await _connect(target, addresses, tls)
            try:
                return await _exchange(target, reader, writer, headers, body)
            finally:
                writer.transport.abort()  # a polite close of TLS may wait for the other side
    except TimeoutError:
        raise DeliveryError(f"no answer within {seconds:g} s") from None
    except ssl.SSLError as error:
        raise DeliveryError(f"TLS: {error.reason or error}") from None
    except h11.ProtocolError as error:
        raise DeliveryError(f"the answer is not HTTP: {error}") from None
    except OSError as error:
        raise DeliveryError(error.strerror or str(error) or type(error).__name__) from None


async def _connect(
    target: Target, addresses: Sequence[Address], tls: ssl.SSLContext
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    for address in addresses:
        last = address is addresses[-1]
        with contextlib.suppress(*(() if last else (OSError,))):
            return await asyncio.open_connection(
                str(address),
                target.port,
                ssl=tls if target.tls else None,
                server_hostname=target.host if target.tls else None,
            )
    raise AssertionError("the last address raises")


async def _exchange(
    target: Target,
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
    headers: Mapping[str, str],
    body: bytes,
) -> Answer:
    connection = h11.Connection(h11.CLIENT, max_incomplete_event_size=_HEAD_BYTES)
    fields = {"host": target.authority, **headers, "content-length": str(len(body)), "connection": "close"}
    request = h11.Request(method="POST", target=target.path, headers=list(fields.items()))
    for part in (request, h11.Data(body), h11.EndOfMessage()):
        writer.write(connection.send(part) or b"")
    with contextlib.suppress(ConnectionError):  # who refuses a request may answer without having read it
        await writer.drain()
    while True:
        event = connection.next_event()
        if event is h11.NEED_DATA:
            connection.receive_data(await reader.read(8192))
        elif isinstance(event, h11.InformationalResponse):
            continue  # the answer follows it (RFC 9110, 15.2)
        elif isinstance(event, h11.Response):
            asked = next((value for name, value in event.headers if name == b"retry-after"), None)
            await _drain(reader)
            return Answer(event.status_code, None if asked is None else asked.decode("latin-1"))
        else:
            raise DeliveryError("the connection was closed without an answer")


async def _drain(reader: asyncio.StreamReader) -> None:
    """Let the other side finish what it says, within limits; whatever it is, the status stands already."""
    left = _BODY_BYTES
    with contextlib.suppress(OSError, TimeoutError):
        async with asyncio.timeout(_DRAIN_SECONDS):
            while left > 0 and (data := await reader.read(8192)):
                left -= len(data)
