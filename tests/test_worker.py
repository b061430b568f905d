"""The loop: it does not die silently, loses nothing without saying so, and closes what it opened."""

import threading
import time

import pytest

from conftest import make_frames, make_rig, make_run
from creak.errors import RigError, StorageError
from creak.records import Estimate, Fault, FaultKind, Frame, RunStatus
from creak.worker import Worker, drive


class Frames:
    """A source of given items; it fails at the end if it is told to."""

    def __init__(self, run, items, live=False, error=None, pause=0.0):
        self.run, self.live = run, live
        self._items, self._error, self._pause = items, error, pause
        self._closed = threading.Event()

    def frames(self):
        for item in self._items:
            if self._closed.wait(self._pause) or self._closed.is_set():
                return
            yield item
        if self._error is not None:
            raise self._error

    def close(self):
        self._closed.set()


class Keeper:
    """A sink that keeps all it gets; it refuses from a certain record on, or until a certain one."""

    def __init__(self, refuses=(), slow=0.0):
        self.records, self.end, self.ticks = [], None, 0
        self._refuses, self._count, self._slow = refuses, 0, slow

    def open(self, run):
        self.run = run

    def take(self, record):
        time.sleep(self._slow)
        self._count += 1
        if self._count in self._refuses:
            raise StorageError("no space left on device")
        self.records.append(record)

    def tick(self, now):
        self.ticks += 1

    def close(self, end):
        self.end = end

    def count(self, kind):
        return sum(isinstance(record, kind) for record in self.records)


@pytest.fixture
def run():
    return make_run(make_rig(1, samples=32, lines=range(2, 6)), steady=2)


def finished(worker):
    end = time.monotonic() + 30
    while worker.running and time.monotonic() < end:
        time.sleep(0.01)
    assert not worker.running
    return worker.end


def test_worker_and_drive_give_the_same_records(run):
    frames = make_frames(run, 4)
    driven, served = Keeper(), Keeper()
    _, end = drive(Frames(run, frames), [driven])
    worker = Worker(Frames(run, frames), [served])
    worker.start()
    assert finished(worker) == end == driven.end == served.end
    assert end.status is RunStatus.COMPLETED
    assert end.counts.frames == 8
    assert [type(r) for r in driven.records] == [type(r) for r in served.records]
    assert [r.nodes for r in driven.records if isinstance(r, Estimate)] == [
        r.nodes for r in served.records if isinstance(r, Estimate)
    ]


def test_a_full_disk_stops_recording_and_nothing_else(run):
    """Kills a monitor that ends with its recorder, and a storm of the same complaint."""
    full, whole = Keeper(refuses=range(5, 10**6)), Keeper()
    worker = Worker(Frames(run, make_frames(run, 6)), [full, whole])
    worker.start()
    end = finished(worker)
    assert end.counts.realisations == 6
    assert [r.kind for r in whole.records if isinstance(r, Fault)] == [FaultKind.STORAGE]
    assert whole.count(Estimate) == 12
    assert end.status is RunStatus.FAILED
    assert "no space" in end.message
    assert full.end is whole.end  # both are closed


def test_a_store_that_recovers_goes_on_and_is_named_again_when_it_fails_again(run):
    shaky, whole = Keeper(refuses=(4, 12)), Keeper()
    worker = Worker(Frames(run, make_frames(run, 4)), [shaky, whole])
    worker.start()
    finished(worker)
    assert [r.kind for r in whole.records if isinstance(r, Fault)] == [FaultKind.STORAGE] * 2
    assert shaky.count(Estimate) >= 6


def test_a_source_that_fails_ends_the_run_as_failed(run):
    """Kills a thread that dies and leaves a service that looks alive."""
    keeper = Keeper()
    worker = Worker(Frames(run, make_frames(run, 2), error=RigError("the rig is silent")), [keeper])
    worker.start()
    assert finished(worker).status is RunStatus.FAILED
    assert keeper.end.message == "the rig is silent"
    assert keeper.end.counts.frames == 4
    assert isinstance(worker.error, RigError)
    again = Keeper()
    with pytest.raises(RigError):
        drive(Frames(run, make_frames(run, 2), error=RigError("the rig is silent")), [again])
    assert again.end.status is RunStatus.FAILED


def test_a_live_source_loses_frames_where_the_monitor_is_too_slow_and_each_is_counted(run):
    """Kills a queue that grows without bound, and a drop that nobody counts."""
    frames = make_frames(run, 40)
    keeper = Keeper(slow=0.002)
    worker = Worker(Frames(run, frames, live=True), [keeper])
    worker.start()
    end = finished(worker)
    lost = [r for r in keeper.records if isinstance(r, Fault) and r.kind is FaultKind.LOST]
    dropped = sum(int(fault.message.split()[0]) for fault in lost)
    assert dropped > 0
    assert keeper.count(Frame) + dropped == len(frames)
    assert end.counts.frames + end.counts.rejected_frames + end.counts.transient_frames == keeper.count(Frame)


def test_a_source_that_can_wait_loses_nothing(run):
    keeper = Keeper(slow=0.001)
    worker = Worker(Frames(run, make_frames(run, 20)), [keeper])
    worker.start()
    assert finished(worker).counts.frames == 40


def test_stopping_ends_a_waiting_source_and_closes_the_sinks(run):
    keeper = Keeper()
    worker = Worker(Frames(run, make_frames(run, 4), pause=60.0), [keeper])
    worker.start()
    time.sleep(0.3)
    worker.stop()
    assert not worker.running
    assert keeper.end.status is RunStatus.INTERRUPTED
    assert keeper.ticks > 0  # timers run although nothing comes


def test_a_sink_that_cannot_be_opened_closes_the_others(run):
    class Closed(Keeper):
        def open(self, run):
            raise StorageError("read-only")

    first = Keeper()
    worker = Worker(Frames(run, []), [first, Closed()])
    with pytest.raises(StorageError):
        worker.start()
    assert first.end.status is RunStatus.FAILED


def test_a_sink_that_cannot_be_opened_closes_the_source(run):
    class Closed(Keeper):
        def open(self, run):
            raise StorageError("read-only")

    source = Frames(run, [])
    with pytest.raises(StorageError):
        drive(source, [Closed()])
    assert source._closed.is_set()


class Recorded(Frames):
    """A source that `drive` reads ahead."""

    def replayed(self):
        return self.frames()


def test_what_is_read_ahead_is_the_same(run):
    frames = make_frames(run, 4)
    plain, ahead = Keeper(), Keeper()
    assert drive(Frames(run, frames), [plain])[1] == drive(Recorded(run, frames), [ahead])[1]
    assert [type(r) for r in plain.records] == [type(r) for r in ahead.records]
    assert [r.y.tobytes() for r in plain.records if isinstance(r, Frame)] == [
        r.y.tobytes() for r in ahead.records if isinstance(r, Frame)
    ]


@pytest.mark.parametrize("refuses", [(), (3,)])
def test_an_error_ends_the_run_and_the_reader(run, refuses):
    """Kills a reader that goes on after the run, and an error that is lost in its thread."""
    keeper = Keeper(refuses=refuses)
    error = StorageError if refuses else RigError
    with pytest.raises(error):
        drive(Recorded(run, make_frames(run, 4), error=RigError("the rig burns")), [keeper])
    assert keeper.end.status is RunStatus.FAILED
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("reader")]
