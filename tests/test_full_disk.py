"""A disk that is full: the recording stops with an alarm, monitoring goes on, and with room it records again."""

import contextlib
import itertools
import subprocess
import threading

import pytest

from conftest import make_frames, make_rig
from conftest import make_run as make_real_run
from creak.records import Frame, RunStatus, Scope
from creak.sinks import queries
from creak.sinks.background import BackgroundStore
from creak.sinks.catalogue import CataloguedRecorder
from creak.sinks.recorder import Recorder
from creak.sinks.store import StoreSink
from creak.sources.recording import Recording
from creak.worker import Worker
from processes import wait_for
from store_records import START

SOME_FRAMES = 100_000
"""Bytes of a recording that holds realisations, not only its schemas."""

RUN = make_real_run(make_rig(2, samples=128, lines=range(2, 40), name="beam"), window=2, start=START)


@pytest.fixture
def disk(tmp_path):
    """A file system of 20 MB."""
    directory = tmp_path / "disk"
    directory.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", str(directory)], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("no file system can be mounted here")
    yield directory
    subprocess.run(["umount", str(directory)], check=True)


class Endless:
    """Frames of the rig, again and again as new realisations, until it is told to end."""

    live = False

    def __init__(self):
        self.run, self._closed = RUN, threading.Event()

    def frames(self):
        period = round(RUN.rig.period_ns)
        for number in itertools.count():
            frame = FRAMES[number % len(FRAMES)]
            if self._closed.wait(0.02):
                return
            yield Frame(number // (2 * RUN.periods), *frame[:2], START + number * period, *frame[2:])

    def close(self):
        self._closed.set()


FRAMES = [(f.experiment, f.period, f.u, f.y) for f in make_frames(RUN, 4, noise=1e-3)]


def test_recording_stops_with_an_alarm_and_goes_on_when_there_is_room(store, disk):
    """Kills a service that has to be started anew, and an alarm that stands although the disk has room again."""
    ballast = disk / "ballast"
    recorder = Recorder(disk, max_bytes=10**9, resume_seconds=0.2)
    desk = BackgroundStore(store, StoreSink(store))
    worker = Worker(Endless(), [desk, CataloguedRecorder(recorder, store, desk.do)], desk=desk)

    def alarm():
        with store.read() as connection:
            found = queries.alarms(connection, queries.AlarmFilter(), None, 100).items
        return next((each for each in found if each["condition"] == "storage"), None)

    def realisations():
        with store.read() as connection:
            estimate = queries.newest_estimate(connection, RUN.id, Scope.RUN)
        return 0 if estimate is None else estimate["realisation"]

    worker.start()
    try:
        wait_for(lambda: recorder.path.stat().st_size > SOME_FRAMES)
        with contextlib.suppress(OSError), ballast.open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))
        raised = wait_for(alarm)
        assert (raised["active"], raised["class"], raised["rig"]) == (True, "quality", "beam")
        assert "No space left" in raised["comment"]
        before = realisations()
        wait_for(lambda: realisations() > before + 5)  # levels come on
        assert len(recorder.paths) == 1
        assert sorted(path.name for path in disk.iterdir()) == sorted(["ballast", recorder.path.name])
        ballast.unlink()
        wait_for(lambda: not alarm()["active"])
        wait_for(lambda: len(recorder.paths) == 2 and recorder.path.stat().st_size > SOME_FRAMES)
        assert alarm()["id"] == raised["id"]
    finally:
        worker.stop(10.0)
    assert worker.end.status is RunStatus.INTERRUPTED
    with store.read() as connection:
        kept = queries.recordings(connection, None, None, 10).items
    assert [item["status"] for item in kept] == ["complete", "truncated"]
    recording = Recording(*recorder.paths)
    read = [record.realisation for record in recording.recorded() if isinstance(record, Frame)]
    gap = max(later - earlier for earlier, later in itertools.pairwise(read))
    assert gap > 1
    assert read == sorted(read)
