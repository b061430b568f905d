"""The loop: source, monitor, sinks. The only place with threads, a clock and a queue.

:func:`drive` runs a source that may be held back in the caller's thread (simulate, import, replay);
:class:`Worker` runs any source beside the caller (serve, demo), with a bounded queue between the reader of the
source and the monitor, so that neither can hold the other up without being seen.
"""

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace

from creak.alarm_records import Action, Clock, Conflict
from creak.codec import memory_bytes, memory_of
from creak.digests import Gatherer, Outcome
from creak.errors import CreakError, StorageError
from creak.monitor import Memory, Monitor
from creak.preparation import prepare
from creak.records import AlarmChange, Counts, Estimate, Fault, FaultKind, Frame, FrameStatus, RunEnd, RunStatus
from creak.sinks.protocol import Desk, Sink
from creak.sources.protocol import Replayable, Source

_log = logging.getLogger(__name__)

_QUEUE_FRAMES = 16
_AHEAD_ITEMS = 8
_TICK_SECONDS = 0.2


Item = Frame | Fault | Action | Clock


@dataclass(frozen=True)
class _Finished:
    """What the reader leaves in the queue when the source ends; the error if it failed."""

    error: Exception | None


class _Path:
    """Monitor and sinks of one run: everything between a source's items and the closed run."""

    def __init__(
        self,
        source: Source,
        sinks: Sequence[Sink],
        desk: Desk | None = None,
        memory: Memory | None = None,
        gatherer: Gatherer | None = None,
    ) -> None:
        prepare(edges=source.run.rig.network is not None)
        if memory is not None:  # what a run begins with belongs to its recording, or a replay would differ
            source.run = replace(source.run, before=memory_bytes(memory))
        elif source.run.before:
            memory = memory_of(source.run.before)
        self.monitor: Monitor | Gatherer = gatherer or Monitor(source.run, memory)
        self._desk = desk
        self._sinks: list[Sink] = []
        self.time = source.run.start  # recorded time up to which data have come
        self._live = source.live
        self._heard: tuple[int, float] | None = None  # end of the last good frame, and when it came
        self._failing: list[Sink] = []
        self._failure: StorageError | None = None
        for sink in sinks:
            try:
                sink.open(source.run)
            except BaseException:
                self._close_sinks(RunEnd(self.time, RunStatus.FAILED, Counts(), "a sink could not be opened"))
                raise
            self._sinks.append(sink)

    def take(self, item: Item) -> None:
        """Pass an item through the monitor and hand what follows to the sinks."""
        outcomes = self.monitor.take(item)
        if isinstance(item, Frame):
            end = item.time + round(self.monitor.run.rig.period_ns)
            self.time = max(self.time, end)
            if isinstance(outcomes[0], Frame) and outcomes[0].status is not FrameStatus.REJECTED:
                self._heard = end, time.monotonic()
        elif isinstance(item, Clock):
            self.time = max(self.time, item.time)
        self._hand_over(outcomes)
        if self._desk is not None and any(isinstance(outcome, Estimate | AlarmChange) for outcome in outcomes):
            self._save(self._desk)

    def serve_operators(self) -> None:
        """Carry out what operators have asked for; the answer follows the changes, and the state that has them."""
        if self._desk is None or isinstance(self.monitor, Gatherer):
            return
        for asked in self._desk.asked():
            done = self.monitor.act(asked.action)
            if not isinstance(done, Conflict):
                self._hand_over(done, besides=self._desk if asked.told else None)
                self._save(self._desk)
            self._desk.answer(asked, done if isinstance(done, Conflict) else None)

    def pass_time(self, now: float) -> None:
        """Let recorded time go on where a rig is silent: what is overdue is then known before its next frame.

        A source that may be held back has no silence: its time goes on with its frames.
        """
        if self._live and self._heard is not None:
            end, came = self._heard
            self.take(Clock(end + round((now - came) * 1e9)))

    def tick(self, now: float) -> None:
        """Give every sink its turn for timers."""
        for sink in self._sinks:
            try:
                sink.tick(now)
            except OSError as error:
                self._note_failure(sink, error)

    def close(self, status: RunStatus, message: str = "") -> RunEnd:
        """Close the run in every sink."""
        self._hand_over(self.monitor.finish())
        if self._failure is not None and status is RunStatus.COMPLETED:
            status, message = RunStatus.FAILED, str(self._failure)
        end = RunEnd(self.time, status, self.monitor.counts, message)
        self._close_sinks(end)
        return end

    @property
    def failure(self) -> StorageError | None:
        """Why a sink last refused, if one did."""
        return self._failure

    def _hand_over(self, outcomes: Iterable[Outcome], besides: object = None) -> None:
        """Give what came out to all sinks; what the store has already, to all besides the one in front of it."""
        for outcome in outcomes:
            for sink in (each for each in self._sinks if each is not besides):
                try:
                    sink.take(outcome)
                except OSError as error:
                    self._note_failure(sink, error)
                else:
                    if sink in self._failing and not isinstance(outcome, Frame):
                        self._failing.remove(sink)

    def _save(self, desk: Desk) -> None:
        assert isinstance(self.monitor, Monitor)  # a gatherer has nothing that outlives its run, and no desk
        try:
            desk.save(self.monitor.memory)
        except StorageError as error:
            _log.warning("%s: what a restart needs was not saved: %s", self.monitor.run.rig.name, error)

    def _note_failure(self, sink: Sink, error: OSError) -> None:
        """A place that cannot take more must not end the monitoring: say so once, everywhere else, and go on."""
        if sink in self._failing:
            return
        self._failing.append(sink)
        self._failure = error if isinstance(error, StorageError) else StorageError(str(error))
        _log.error("%s: %s", self.monitor.run.rig.name, error)
        fault = Fault(FaultKind.STORAGE, self.time, f"{error}; monitoring goes on without it")
        self._hand_over(self.monitor.take(fault))

    def _close_sinks(self, end: RunEnd) -> None:
        for sink in self._sinks:
            try:
                sink.close(end)
            except OSError as error:
                self._failure = error if isinstance(error, StorageError) else StorageError(str(error))
                _log.error("%s: %s", self.monitor.run.rig.name, error)
        self._sinks = []


def _items(source: Source) -> Iterator[Item]:
    """All that a source yields; of a recording also what operators did and what fell due."""
    return source.replayed() if isinstance(source, Replayable) else source.frames()


@contextmanager
def _read_ahead(source: Source, ahead: bool) -> Iterator[Iterator[Item]]:
    """All that a source yields; the next few items of a recording are fetched by a thread of its own meanwhile."""
    items = _items(source)
    if not ahead or not isinstance(source, Replayable):
        yield items
        return
    reader = ThreadPoolExecutor(1, thread_name_prefix="reader")

    def fetched() -> Iterator[Item]:
        coming = deque(reader.submit(next, items, None) for _ in range(_AHEAD_ITEMS))
        while (item := coming.popleft().result()) is not None:
            coming.append(reader.submit(next, items, None))
            yield item

    try:
        yield fetched()
    finally:
        reader.shutdown(cancel_futures=True)


def drive(source: Source, sinks: Sequence[Sink], *, ahead: bool = True) -> tuple[Monitor, RunEnd]:
    """Run a source to its end in this thread; a recording is read ahead in another.

    Parameters
    ----------
    source : Source
        One that may be held back.
    sinks : sequence of Sink
    ahead : bool
        False where other cores have work of their own: nothing is read ahead.

    Returns
    -------
    Monitor
        As it stands at the end.
    RunEnd
        ``interrupted`` after a KeyboardInterrupt, which is not raised again.

    Raises
    ------
    CreakError
        What the source or a sink raised, after the run was closed as failed.
    """
    try:
        path = _Path(source, sinks)
    except BaseException:
        source.close()
        raise
    monitor = path.monitor
    assert isinstance(monitor, Monitor)
    try:
        with _read_ahead(source, ahead) as items:
            for item in items:
                path.take(item)
                if path.failure is not None:
                    raise path.failure
                path.tick(time.monotonic())
    except KeyboardInterrupt:
        return monitor, path.close(RunStatus.INTERRUPTED, "interrupted by the user")
    except BaseException as error:
        path.close(RunStatus.FAILED, str(error) or type(error).__name__)
        raise
    finally:
        source.close()
    end = path.close(RunStatus.COMPLETED)
    if path.failure is not None:
        raise path.failure
    return monitor, end


class Worker:
    """Runs one rig beside the caller until its source ends or it is stopped.

    Parameters
    ----------
    source : Source
    sinks : sequence of Sink
        Opened by :meth:`start`, then fed and closed by the worker's thread alone.
    desk : Desk or None
        Where operators ask, and where what a restart needs is kept.
    memory : Memory or None
        What an earlier monitor of the rig knew.
    gatherer : Gatherer or None
        Takes the place of the monitor where estimates are made elsewhere.
    """

    def __init__(
        self,
        source: Source,
        sinks: Sequence[Sink],
        *,
        desk: Desk | None = None,
        memory: Memory | None = None,
        gatherer: Gatherer | None = None,
    ) -> None:
        self._gatherer = gatherer
        self._source = source
        self._sinks = sinks
        self._desk = desk
        self._memory = memory
        self._queue: queue.Queue[Item | _Finished] = queue.Queue(_QUEUE_FRAMES)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name=f"rig {source.run.rig.name}")
        self._reader = threading.Thread(target=self._read, name=f"source {source.run.rig.name}", daemon=True)
        self._dropped = 0  # counted by the reader, named by the loop
        self._named = 0
        self.end: RunEnd | None = None
        self.error: Exception | None = None

    def start(self) -> None:
        """Open the sinks and begin; returns at once.

        Raises
        ------
        CreakError
            If a sink cannot be opened; the run has then not begun.
        """
        self._path = _Path(self._source, self._sinks, self._desk, self._memory, self._gatherer)
        self._thread.start()
        self._reader.start()

    @property
    def running(self) -> bool:
        """True until the run is closed."""
        return self._thread.is_alive()

    def stop(self, seconds: float = 3.0) -> None:
        """End the run as interrupted and wait until its sinks are closed.

        Parameters
        ----------
        seconds : float
            How long to wait at most.
        """
        self._stop.set()
        self._source.close()
        if self._thread.ident is not None:
            self._thread.join(seconds)

    def _read(self) -> None:
        """Carry items from the source to the queue; runs in the reader's thread."""
        error: Exception | None = None
        try:
            for item in _items(self._source):
                if not self._offer(item):
                    break
        except Exception as found:  # noqa: BLE001 - whatever it is, the run has to end with it and say so
            error = found
        while not self._stop.is_set():
            try:
                self._queue.put(_Finished(error), timeout=_TICK_SECONDS)
                return
            except queue.Full:
                continue

    def _offer(self, item: Item) -> bool:
        """Queue an item; a source that cannot wait loses it when the queue is full, counted and named."""
        while not self._stop.is_set():
            try:
                self._queue.put(item, timeout=0 if self._source.live else _TICK_SECONDS)
                return True
            except queue.Full:
                if self._source.live:
                    self._dropped += 1
                    return True
        return False

    def _loop(self) -> None:
        path = self._path
        status, message = RunStatus.INTERRUPTED, "stopped"
        try:
            while not self._stop.is_set():
                path.serve_operators()
                try:
                    item = self._queue.get(timeout=_TICK_SECONDS)
                except queue.Empty:
                    path.pass_time(time.monotonic())
                    path.tick(time.monotonic())
                    continue
                self._name_dropped(path)
                if isinstance(item, _Finished):
                    status, message = RunStatus.COMPLETED, ""
                    if item.error is not None:
                        raise item.error
                    break
                path.take(item)
                path.tick(time.monotonic())
        except Exception as error:  # noqa: BLE001 - a loop must not die silently: the run ends as failed
            status, message = RunStatus.FAILED, str(error) or type(error).__name__
            self.error = error
            _log.error("%s: %s", self._source.run.rig.name, message, exc_info=not isinstance(error, CreakError))
        finally:
            self._stop.set()
            self._source.close()
            try:
                self.end = path.close(status, message)
            except Exception as error:  # noqa: BLE001
                self.error = self.error or error
                _log.error("%s: %s", self._source.run.rig.name, error)

    def _name_dropped(self, path: _Path) -> None:
        """Put down as lost what the reader has had to drop since the last time."""
        lost = self._dropped - self._named
        if lost:
            self._named += lost
            message = f"{lost} frames were dropped: the monitor could not keep up with the source"
            path.take(Fault(FaultKind.LOST, path.time, message))
