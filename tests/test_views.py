"""What tools that know nothing of creak find in a recording, read by those tools."""

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from creak.codec import alarm_line, spectrum_topic, view_topics, views
from creak.records import AlarmChange, Estimate, Fault, Frame, FrameStatus, Scope
from creak.sources.recording import Recording
from recorded import END, exact, records, run, write


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("views") / "bench.mcap"
    write(path, records())
    return path


def decoded(path: Path, topic: str) -> Iterator[Any]:
    """Read a topic with the official reader, by the schemas that the file carries alone."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for item in reader.iter_decoded_messages(topics=[topic]):
            assert item.schema is not None
            yield item.schema.name, item.message.log_time, item.decoded_message


def nanoseconds(stamp: Any) -> int:
    return int(stamp.seconds * 1_000_000_000 + stamp.nanos)


def windows() -> list[Estimate]:
    return [record for record in records() if isinstance(record, Estimate) and record.scope is Scope.WINDOW]


@pytest.mark.parametrize("quantity", ["signal", "noise", "total", "nonlinear"])
def test_spectra_are_curves(path: Path, quantity: str) -> None:
    """Catches exchanged nodes or quantities, powers where levels belong, and curves of nothing."""
    for index, node in enumerate(run().rig.nodes):
        wanted = [
            (estimate.time, estimate.spectra.frequency, 10 * np.log10(np.where(power > 0, power, np.nan)))
            for estimate in windows()
            if ((power := getattr(estimate.spectra, quantity)[:, index]) > 0).any()
        ]
        found = list(decoded(path, spectrum_topic(node.name, quantity)))
        assert len(found) == len(wanted) > 0
        for (schema, logged, message), (time, frequency, level) in zip(found, wanted, strict=True):
            assert (schema, logged) == ("creak.Spectrum", time)
            assert list(message.freq) == frequency.tolist()
            np.testing.assert_allclose(message.level, level, rtol=1e-15, equal_nan=True)


def test_where_nothing_is_located_the_classical_spectra_are_shown() -> None:
    rig = run().rig
    one_input = replace(rig, nodes=(rig.nodes[0], replace(rig.nodes[1], input=None)))
    assert [topic for topic in view_topics(one_input) if "left/" in topic] == [
        "/spectra/left/signal",
        "/spectra/left/classical_noise",
        "/spectra/left/classical_total",
        "/spectra/left/classical_nonlinear",
    ]


def test_alarms_are_events_of_foxglove(path: Path) -> None:
    """Catches times in the wrong unit and an event that lasts until it is read."""
    (change,) = [record for record in records() if isinstance(record, AlarmChange)]
    ((schema, logged, event),) = decoded(path, "/events")
    assert schema == "foxglove.Event"
    assert logged == nanoseconds(event.start_time) == nanoseconds(event.end_time) == change.time
    metadata = {pair.key: pair.value for pair in event.metadata}
    assert len(metadata) == len(event.metadata)  # keys are unique by the definition
    assert metadata == {
        "id": "a1",
        "rig": "bench",
        "node": "left",
        "class": "process",
        "severity": "alarm",
        "event": "raised",
        "state": "unacknowledged",
        "level_db": "9.50",
    }


def test_the_event_of_a_cleared_alarm_covers_its_life() -> None:
    from foxglove_schemas_protobuf.Event_pb2 import Event

    (change,) = [record for record in records() if isinstance(record, AlarmChange)]
    cleared = replace(change, event="cleared", time=change.since + 3_000_000_001)
    data = dict(views(cleared, run().rig))
    event = Event.FromString(data["/events"])
    assert nanoseconds(event.end_time) - nanoseconds(event.start_time) == 3_000_000_001


def test_what_happened_is_a_log_of_foxglove(path: Path) -> None:
    """Catches a fault or an alarm that the log does not tell, and warnings that look like news."""
    info, warning, error = 2, 3, 4
    wanted = [(run().start, info, "run bench-1 begins, source simulated")]
    for record in records():
        if isinstance(record, Fault):
            wanted.append((record.time, warning, record.message))
        elif isinstance(record, AlarmChange):
            wanted.append((record.time, error, alarm_line(record)))
    wanted.append((END.time, info, "interrupted: stopped by the user"))
    lines = list(decoded(path, "/log"))
    assert [(nanoseconds(line.timestamp), line.level, line.message) for _, _, line in lines] == wanted
    assert {(schema, line.name) for schema, _, line in lines} == {("foxglove.Log", "bench")}
    assert [logged for _, logged, _ in lines] == [time for time, _, _ in wanted]


def test_the_schemas_of_foxglove_are_the_published_ones(path: Path) -> None:
    """Field numbers and names as docs.foxglove.dev and the schemas' repository have them."""
    published = {
        "foxglove.Event": {1: "start_time", 2: "end_time", 3: "metadata"},
        "foxglove.Log": {1: "timestamp", 2: "level", 3: "message", 4: "name", 5: "file", 6: "line"},
    }
    for topic in ("/events", "/log"):
        schema, _, message = next(decoded(path, topic))
        assert {field.number: field.name for field in message.DESCRIPTOR.fields} == published[schema]


def test_an_independent_doctor_finds_no_error(path: Path) -> None:
    """Catches what the official reader forgives: indexes of nothing, offsets and statistics that do not hold."""
    command = [str(Path(sys.executable).with_name("pymcap-cli")), "doctor", "--format", "jsonl", str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    findings = [line for line in map(json.loads, done.stdout.splitlines()) if line["type"] == "finding"]
    assert done.returncode == 0, findings
    # The metadata stand twice on purpose, before the data and behind them with the end.
    assert {f["code"] for f in findings if f["severity"] != "info"} <= {"METADATA_NAME_DUPLICATE"}


def test_a_recording_of_before_is_read() -> None:
    """The file was written by the version before views came; catches ids that moved."""
    recording = Recording(Path(__file__).parent / "golden" / "before-views.mcap")
    assert exact(recording.run) == exact(run())
    assert exact(list(recording.recorded())) == exact(list(records(2, 16)))
    assert (recording.truncated, recording.damage) == (False, [])


def test_a_frame_has_no_view() -> None:
    """Frames come many times a second: their samples stand in the file once."""
    frame = Frame(0, 0, 0, 0, np.zeros((2, 4)), np.zeros((2, 4)), FrameStatus.ACCEPTED)
    assert list(views(frame, run().rig)) == []
