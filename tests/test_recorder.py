"""The recorder: what other tools read in its files, what a kill leaves, how it rotates, what a full disk does."""

import contextlib
import dataclasses
import os
import resource
import signal
import subprocess
import sys
import textwrap
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from creak.codec import view_topics
from creak.config.rig import parse_rig
from creak.errors import StorageError
from creak.records import AlarmChange, Estimate, Frame, Scope
from creak.sinks.recorder import Recorder
from creak.sinks.wholewrites import WholeWrites
from creak.sources.recording import Recording
from recorded import END, exact, records, run, write


def test_ordinary_tools_read_all_of_it(tmp_path: Path) -> None:
    """Catches schemas that only creak can resolve, missing indexes, checksums that do not hold."""
    path = tmp_path / "bench.mcap"
    taken = list(records())
    write(path, taken)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        listed = {channel.topic: counts[channel.id] for channel in summary.channels.values()}
        decoded = list(reader.iter_decoded_messages(log_time_order=False))
        metadata = list(reader.iter_metadata())
    kinds = Counter(type(record).__name__ for record in taken)
    assert {topic: count for topic, count in listed.items() if topic not in view_topics(run().rig)} == {
        "/run": 1,
        "/frames": kinds["Frame"],
        "/faults": kinds["Fault"],
        "/estimates": kinds["Estimate"],
        "/alarms": 1,
        "/end": 1,
        "/levels/left": 6,
        "/levels/right side": 6,
    }
    seen = [item.decoded_message for item in decoded if item.channel.topic == "/frames"]
    frames = [record for record in taken if isinstance(record, Frame)]
    for message, frame in zip(seen, frames, strict=True):
        assert (message.time, message.experiment, message.status) == (frame.time, frame.experiment, frame.status)
        assert exact(list(message.y.values)) == exact(frame.y.ravel().tolist())
        assert tuple(message.y.shape) == frame.y.shape
    trend = [item.decoded_message for item in decoded if item.channel.topic == "/levels/left"]
    windows = [record for record in taken if isinstance(record, Estimate) and record.scope is Scope.WINDOW]
    assert [message.total_to_noise_db for message in trend] == [w.nodes[0].total_to_noise_db for w in windows]
    assert not trend[0].HasField("nonlinear_db")
    first, last = (record.metadata for record in metadata)
    assert exact(parse_rig(first["rig.toml"], "recording")) == exact(run().rig)
    assert first["seed"] == "1"
    assert last["status"] == "interrupted"


def test_what_is_taken_is_on_disk_within_a_second(tmp_path: Path) -> None:
    """Catches a flush that waits for the chunk to fill, or for the file to be closed."""
    recorder = Recorder(tmp_path / "live.mcap")
    recorder.open(run())
    waiting: list[tuple[float, int]] = []
    frames = [record for record in records() if isinstance(record, Frame)]
    for step, frame in enumerate(frames):
        now = step * 0.25  # a frame just after each tick of a worker that ticks four times a second
        recorder.tick(now)
        reading = Recording(tmp_path / "live.mcap")
        there = sum(1 for _ in reading.frames())
        assert reading.truncated
        waiting = [(since, count) for since, count in waiting if count > there]
        assert all(now - since <= 1.0 for since, _ in waiting)
        recorder.take(frame)
        waiting.append((now, step + 1))
    recorder.close(END)


def test_a_completed_realisation_and_an_alarm_are_on_disk_at_once(tmp_path: Path) -> None:
    """Catches an alarm that a power cut, or a worker that never ticks again, takes with it."""
    recorder = Recorder(tmp_path / "live.mcap")
    recorder.open(run())
    seen = 0
    for count, record in enumerate(records(), start=1):
        recorder.take(record)
        if isinstance(record, AlarmChange) or (isinstance(record, Estimate) and record.scope is Scope.RUN):
            assert len(list(Recording(tmp_path / "live.mcap").recorded())) == count
            seen += 1
    assert seen == 7
    recorder.close(END)


WRITER = """
    import sys, time
    from pathlib import Path
    from recorded import records, run
    from creak.sinks.recorder import Recorder

    recorder = Recorder(Path(sys.argv[1]))
    recorder.open(run())
    for record in records(1000):
        recorder.take(record)
        recorder.tick(time.monotonic())
        print(time.monotonic(), flush=True)
        time.sleep(0.01)
"""


def test_kill_9_loses_at_most_the_last_second(tmp_path: Path) -> None:
    """Catches data that only this process can see: a file nobody can read after the service is killed."""
    path = tmp_path / "killed.mcap"
    writer = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(WRITER), str(path)],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parent)},
        text=True,
    )
    assert writer.stdout is not None
    with writer.stdout:
        times = [float(writer.stdout.readline()) for _ in range(150)]
        writer.send_signal(signal.SIGKILL)
        times += map(float, writer.stdout.read().split())
    assert writer.wait() == -signal.SIGKILL
    recording = Recording(path)
    kept = list(recording.recorded())
    assert recording.truncated
    assert recording.end is None
    assert exact(kept) == exact(list(records(1000))[: len(kept)])
    old = sum(time < times[-1] - 1.0 for time in times)
    assert len(kept) >= old > 20


@pytest.mark.parametrize("limits", [{"max_bytes": 20_000}, {"max_seconds": 2.0}])
def test_parts_are_whole_and_together_the_run(tmp_path: Path, limits: dict[str, float]) -> None:
    """Catches a frame lost or doubled between parts, a realisation torn apart, a part that does not open alone."""
    taken = list(records())
    recorder = write(tmp_path / "bench.mcap", taken, **limits)
    assert len(recorder.paths) >= 2
    assert [path.name for path in recorder.paths] == [
        f"bench-{number:04d}.mcap" for number in range(1, len(recorder.paths) + 1)
    ]
    together = Recording(*reversed(recorder.paths))
    assert exact(list(together.recorded())) == exact(taken)
    assert (together.truncated, together.damage, together.continues) == (False, [], False)
    assert exact(together.end) == exact(END)
    for path in recorder.paths:
        part = Recording(path)
        realisations = Counter(
            record.realisation for record in part.recorded() if isinstance(record, Frame) and not record.reason
        )
        assert set(realisations.values()) == {6}
        assert exact(part.run) == exact(run())
        assert not part.truncated
        assert part.continues == (path != recorder.path)
        assert part.end is not None
        if part.continues:
            assert part.end.counts.realisations == len(realisations)
            assert part.end.counts.frames == 4 * len(realisations)


def test_in_a_directory_no_recording_replaces_another(tmp_path: Path) -> None:
    recorder = write(tmp_path, records(1))
    assert recorder.paths == [tmp_path / "bench-1.mcap"]
    kept = recorder.paths[0].read_bytes()
    again = Recorder(tmp_path)
    with pytest.raises(StorageError, match=r"bench-1\.mcap: cannot be written: File exists"):
        again.open(run())
    assert recorder.paths[0].read_bytes() == kept


@contextlib.contextmanager
def small_disk(path: Path) -> Iterator[Path]:
    """Mount a file system of one megabyte, where that is permitted."""
    path.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(path)], capture_output=True, check=False
    )
    if mounted.returncode != 0:
        pytest.skip("mounting a small file system is not permitted here")
    try:
        yield path
    finally:
        subprocess.run(["umount", str(path)], check=True)


def fill(target: Path) -> tuple[Recorder, StorageError]:
    """Record until it fails."""
    recorder = Recorder(target)
    recorder.open(run(512))
    for index, record in enumerate(records(100, 512)):
        try:
            recorder.take(record)
            recorder.tick(float(index))
        except StorageError as error:
            return recorder, error
    pytest.fail("it never failed")


def check_full(recorder: Recorder, error: StorageError, path: Path) -> None:
    assert str(error).startswith(f"{path}: recording stopped; what is in it until then can be read: ")
    assert "\n" not in str(error)
    with pytest.raises(StorageError):
        recorder.take(next(records()))
    recorder.tick(1e9)
    recorder.close(END)
    recording = Recording(path)
    kept = list(recording.recorded())
    assert len(kept) > 20
    assert exact(kept) == exact(list(records(100, 512))[: len(kept)])
    assert recording.truncated
    assert recording.damage == []  # it ends with a whole record


def test_a_full_disk_stops_the_recording_and_spares_what_is_in_it(tmp_path: Path) -> None:
    """Catches a torn last chunk, an error on closing, and frames that vanish without a word."""
    with small_disk(tmp_path / "disk") as disk:
        path = disk / "full.mcap"
        recorder, error = fill(path)
        assert "No space left on device" in str(error)
        check_full(recorder, error, path)


def test_a_file_size_limit_stops_the_recording_likewise(tmp_path: Path) -> None:
    """Covers the same where nothing may be mounted."""
    path = tmp_path / "full.mcap"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        recorder, error = fill(path)
        check_full(recorder, error, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_a_disk_that_is_full_for_a_week_is_still_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a pause that doubles without end: 2^1024 is no number of seconds, and ended the monitoring."""
    frames = [record for record in records(1) if isinstance(record, Frame)]
    recorder = Recorder(tmp_path, max_bytes=10**9)
    recorder.open(run())

    def record(realisation: int, now: float) -> None:
        recorder.tick(now)
        recorder.take(dataclasses.replace(frames[0], realisation=realisation))
        recorder.tick(now + 500.0)  # what waits in memory is written

    with monkeypatch.context() as full:
        full.setattr(
            WholeWrites, "write", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device"))
        )
        for attempt in range(1100):
            with pytest.raises(StorageError, match="No space left"):
                record(attempt, 1000.0 * attempt)
    record(1100, 1e7)
    recorder.close(END)
    assert len(recorder.paths) == 2
    (kept,) = [r for r in Recording(recorder.paths[1]).recorded() if isinstance(r, Frame)]
    assert kept.realisation == 1100


@pytest.mark.parametrize(
    ("target", "reason"),
    [("/dev/full", "No space left on device"), ("missing/x.mcap", "No such file or directory")],
)
def test_a_file_that_cannot_be_begun_is_named(tmp_path: Path, target: str, reason: str) -> None:
    recorder = Recorder(tmp_path / target)
    with pytest.raises(StorageError, match=rf"{target}: cannot be written: {reason}"):
        recorder.open(run())
    recorder.close(END)
