"""Recorder whose files the store lists."""

from pathlib import Path

from creak.records import AlarmChange, Estimate, Fault, Frame, Run, RunEnd, Scope
from creak.sinks.database import Store
from creak.sinks.recorder import Recorder
from creak.sinks.store import RecordingEntry, put_recording


class CataloguedRecorder:
    """Hands every record to a recorder and keeps the store's list of recordings true.

    Parameters
    ----------
    recorder : Recorder
    store : Store
    """

    def __init__(self, recorder: Recorder, store: Store) -> None:
        self._recorder = recorder
        self._store = store
        self._run: Run | None = None
        self._time = 0
        self._began: dict[Path, int] = {}

    def open(self, run: Run) -> None:
        """Begin the recording and list it."""
        self._run, self._time = run, run.start
        self._recorder.open(run)
        self._list("writing")

    def take(self, record: Frame | Fault | Estimate | AlarmChange) -> None:
        """Record; a part that was begun by it, and one that grew by a realisation, are listed anew."""
        parts = len(self._recorder.paths)
        if isinstance(record, Frame):
            self._time = max(self._time, record.time)
        self._recorder.take(record)
        if len(self._recorder.paths) > parts or (isinstance(record, Estimate) and record.scope is Scope.RUN):
            self._list("writing")

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

    def _list(self, status: str) -> None:
        assert self._run is not None
        paths = self._recorder.paths
        for number, path in enumerate(paths):
            last = number == len(paths) - 1
            start = self._began.setdefault(path, self._time)
            open_end = last and status == "writing"
            following = self._began.get(paths[number + 1], self._time) if not last else self._time
            put_recording(
                self._store,
                RecordingEntry(
                    id=path.stem,
                    rig=self._run.rig.name,
                    run=self._run.id,
                    path=str(path),
                    start=start,
                    end=None if open_end else following,
                    status=status if last else "complete",
                    size=path.stat().st_size,
                ),
            )
