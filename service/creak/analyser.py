"""The loop of an analyser: one process that shares the rigs of the fleet with any number of others like it.

One thread holds on to rigs and takes its share of free ones; the caller's thread takes letters, rig by rig.
"""

import json
import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from creak.analysis import Plan, RigAnalysis
from creak.broker import Broker
from creak.errors import BrokerError, CreakError, StorageError
from creak.sinks import actions, fleet
from creak.sinks.database import Store
from creak.sinks.fleet import LostRigError
from creak.sinks.store import BEAT_SECONDS
from creak.sinks.stream import subject

_log = logging.getLogger(__name__)

_IDLE_SECONDS = 0.2
_LOOK_SECONDS = 5.0  # a rig of which nothing is heard is looked at all the same
_GAP_SECONDS = 0.5
_ASK_SECONDS = 0.5
_RETRY_SECONDS = 1.0
_HOLDS_A_LEASE = 4  # times that a lease is renewed while it would last


class Analyser:
    """Owns rigs, as many as are its share, and analyses what their workers send.

    Parameters
    ----------
    store : Store
    broker : Broker
    stream : str
        Name of the stream.
    plans : iterable of Plan
        Rigs that it may own.
    lease : float
        Seconds after which the rigs of a process that is gone are free.
    patience : float
        Seconds after which a gap in a rig's letters is given up.
    """

    def __init__(
        self, store: Store, broker: Broker, stream: str, plans: Iterable[Plan], *, lease: float, patience: float
    ) -> None:
        self.name = fleet.new_analyser()
        self._store = store
        self._broker = broker
        self._stream = stream
        self._plans: Mapping[str, Plan] = {plan.rig.name: plan for plan in plans}
        self._lease = lease
        self._patience = patience
        self._stop = threading.Event()
        self._news = threading.Condition()  # guards the four below
        self._owned: dict[str, int] = {}
        self._due: dict[str, float] = {}
        self._told: list[tuple[str, dict[str, Any]]] = []
        self._busy: str | None = None
        self._rigs: dict[str, RigAnalysis] = {}
        self.taken = 0  # letters since it began
        self._generation = 0
        self._identity = ""
        self._warned: dict[str, str] = {}
        self._tick: Callable[[float], None] = lambda _now: None
        self._holder = threading.Thread(target=self._hold, name="leases", daemon=True)

    def run(self, tick: Callable[[float], None] = lambda _now: None) -> None:
        """Analyse until :meth:`stop`; gives all rigs back at the end.

        Parameters
        ----------
        tick : callable
            Called several times a second with the monotonic time, as long as the loop goes on.
        """
        self._tick = tick
        self._holder.start()
        looked = asked = beaten = float("-inf")
        try:
            while not self._stop.is_set():
                now = time.monotonic()
                self._tick(now)
                self._follow_ownership()
                progress = False
                try:
                    if now - looked >= _GAP_SECONDS or self._broker.generation != self._generation:
                        looked = now
                        self._look()
                    self._take_news()
                    if self._connected:
                        progress = self._turn(now)
                    if now - asked >= _ASK_SECONDS:
                        asked = now
                        self._serve_operators()
                        if self._connected:
                            self._each(RigAnalysis.pass_time)
                    if now - beaten >= BEAT_SECONDS:
                        beaten = now
                        self._beat()
                except (BrokerError, StorageError) as error:
                    self._warn("", error)
                    self._stop.wait(_RETRY_SECONDS)
                if not progress:
                    with self._news:
                        if not self._told and not self._stop.is_set():
                            self._news.wait(_IDLE_SECONDS)
        finally:
            self._stop.set()
            self._holder.join(self._lease)
            try:
                with self._store.write() as connection:
                    fleet.leave(connection, self.name)
            except StorageError as error:
                _log.warning("rigs are free again only when their leases end: %s", error)

    def stop(self) -> None:
        """End soon, also from another thread or a signal's handler."""
        self._stop.set()

    @property
    def owned(self) -> frozenset[str]:
        """Names of the rigs that it owns, as far as it knows."""
        return frozenset(self._owned)

    @property
    def _connected(self) -> bool:
        return self._broker.connected and self._broker.generation == self._generation

    # -- whose rigs

    def _hold(self) -> None:
        """Renew what is owned and take what is free, in a thread of its own that no computation holds up."""
        while not self._stop.is_set():
            with self._news:
                idle = [rig for rig in self._owned if rig != self._busy]
            try:
                with self._store.write() as connection:
                    owned = fleet.share(connection, self.name, list(self._plans), self._lease, idle)
            except StorageError as error:
                self._warn("leases", error)
            except Exception:  # noqa: BLE001 - who renews no lease loses its rigs and must not die of it unsaid
                _log.exception("leases")
            else:
                with self._news:
                    self._owned = owned
                    self._news.notify()
            self._stop.wait(self._lease / _HOLDS_A_LEASE)

    def _follow_ownership(self) -> None:
        with self._news:
            owned = dict(self._owned)
        for rig in [rig for rig, analysis in self._rigs.items() if owned.get(rig) != analysis.epoch]:
            self._drop(rig)
            _log.info("%s: left to others", rig)
        for rig in owned.keys() - self._rigs.keys():
            self._due.setdefault(rig, 0.0)

    def _drop(self, rig: str) -> None:
        """Forget what is in memory of a rig; what the store holds is read again if it is still owned."""
        self._rigs.pop(rig, None)
        self._due.pop(rig, None)
        self._broker.ignore(subject(self._stream, "news", rig))

    # -- what the broker tells

    def _look(self) -> None:
        """See after every new connection whether the stream is the same and has kept what it had."""
        if not self._broker.connected or self._broker.generation == self._generation:
            return
        generation = self._broker.generation
        identity, newest = self._broker.identity()
        if identity != self._identity:
            for rig in list(self._rigs):
                self._drop(rig)
        for analysis in self._rigs.values():
            if analysis.reader.sequence > newest:
                analysis.reader.look_again()
        self._identity, self._generation = identity, generation
        self._due = dict.fromkeys(self._owned, 0.0)

    def _hear(self, rig: str, data: bytes) -> None:
        """In the broker's thread: note what a worker says."""
        try:
            news = json.loads(data)
        except ValueError:
            return
        if isinstance(news, dict):
            with self._news:
                self._told.append((rig, news))
                self._news.notify()

    def _take_news(self) -> None:
        with self._news:
            told, self._told = self._told, []
        for rig, news in told:
            analysis = self._rigs.get(rig)
            if analysis is None:
                continue
            try:
                if news["place"] is not None:
                    self._due[rig] = 0.0
                    begun, index = news["place"]
                    reader = analysis.reader
                    if reader.place is not None and (begun, index) > reader.place:
                        reader.look_again(int(news["sequence"]) - 1)  # sequences may count anew
                if news["stopped"]:
                    analysis.stop(int(news["begun"]))
                elif news["heard"] is not None:
                    analysis.hear(int(news["begun"]), int(news["heard"]), time.time_ns())
            except (KeyError, TypeError, ValueError):
                continue  # none of our workers'
            except (StorageError, LostRigError) as error:
                self._warn(rig, error)
                self._drop(rig)

    # -- rig by rig

    def _turn(self, now: float) -> bool:
        """Give every rig that is due one letter; False if there was none."""
        progress = False
        for rig, epoch in list(self._owned.items()):
            if self._stop.is_set():
                break
            if self._due.get(rig, 0.0) > now:
                continue
            self._tick(time.monotonic())
            with self._news:
                if self._owned.get(rig) != epoch:
                    continue
                self._busy = rig
            try:
                analysis = self._rigs.get(rig) or self._open(rig, epoch)
                if analysis.step(time.time_ns()):
                    progress = True
                    self.taken += 1
                else:
                    self._due[rig] = now + (_GAP_SECONDS if analysis.reader.waiting else _LOOK_SECONDS)
                self._warned.pop(rig, None)
            except BrokerError:
                self._drop(rig)
                raise
            except CreakError as error:
                self._warn(rig, error)
                self._drop(rig)
                self._due[rig] = now + _RETRY_SECONDS
            finally:
                with self._news:
                    self._busy = None
        return progress

    def _open(self, rig: str, epoch: int) -> RigAnalysis:
        analysis = RigAnalysis(
            self._store,
            self._broker,
            self._plans[rig],
            epoch,
            self._stream,
            self._identity,
            self._patience,
            time.monotonic,
        )
        self._broker.listen(subject(self._stream, "news", rig), lambda data: self._hear(rig, data))
        self._rigs[rig] = analysis
        _log.info("%s: analysed here", rig)
        return analysis

    def _serve_operators(self) -> None:
        with self._store.read() as connection:
            asked = actions.waiting_for(connection, list(self._rigs))
        self._each(lambda analysis: analysis.serve(asked.get(analysis.plan.rig.name, ())))

    def _each(self, do: Callable[[RigAnalysis], None]) -> None:
        """Do something with every rig; one that cannot be written is read again."""
        for rig, analysis in list(self._rigs.items()):
            try:
                do(analysis)
            except CreakError as error:
                self._warn(rig, error)
                self._drop(rig)

    def _beat(self) -> None:
        runs = {analysis.run: analysis.heard_at for analysis in self._rigs.values() if analysis.run is not None}
        with self._store.write(durable=False) as connection:
            fleet.beat(connection, time.time_ns(), runs)

    def _warn(self, about: str, error: Exception) -> None:
        """Say what is wrong, once for each thing until it is well again."""
        if self._warned.get(about) != str(error):
            self._warned[about] = str(error)
            _log.warning("%s%s", f"{about}: " if about else "", error)
