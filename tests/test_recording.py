"""Reading recordings that are whole, cut, damaged, or something else altogether."""

import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.data_stream import ReadDataStream
from mcap.reader import make_reader
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, Writer

from creak import multisine
from creak.errors import RecordingError
from creak.records import AlarmChange, Excitation, Fault, FaultKind, Frame, FrameStatus, Run, RunEnd
from creak.sinks.recorder import Recorder
from creak.sources.recording import Recording
from creak.worker import drive
from recorded import END, START, Taken, exact, records, rig, run, write


@dataclass(frozen=True)
class Example:
    """A recording, what is in it, and where an independent reader finds its chunks."""

    path: Path
    data: bytes
    taken: list[Taken]
    chunks: list[tuple[int, int, tuple[int, int]]]  # bytes and records, each the first and the one after the last

    def chunk_of(self, at: int) -> tuple[int, int, tuple[int, int]]:
        """Chunk that a byte is in, or that follows it; an empty one after the last."""
        end = len(self.taken)
        return next((chunk for chunk in self.chunks if at < chunk[1]), (len(self.data), 0, (end, end)))


@pytest.fixture(scope="module")
def example(tmp_path_factory: pytest.TempPathFactory) -> Example:
    path = tmp_path_factory.mktemp("recording") / "bench.mcap"
    taken = list(records())
    write(path, taken)
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        recorded = {
            c.id for c in summary.channels.values() if c.topic in {"/frames", "/faults", "/estimates", "/alarms"}
        }
        chunks = []
        last = 0
        for index in summary.chunk_indexes:
            file.seek(index.chunk_start_offset + 9)
            items = breakup_chunk(Chunk.read(ReadDataStream(file)), validate_crc=True)
            count = sum(isinstance(item, Message) and item.channel_id in recorded for item in items)
            start, first, last = index.chunk_start_offset, last, last + count
            chunks.append((start, start + index.chunk_length, (first, last)))
    assert last == len(taken)
    assert len(chunks) > 15
    return Example(path, path.read_bytes(), taken, chunks)


def test_a_recording_gives_back_what_was_recorded(example: Example) -> None:
    """Catches a lost bit, a lost order, a judgement that a replay inherits, a finding that it doubles."""
    recording = Recording(example.path)
    assert exact(recording.run) == exact(run())
    assert exact(list(recording.recorded())) == exact(example.taken)
    assert exact(list(recording.frames())) == exact(
        [
            replace(record, status=FrameStatus.ACCEPTED, reason="") if isinstance(record, Frame) else record
            for record in example.taken
            if isinstance(record, Frame) or (isinstance(record, Fault) and record.kind is FaultKind.LOST)
        ]
    )
    assert (recording.truncated, recording.damage, recording.live) == (False, [], False)
    assert exact(recording.end) == exact(END)


def rig_that_breaks() -> Iterator[Frame | Fault]:
    """Yield ten realisations with a distortion from the fifth on, and data as bad as rigs send them."""
    rng = np.random.default_rng(7)
    mixing = np.array([[1.0, 0.3], [0.2, 0.8]])
    for m in range(10):
        if m == 2:
            yield Fault(FaultKind.LOST, START, "a frame never came", m, 0, 1)  # spoils its experiment
        for experiment, u in enumerate(multisine.realisation(rig(), 1.0, 1, m)):
            for period in range(3):
                y = mixing @ u + np.outer((0, 0.2 if m > 3 else 0), u[1] ** 3) + 1e-3 * rng.normal(size=u.shape)
                time = START + ((m * 2 + experiment) * 3 + period) * 200_000_000
                frame = Frame(m, experiment, period, time, u, y)
                yield frame
                if m == 5 and period == 2:
                    yield frame  # doubled
                    yield replace(frame, y=y * np.nan)
                    yield replace(frame, y=y[:, :-1])
                    yield replace(frame, experiment=99, realisation=10**6)


class Listed:
    """Source and sink in one: what it is given, and what it is handed."""

    live = False

    def __init__(self, items: list[Frame | Fault]) -> None:
        self.run = replace(run(), window=2, excitation=Excitation("multisine", 1.0, 1))
        self.items = items
        self.handed: list[Taken] = []
        self.end: RunEnd | None = None

    def frames(self) -> Iterator[Frame | Fault]:
        return iter(self.items)

    def open(self, run: Run) -> None:
        assert exact(run) == exact(self.run)

    def take(self, record: Taken) -> None:
        self.handed.append(record)

    def tick(self, now: float) -> None: ...

    def close(self, end: RunEnd | None = None) -> None:
        self.end = end or self.end


@pytest.mark.parametrize("limits", [{}, {"max_seconds": 2.5}])
def test_replay_equals_live(tmp_path: Path, limits: dict[str, Any]) -> None:
    """Catches anything that a recording does not keep: a bit of an estimate, an alarm, a fault, its order."""
    live, again = Listed(list(rig_that_breaks())), Listed([])
    recorder = Recorder(tmp_path / "bench.mcap", **limits)
    drive(live, [live, recorder])
    recording = Recording(*recorder.paths)
    assert exact(list(recording.recorded())) == exact(live.handed)
    drive(Recording(*recorder.paths), [again])
    assert exact(again.handed) == exact(live.handed)
    assert exact(again.end) == exact(live.end) == exact(recording.end)
    assert any(isinstance(record, AlarmChange) for record in live.handed)
    assert {record.kind for record in live.handed if isinstance(record, Fault)} == {
        *(FaultKind.LOST, FaultKind.INCOMPLETE, FaultKind.DOUBLED),
        *(FaultKind.NOT_FINITE, FaultKind.WRONG_SHAPE, FaultKind.OUT_OF_PLAN),
    }


def test_a_cut_loses_only_the_chunk_it_touches(example: Example, tmp_path: Path) -> None:
    """500 places: whatever is left is read up to the last whole chunk, and that it was cut is said."""
    path = tmp_path / "cut.mcap"
    opened = example.chunks[0][0]  # the metadata before it tell the run
    places = np.random.default_rng(2).integers(opened, len(example.data), 500).tolist()
    for at in (*places, *(end for _, end, _ in example.chunks), len(example.data) - 1):
        path.write_bytes(example.data[:at])
        recording = Recording(path)
        kept = list(recording.recorded())
        whole = max((after for _, end, (_, after) in example.chunks if end <= at), default=0)
        assert exact(kept) == exact(example.taken[:whole]), at
        assert recording.truncated, at
        damaged = [r for r in recording.frames() if isinstance(r, Fault) and r.kind is FaultKind.DAMAGED]
        assert [fault.message for fault in damaged] == recording.damage, at
        torn = any(start < at < end for start, end, _ in example.chunks)
        assert bool(damaged) or not torn, at
        assert (recording.end is not None) == (at >= example.chunks[-1][1]), at


def test_a_cut_before_the_run_is_known_is_one_line(example: Example, tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    for at in range(example.chunks[0][0]):
        path.write_bytes(example.data[:at])
        with pytest.raises(RecordingError, match=r"cut\.mcap: ") as caught:
            Recording(path)
        assert "\n" not in str(caught.value)


def wrong_bytes(example: Example) -> Iterator[tuple[int, int]]:
    """Yield places and values: heads of chunks, chunks, what stands between them and what comes after."""
    rng = np.random.default_rng(3)
    (start, *_), (second, *_) = example.chunks[:2]
    yield from ((second, opcode) for opcode in range(16) if opcode != example.data[second])
    places = [*range(start, start + 60), *range(second, second + 60)]
    for begin, end, _ in example.chunks:
        places += rng.integers(begin, end, 5).tolist()
    places += rng.integers(start, example.chunks[-1][1], 200).tolist()
    places += rng.integers(example.chunks[-1][1], len(example.data), 50).tolist()
    for at in places:
        yield at, example.data[at] ^ int(rng.integers(1, 256))


def test_a_wrong_byte_loses_only_the_chunk_it_is_in(example: Example, tmp_path: Path) -> None:
    """Catches damage that is believed, a reader that stops at it, and a length that leads it astray."""
    path = tmp_path / "damaged.mcap"
    for at, wrong in wrong_bytes(example):
        path.write_bytes(example.data[:at] + bytes([wrong]) + example.data[at + 1 :])
        recording = Recording(path)
        kept = list(recording.recorded())
        start, _, (first, after) = example.chunk_of(at)
        if recording.damage and start <= at:
            assert exact(kept) == exact(example.taken[:first] + example.taken[after:]), at
        else:  # between chunks, or in the times of a chunk's head, which are there for other readers
            assert exact(kept) == exact(example.taken), at
            assert at < start or 9 <= at - start < 25, at
        assert exact(recording.end) == exact(END), at


def test_damage_of_any_length_is_survived_and_said(example: Example, tmp_path: Path) -> None:
    """Catches a false record made out of noise or zeros, and a loss that nobody is told of."""
    rng = np.random.default_rng(6)
    path = tmp_path / "damaged.mcap"
    place = {repr(record): index for index, record in enumerate(exact(example.taken))}
    for _ in range(100):
        at, length = int(rng.integers(example.chunks[0][0], len(example.data))), int(rng.integers(1, 9000))
        wrong = bytes(length) if rng.random() < 0.5 else rng.bytes(length)
        path.write_bytes((example.data[:at] + wrong + example.data[at + length :])[: len(example.data)])
        recording = Recording(path)
        kept = [place[repr(record)] for record in exact(list(recording.recorded()))]
        assert kept == sorted(set(kept))
        touched = {
            index
            for start, end, (first, after) in example.chunks
            if start < at + length and at < end
            for index in range(first, after)
        }
        assert set(range(len(place))) - set(kept) == touched
        assert recording.damage or not touched


def test_the_run_is_known_from_either_place(example: Example, tmp_path: Path) -> None:
    """Catches a recording that one bad sector at its beginning makes worthless."""
    path = tmp_path / "damaged.mcap"
    start, end, _ = example.chunks[0]
    for first, last in ((0, 4), (8, start), (start, end)):
        path.write_bytes(example.data[:first] + bytes(last - first) + example.data[last:])
        recording = Recording(path)
        assert exact(recording.run) == exact(run())
        assert exact(list(recording.recorded())) == exact(example.taken[example.chunks[0][2][1] :])


def test_a_recompressed_recording_with_other_ids_is_read(example: Example, tmp_path: Path) -> None:
    """Other tools renumber and compress what they filter."""
    path = tmp_path / "other.mcap"
    for compression in (CompressionType.ZSTD, CompressionType.LZ4):
        with example.path.open("rb") as source, path.open("wb") as target:
            reader = make_reader(source)
            writer = Writer(target, compression=compression)
            writer.start("", "another tool")
            ids: dict[str, int] = {}
            for schema, channel, message in reader.iter_messages(log_time_order=False):
                assert schema is not None
                if channel.topic not in ids:
                    number = writer.register_schema(schema.name, schema.encoding, schema.data)
                    other = writer.register_channel(f"/bench{channel.topic}", channel.message_encoding, number)
                    ids[channel.topic] = other
                writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
            writer.finish()  # type: ignore[no-untyped-call]
        recording = Recording(path)
        assert exact(list(recording.recorded())) == exact(example.taken)
        assert (recording.truncated, recording.damage) == (False, [])


def test_a_missing_part_is_said(tmp_path: Path) -> None:
    paths = write(tmp_path / "bench.mcap", records(), max_seconds=0.5).paths
    assert len(paths) == 6
    recording = Recording(*paths[:2], *paths[3:5])
    faults = [record for record in recording.frames() if isinstance(record, Fault)]
    assert recording.damage[0].startswith("bench-0004.mcap: part 3 of the recording is missing before it")
    assert faults[-1].kind is FaultKind.DAMAGED
    assert (recording.continues, recording.truncated) == (True, False)


def test_what_is_no_recording_is_refused_in_one_line(example: Example, tmp_path: Path) -> None:
    """Catches tracebacks of other libraries, and a long search through a file that is something else."""
    foreign = tmp_path / "foreign.mcap"
    writer = Writer(str(foreign))
    writer.start("ros2")
    channel = writer.register_channel("/x", "json", 0)
    writer.add_message(channel, 0, b"{}", 0)
    writer.finish()  # type: ignore[no-untyped-call]
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("time,u,y\n" * 1000)
    (tmp_path / "none").mkdir()
    other = tmp_path / "other.mcap"
    recorder = Recorder(other)
    recorder.open(replace(run(), id="another"))
    recorder.close(END)
    for paths, reason in (
        ([foreign], "foreign.mcap: is an MCAP file, but no recording of creak"),
        ([tmp_path / "empty.mcap"], "empty.mcap: is empty"),
        ([tmp_path / "text.mcap"], "text.mcap: is no MCAP file"),
        ([tmp_path / "nowhere.mcap"], "nowhere.mcap: cannot be read: No such file or directory"),
        ([tmp_path / "none"], "none: is a directory without recordings (*.mcap)"),
        ([example.path, other], "is of the run 'another', but bench.mcap of 'bench-1'; give the parts of one run"),
        ([example.path, example.path], "bench.mcap: is part 1 of its run, as bench.mcap is"),
        ([], "no recording is given"),
    ):
        with pytest.raises(RecordingError) as caught:
            Recording(*paths)
        assert str(caught.value).endswith(reason)
        assert "\n" not in str(caught.value)


def test_memory_does_not_grow_with_the_file(tmp_path: Path) -> None:
    """Catches a reader, or a writer, that holds the whole file: 40 MB of it here."""
    path = tmp_path / "long.mcap"
    tracemalloc.start()
    try:
        write(path, records(50, 4096), every=1000)
        written = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        frames = sum(isinstance(record, Frame) for record in Recording(path).frames())
        read = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert frames == 301
    assert path.stat().st_size > 38e6
    assert written < 8e6
    assert read < 8e6


def test_closing_ends_the_iteration(example: Example) -> None:
    recording = Recording(example.path)
    frames = recording.frames()
    next(frames)
    recording.close()
    recording.close()
    assert list(frames) == []
