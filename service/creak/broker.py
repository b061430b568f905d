"""The connection to NATS JetStream, kept in a thread of its own; whoever calls waits, and may be any thread.

Streams are read by sequence and not through a consumer of the broker's: how far a reader has come stands where its
results do (:mod:`creak.sinks.fleet`), so there is nothing to be acknowledged and no second truth.
"""

import asyncio
import contextlib
import logging
import threading
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from creak.errors import BrokerError, InputError

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.subscription import Subscription

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_RETRY_SECONDS = 0.5
_ANSWER_SECONDS = 5.0
_DUPLICATES_SECONDS = 120.0  # how long the broker remembers ids; readers know for ever what they have taken


@dataclass(frozen=True)
class Message:
    """A message of the stream."""

    sequence: int
    headers: Mapping[str, str]
    data: bytes


@dataclass(frozen=True)
class StreamLimits:
    """What the broker keeps: seconds, and bytes of the whole stream (None for no limit)."""

    seconds: float
    size: int | None = None


class Broker:
    """One connection, made again for as long as it takes whenever it breaks.

    Parameters
    ----------
    url : str
        ``nats://host:port``.
    stream : str
        Name of the stream; its subjects are ``NAME.digests.*``.
    limits : StreamLimits
        Of the stream, should it have to be made.
    credentials : Path or None
        File with the user's credentials.

    Raises
    ------
    InputError
        If the library is not installed.

    Notes
    -----
    All methods raise BrokerError if there is no connection, or no answer in time.
    """

    def __init__(self, url: str, stream: str, limits: StreamLimits, credentials: Path | None = None) -> None:
        try:
            import nats

            if credentials is not None:
                import nkeys  # noqa: F401 - which the library asks for only when it connects
        except ImportError:
            raise InputError('streams need the extra "nats": pip install "creak[nats]"') from None
        self._connect = nats.connect
        self._options: dict[str, Any] = {"servers": [url]}
        if credentials is not None:
            self._options["user_credentials"] = str(credentials)
        self._stream = stream
        self._limits = limits
        self._client: Client | None = None
        self._told = False
        self._listening: dict[str, Subscription] = {}
        self.generation = 0
        """Counts the times that a connection came about; a reader then has to look again."""
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=f"broker {url}", daemon=True)
        self._thread.start()
        asyncio.run_coroutine_threadsafe(self._begin(), self._loop)

    @property
    def connected(self) -> bool:
        """True while the broker can be reached, as far as is known."""
        return self.generation > 0 and self._client is not None and self._client.is_connected

    @property
    def largest(self) -> int:
        """Bytes that a message may have, its headers included."""
        return self._ready().max_payload

    def identity(self) -> tuple[str, int]:
        """Tell the stream from one of the same name that was made anew, and give its newest sequence."""
        info = self._await(self._ready().jetstream(timeout=_ANSWER_SECONDS).stream_info(self._stream))
        return str(info.created), int(info.state.last_seq)

    def publish(self, subject: str, data: bytes, headers: dict[str, str]) -> int:
        """Have the stream keep a message, once for each ``Nats-Msg-Id``; its sequence."""
        stream = self._ready().jetstream(timeout=_ANSWER_SECONDS)
        return int(self._await(stream.publish(subject, data, stream=self._stream, headers=headers)).seq)

    def next(self, subject: str, after: int) -> Message | None:
        """Return the first message of a subject after a sequence; None if there is none yet."""
        from nats.js.errors import NotFoundError

        stream = self._ready().jetstream(timeout=_ANSWER_SECONDS)
        wanted = stream.get_msg(self._stream, seq=after + 1, subject=subject, direct=True, next=True)
        try:
            found = self._await(wanted)
        except BrokerError as error:
            if isinstance(error.__cause__, NotFoundError):
                return None
            raise
        return Message(found.seq or 0, found.headers or {}, found.data or b"")

    def tell(self, subject: str, data: bytes) -> None:
        """Send what nobody has to hear."""
        self._await(self._ready().publish(subject, data))

    def listen(self, subject: str, heard: Callable[[bytes], None]) -> None:
        """Hear what is told, in the broker's thread, until :meth:`ignore`."""

        async def subscribe() -> None:
            async def pass_on(message: Any) -> None:
                heard(message.data)

            if subject not in self._listening:
                self._listening[subject] = await self._ready().subscribe(subject, cb=pass_on)

        self._await(subscribe())

    def ignore(self, subject: str) -> None:
        """Hear no more of a subject."""

        async def unsubscribe() -> None:
            subscription = self._listening.pop(subject, None)
            if subscription is not None:
                await subscription.unsubscribe()

        with contextlib.suppress(BrokerError):
            self._await(unsubscribe())

    def close(self) -> None:
        """End the connection; a second call is harmless."""
        if self._loop.is_closed():
            return

        async def end() -> None:
            client, self._client = self._client, None
            if client is not None:
                await client.close()
            for task in asyncio.all_tasks() - {asyncio.current_task()}:
                task.cancel()

        with contextlib.suppress(TimeoutError):
            asyncio.run_coroutine_threadsafe(end(), self._loop).result(_ANSWER_SECONDS)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_ANSWER_SECONDS)
        if not self._thread.is_alive():
            self._loop.close()

    async def _begin(self) -> None:
        """Connect, however long that takes, and see to the stream."""
        while self._client is None:
            try:
                self._client = await self._connect(
                    **self._options,
                    connect_timeout=2,
                    reconnect_time_wait=_RETRY_SECONDS,
                    max_reconnect_attempts=-1,
                    error_cb=self._note_error,
                    reconnected_cb=self._arrive,
                )
            except Exception as error:  # noqa: BLE001 - credentials that cannot be read, say, and may be there later
                await self._note_error(error)
                await asyncio.sleep(_RETRY_SECONDS)
        await self._arrive()

    async def _arrive(self) -> None:
        from nats.js.api import StreamConfig

        if self._client is None:
            return
        wanted = StreamConfig(
            name=self._stream,
            subjects=[f"{self._stream}.digests.*"],
            max_age=self._limits.seconds,
            max_bytes=self._limits.size,
            duplicate_window=min(_DUPLICATES_SECONDS, self._limits.seconds),
            allow_direct=True,
        )
        while True:
            try:
                await self._client.jetstream(timeout=_ANSWER_SECONDS).add_stream(wanted)
            except Exception as error:  # noqa: BLE001 - whatever it is: said once, and tried again
                if "already in use" in str(error):  # with other limits: those of the broker hold
                    break
                await self._note_error(error)
                await asyncio.sleep(_RETRY_SECONDS)
            else:
                break
        self.generation += 1
        if self._told:
            _log.warning("the broker answers again")
        self._told = False

    async def _note_error(self, error: Exception) -> None:
        if not self._told:
            self._told = True
            _log.warning("the broker cannot be reached: %s", str(error) or type(error).__name__)

    def _ready(self) -> "Client":
        if not self.connected:
            raise BrokerError("there is no connection to the broker")
        assert self._client is not None
        return self._client

    def _await(self, wanted: Coroutine[Any, Any, _T]) -> _T:
        future = asyncio.run_coroutine_threadsafe(wanted, self._loop)
        try:
            return future.result(2 * _ANSWER_SECONDS)
        except Exception as error:
            future.cancel()
            raise BrokerError(f"the broker: {str(error) or type(error).__name__}") from error
