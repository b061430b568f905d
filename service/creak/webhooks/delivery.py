"""The loop that takes messages from the outbox to their receivers: at least once, in order, each for itself.

It runs in a thread of its own with an event loop of its own, so that neither the API nor a worker waits for a
receiver. Several processes may run it on one store: one of them holds the lease and delivers.
"""

import asyncio
import logging
import random
import ssl
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import sqlalchemy as sa

from creak import __version__
from creak.errors import RefusedAddressError, StorageError
from creak.sinks import leases, outbox, receivers
from creak.sinks.database import Store
from creak.sinks.outbox import Attempt, Message
from creak.sinks.receivers import Receiver
from creak.webhooks import trouble
from creak.webhooks.addresses import AddressPolicy, Resolver, parse_target, resolve, system_resolver
from creak.webhooks.connection import Answer, DeliveryError, post, tls_context
from creak.webhooks.schedule import SECOND, RateCap, Schedule, read_retry_after
from creak.webhooks.signature import sign

_log = logging.getLogger(__name__)

_LEASE = "webhooks"
_LEASE_SECONDS = 10.0
_RENEW_SECONDS = 2.0
_POLL_SECONDS = 0.2
_TROUBLE_SECONDS = 2.0
_MEDIA_TYPES = {"standard": "application/json", "cloudevents": "application/cloudevents+json"}


@dataclass(frozen=True)
class DeliveryRules:
    """How messages are delivered.

    Parameters
    ----------
    timeout : float
        Seconds that one attempt may take in all.
    per_minute : float
        Requests that one receiver gets at most in the long run.
    burst : int
        Requests that it gets at once after a quiet time.
    storm : int
        Waiting messages from which on they are put together, once the receiver's rate is used up.
    at_once : int
        Receivers that are served at the same time.
    schedule : Schedule
    """

    timeout: float = 10.0
    per_minute: float = 120.0
    burst: int = 30
    storm: int = 10
    at_once: int = 32
    schedule: Schedule = field(default_factory=Schedule)


class Deliverer:
    """Delivers the messages of a store until it is stopped.

    Parameters
    ----------
    store : Store
    policy : AddressPolicy
        Where receivers may live.
    rules : DeliveryRules
    resolver : callable
        Host to addresses.
    clock : callable
        Wall clock, ns since the Unix epoch.
    """

    def __init__(
        self,
        store: Store,
        policy: AddressPolicy,
        rules: DeliveryRules | None = None,
        *,
        resolver: Resolver = system_resolver,
        clock: Callable[[], int] = time.time_ns,
    ) -> None:
        self._store = store
        self._policy = policy
        self._rules = rules or DeliveryRules()
        self._resolver = resolver
        self._clock = clock
        self._owner = leases.new_owner()
        self._tls: ssl.SSLContext = tls_context()
        self._caps: dict[str, RateCap] = {}
        self._serving: dict[str, asyncio.Task[None]] = {}
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="webhooks", daemon=True)

    def start(self) -> None:
        """Begin; returns at once."""
        self._thread.start()

    def stop(self, seconds: float = 3.0) -> None:
        """End, and wait for that; an attempt under way is broken off and made again by whoever comes next."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join(seconds)

    def _run(self) -> None:
        asyncio.run(self._main())

    async def _main(self) -> None:
        # look-ups of names that take long must not keep the others from the store
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor(2 * self._rules.at_once + 4))
        held_until = 0.0
        try:
            while not self._stopping.is_set():
                try:
                    if time.monotonic() >= held_until - _LEASE_SECONDS + _RENEW_SECONDS:
                        begun = time.monotonic()
                        held_until = begun + _LEASE_SECONDS if await asyncio.to_thread(self._hold) else 0.0
                    if held_until:
                        await self._serve_due()
                    pause = _POLL_SECONDS
                except StorageError as error:
                    _log.warning("webhooks wait for the store: %s", error)
                    pause = _TROUBLE_SECONDS
                if time.monotonic() >= held_until:
                    self._break_off()  # somebody else may deliver by now
                await asyncio.to_thread(self._stopping.wait, pause)
        finally:
            self._break_off()
            await asyncio.gather(*self._serving.values(), return_exceptions=True)
            try:
                with self._store.write() as connection:
                    leases.release(connection, _LEASE, self._owner)
            except StorageError as error:
                _log.warning("the lease on webhooks runs out by itself: %s", error)

    def _break_off(self) -> None:
        for task in self._serving.values():
            task.cancel()

    def _hold(self) -> bool:
        now = self._clock()
        with self._store.write(durable=False) as connection:
            return leases.hold(connection, _LEASE, self._owner, now, now + round(_LEASE_SECONDS * SECOND))

    async def _serve_due(self) -> None:
        """Begin to serve every receiver for which something is due and which is not being served."""
        self._serving = {name: task for name, task in self._serving.items() if not task.done()}
        for name in await asyncio.to_thread(self._due):
            if name not in self._serving and len(self._serving) < self._rules.at_once:
                task = asyncio.create_task(self._serve(name), name=f"webhook {name}")
                task.add_done_callback(_say_why_it_ended)
                self._serving[name] = task

    def _due(self) -> list[str]:
        with self._store.read() as connection:
            return outbox.due_receivers(connection, self._clock())

    async def _serve(self, name: str) -> None:
        """Send what is due for one receiver, one message after the other."""
        while not self._stopping.is_set():
            receiver, message = await asyncio.to_thread(self._next, name)
            if receiver is None or message is None:
                return
            cap = self._caps.setdefault(name, RateCap(self._rules.per_minute, self._rules.burst))
            pause = cap.take(time.monotonic())
            if pause > 0:
                await asyncio.to_thread(self._coalesce, receiver)
                await asyncio.sleep(min(pause, _TROUBLE_SECONDS))
                continue
            begun, started = self._clock(), time.monotonic()
            answer = await self._attempt(receiver, message, begun)
            seconds = time.monotonic() - started
            await asyncio.to_thread(self._settle, receiver, message, answer, begun, seconds)

    def _next(self, name: str) -> tuple[Receiver | None, Message | None]:
        now = self._clock()
        with self._store.read() as connection:
            receiver = receivers.get(connection, name)
            if receiver is None or not receiver.enabled or receiver.paused_until_at > now:
                return None, None
            return receiver, outbox.next_due(connection, name, now)

    def _coalesce(self, receiver: Receiver) -> None:
        """Put together what waits, if it is a storm; counted only here, as a long backlog takes long to count."""
        with self._store.read() as connection:
            if outbox.backlog(connection, receiver.id) < self._rules.storm:
                return
        with self._store.write() as connection:
            outbox.coalesce(connection, receiver, self._clock())

    async def _attempt(self, receiver: Receiver, message: Message, now: int) -> Answer | str:
        """Send a message; the answer, or why there is none."""
        body = message.body.encode()
        headers = {
            "content-type": _MEDIA_TYPES[receiver.format],
            "user-agent": f"creak/{__version__}",
            **sign(message.id, now // SECOND, body, receiver.secrets(now)),
        }
        seconds = self._rules.timeout
        try:
            target = parse_target(receiver.url)
            addresses = await resolve(target, self._policy, resolver=self._resolver, seconds=seconds)
            return await post(target, addresses, headers, body, tls=self._tls, seconds=seconds)
        except (DeliveryError, RefusedAddressError) as error:
            return str(error)

    def _settle(
        self,
        receiver: Receiver,
        message: Message,
        answer: Answer | str,
        begun: int,
        seconds: float,
    ) -> None:
        """Write what became of an attempt, and what follows for the receiver, in one transaction."""
        code = answer.status_code if isinstance(answer, Answer) else None
        now = self._clock()
        with self._store.write() as connection:
            if code is not None and 200 <= code < 300:
                outbox.settle(connection, message, Attempt(begun, seconds, code, "delivered", "", now))
                if receiver.failing_since_at is not None:
                    receivers.update(connection, receiver.id, failing_since_at=None, paused_until_at=0)
                return
            error = answer if isinstance(answer, str) else f"the receiver answered {code}"
            asked = None
            if isinstance(answer, Answer) and answer.retry_after is not None:
                asked = read_retry_after(answer.retry_after, now)
            schedule = self._rules.schedule
            next_at = schedule.next_at(now, message.attempts + 1, random.random(), asked)
            outcome = "failed" if next_at is None else "retried"
            outbox.settle(connection, message, Attempt(begun, seconds, code, outcome, error, next_at or now))
            self._note_failure(connection, receiver, code, asked, error, now)

    def _note_failure(
        self,
        connection: sa.Connection,
        receiver: Receiver,
        code: int | None,
        asked: float | None,
        error: str,
        now: int,
    ) -> None:
        schedule = self._rules.schedule
        since = now if receiver.failing_since_at is None else receiver.failing_since_at
        values: dict[str, object] = {"failing_since_at": since}
        if asked is not None:  # it speaks for the receiver, not for one message
            values["paused_until_at"] = now + round(min(asked, schedule.longest_wait) * SECOND)
        receivers.update(connection, receiver.id, **values)
        if code == 410:
            trouble.disable(connection, receiver, "the receiver answered 410: it is gone", now)
        elif now - since > schedule.disable_after * SECOND:
            hours = (now - since) / SECOND / 3600
            trouble.disable(connection, receiver, f"it has failed for {hours:.0f} h; the last time: {error}", now)


def _say_why_it_ended(task: asyncio.Task[None]) -> None:
    if not task.cancelled() and (error := task.exception()) is not None:
        _log.error("%s: %s", task.get_name(), error, exc_info=None if isinstance(error, StorageError) else error)
