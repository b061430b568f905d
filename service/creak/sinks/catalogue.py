"""Recorder whose files the store lists."""

import logging
from collections.abc import Callable
from functools import partial
from pathlib import Path

from creak.digests import Outcome
from creak.errors import StorageError
from creak.records import Estimate, Frame, Run, RunEnd, Scope
from creak.sinks.database import Store
from creak.sinks.recorder import Recorder
from creak.sinks.service_alarms import clear_standing, raise_alarm
from creak.sinks.store import RecordingEntry, put_recording

_log = logging.getLogger(__name__)

_GUIDANCE = "Monitoring goes on, but nothing is recorded. Make room; the recording then goes on in a new part."
_CONDITION = "storage"


class CataloguedRecorder:
    """Hands every record to a recorder and keeps the store's list of recordings true.

    Parameters
    ----------
    recorder : Recorder
    store : Store
    later : callable, optional
        Does a job elsewhere (`BackgroundStore.do`), so that a store that is locked does not hold up the recording;
        the start and the end of the recording are listed at once all the same.
    """

    def __init__(
        self, recorder: Recorder, store: Store, later: Callable[[Callable[[], None]], None] | None = None
    ) -> None:
        self._recorder = recorder
        self._store = store
        self._later = later or (lambda job: job())
        self._run: Run | None = None
        self._time = 0
        self._began: dict[Path, int] = {}
        self._settled = 0  # parts whose entries stand for good
        self._told = False

    def open(self, run: Run) -> None:
        """Begin the recording and list it."""
        self._run, self._time = run, run.start
        self._recorder.open(run)
        self._list("writing")
        self._tell_end()  # of what an earlier run of the rig suffered from

    def take(self, record: Outcome) -> None:
        """Record; a part that was begun by it, and one that grew by a realisation, are listed anew."""
        parts = len(self._recorder.paths)
        if isinstance(record, Frame):
            self._time = max(self._time, record.time)
        try:
            self._recorder.take(record)
        except StorageError as error:
            self._tell(error)
            raise
        if self._told:
            self._told = False
            self._tell_end()
        if len(self._recorder.paths) > parts or (isinstance(record, Estimate) and record.scope is Scope.RUN):
            self._list("writing", self._later)

    def tick(self, now: float) -> None:
        """Give the recorder its turn."""
        self._recorder.tick(now)

    def close(self, end: RunEnd) -> None:
        """End the recording; it is complete if nothing failed."""
        self._time = max(self._time, end.time)
        try:
            self._recorder.close(end)
        finally:
            self._list("complete" if self._recorder.failure is None else "truncated")

    def _tell(self, error: StorageError) -> None:
        """Raise the alarm that the recording has stopped, once; monitoring goes on without it."""
        if self._told or self._run is None:
            return
        self._told = True
        rig, now, reason = self._run.rig.name, self._time, str(error)

        def write() -> None:
            with self._store.write() as connection:
                raise_alarm(connection, rig, "", _CONDITION, now, reason=reason, guidance=_GUIDANCE)

        self._do(write)

    def _tell_end(self) -> None:
        """Clear that alarm: there is a recording again."""
        assert self._run is not None
        rig, now = self._run.rig.name, self._time

        def write() -> None:
            with self._store.write() as connection:
                clear_standing(connection, rig, "", _CONDITION, now)

        self._do(write)

    def _do(self, job: Callable[[], None]) -> None:
        try:
            self._later(job)
        except StorageError as error:
            _log.warning("the alarm about a recording could not be written: %s", error)

    def _list(self, status: str, do: Callable[[Callable[[], None]], None] = lambda job: job()) -> None:
        assert self._run is not None
        paths = self._recorder.paths
        for number, path in enumerate(paths[self._settled :], self._settled):
            last = number == len(paths) - 1
            start = self._began.setdefault(path, self._time)
            open_end = last and status == "writing" and path not in self._recorder.cut
            following = self._began.get(paths[number + 1], self._time) if not last else self._time
            try:
                size = path.stat().st_size
            except FileNotFoundError:  # the budget has taken it meanwhile, and its entry with it
                continue
            entry = RecordingEntry(
                id=path.stem,
                rig=self._run.rig.name,
                run=self._run.id,
                path=str(path),
                start=start,
                end=None if open_end else following,
                status="truncated" if path in self._recorder.cut else status if last else "complete",
                size=size,
            )
            do(partial(put_recording, self._store, entry))
        self._settled = max(0, len(paths) - 1)
