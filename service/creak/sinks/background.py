"""The store's sink in a thread of its own: a store that is locked, slow or gone does not hold the worker up.

Records wait in a queue with an end. What must not be lost (alarm changes, answers to operators) is always taken
and tried until it is written; frames, faults and estimates beyond the end of the queue are dropped, and counted.
The same thread asks the store what operators want, so the worker never waits for that either.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import sqlalchemy as sa

from creak.alarm_records import Conflict
from creak.digests import Outcome
from creak.errors import StorageError
from creak.monitor import Memory
from creak.records import AlarmChange, Frame, Run, RunEnd
from creak.sinks import actions
from creak.sinks.actions import Asked
from creak.sinks.inbox import LOOK_SECONDS, Inbox
from creak.sinks.store import Store, StoreSink

_log = logging.getLogger(__name__)

_QUEUE = 4_000
_RETRY_SECONDS = 0.5
_PATIENCE_SECONDS = 15.0  # a store that is busy for less is nobody's concern
_CLOSE_SECONDS = 2.0
_SAVE_SECONDS = 1.0  # a store that lags behind writes the monitor's state so often, not every one that waits
_PASSING = (sa.exc.OperationalError, sa.exc.InterfaceError, sa.exc.TimeoutError)  # another try may succeed
_NO_SAMPLES = np.empty((0, 0))

Job = Callable[[], None]


class BackgroundStore:
    """Sink that hands everything to a `StoreSink` in a thread of its own, and the desk where operators ask.

    Parameters
    ----------
    store : Store
    sink : StoreSink
    queue : int
        Records that may wait.
    patience : float
        Seconds without success after which the worker is told.
    inbox : Inbox or None
        Shared with the other rigs of the process; one of its own if not given.
    """

    def __init__(
        self,
        store: Store,
        sink: StoreSink,
        *,
        queue: int = _QUEUE,
        patience: float = _PATIENCE_SECONDS,
        inbox: Inbox | None = None,
    ) -> None:
        self._store = store
        self._sink = sink
        self._limit = queue
        self._patience = patience
        self._inbox = inbox or Inbox(store)
        self._jobs: deque[Job] = deque()
        self._asked: deque[Asked] = deque()
        self._seen = 0
        self._rig = ""
        self._news = threading.Condition()
        self._closing = False
        self._abandoned = False
        self._failing_since: float | None = None
        self._failure = ""
        self._dropped = 0
        self._saves = 0
        self._saved_at = float("-inf")
        self._thread: threading.Thread | None = None

    def open(self, run: Run) -> None:
        """Open the run in the store, in the caller's thread: a store that cannot be used is known at once."""
        self._rig = run.rig.name
        self._sink.open(run)
        self._look()
        self._thread = threading.Thread(target=self._run, name=f"store {self._rig}", daemon=True)
        self._thread.start()

    def take(self, record: Outcome) -> None:
        """Queue a record.

        Raises
        ------
        StorageError
            If the queue is full and the record is none that must be kept.
        """
        if isinstance(record, Frame):  # the store counts frames and has no use for their samples
            record = replace(record, u=_NO_SAMPLES, y=_NO_SAMPLES)
        self._add(lambda: self._sink.take(record), must=isinstance(record, AlarmChange))

    def tick(self, now: float) -> None:
        """Tell of a store that has not taken anything for long.

        Raises
        ------
        StorageError
        """
        since = self._failing_since
        if since is not None and time.monotonic() - since > self._patience:
            raise StorageError(self._failure)

    def close(self, end: RunEnd) -> None:
        """Write what waits and the end of the run; gives up after some seconds if the store does not take it.

        Raises
        ------
        StorageError
            If it was given up.
        """
        self._add(lambda: self._sink.close(end), must=True)
        with self._news:
            self._closing = True
            self._news.notify()
        if self._thread is not None:
            self._thread.join(_CLOSE_SECONDS)
            self._inbox.leave(self._rig)
            if self._thread.is_alive():
                self._abandoned = True
                raise StorageError(f"{self._store.label}: the end of the run could not be written")

    def asked(self) -> list[Asked]:
        """Return what operators have asked for since the last call; never waits."""
        found = []
        while self._asked:
            found.append(self._asked.popleft())
        return found

    def answer(self, asked: Asked, conflict: Conflict | None) -> None:
        """Queue the answer to an operator, behind the changes that were made."""

        def write() -> None:
            with self._store.write() as connection:
                actions.answer(connection, asked, conflict)

        self._add(write, must=True)

    def save(self, memory: Memory) -> None:
        """Queue what the monitor has to know after a restart; it is packed in the thread of the store."""
        self._saves += 1
        number = self._saves

        def write() -> None:
            now = time.monotonic()
            if number == self._saves or now - self._saved_at >= _SAVE_SECONDS:  # else a newer one waits
                self._sink.save(memory)
                self._saved_at = now

        self._add(write, must=False)

    def do(self, job: Job) -> None:
        """Queue whatever else is to be written, tried until it is."""
        self._add(job, must=True)

    def _add(self, job: Job, *, must: bool) -> None:
        with self._news:
            if len(self._jobs) >= self._limit and not must:
                self._dropped += 1
                waiting = len(self._jobs)
            else:
                self._jobs.append(job)
                self._news.notify()
                return
        raise StorageError(f"{self._store.label}: {waiting} records wait already; further ones are not stored")

    def _run(self) -> None:
        looked = float("-inf")
        while not self._abandoned:
            with self._news:
                if not self._jobs:
                    if self._closing:
                        return
                    self._news.wait(LOOK_SECONDS)
                job = self._jobs[0] if self._jobs else None
            try:
                if job is not None:
                    self._do(job)
                if time.monotonic() - looked >= LOOK_SECONDS:
                    looked = time.monotonic()
                    self._sink.tick(looked)
                    self._look()
            except StorageError as error:
                self._note_failure(error)
                time.sleep(_RETRY_SECONDS)
            except Exception:  # noqa: BLE001 - a thread that dies would leave all that comes unwritten
                _log.exception("%s: the store", self._rig)
                time.sleep(_RETRY_SECONDS)
            else:
                self._note_success()

    def _do(self, job: Job) -> None:
        """Do the first job; one that can never be done is left out, and said so."""
        try:
            job()
        except StorageError as error:
            if isinstance(error.__cause__, _PASSING):
                raise
            _log.error("%s: a record cannot be stored and is left out: %s", self._rig, error)
        except Exception:  # noqa: BLE001 - whatever it is, the records behind it must go on
            _log.exception("%s: a record cannot be stored and is left out", self._rig)
        self._jobs.popleft()

    def _look(self) -> None:
        if self._closing:
            return
        for asked in self._inbox.waiting(self._rig, self._seen):
            self._seen = asked.seq
            self._asked.append(asked)

    def _note_failure(self, error: StorageError) -> None:
        self._failure = str(error)
        if self._failing_since is None:
            self._failing_since = time.monotonic()
            _log.warning("%s: %s; tried again until it is written", self._rig, error)

    def _note_success(self) -> None:
        if self._failing_since is not None:
            _log.warning(
                "%s: the store takes records again after %.1f s; %d were dropped",
                self._rig,
                time.monotonic() - self._failing_since,
                self._dropped,
            )
        self._failing_since, self._dropped = None, 0
