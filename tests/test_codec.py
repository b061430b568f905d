"""Laws of the codec: a record survives bytes and text exactly, and what users see is plain JSON."""

import contextlib
import dataclasses
import json
from datetime import datetime
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from conftest import make_rig, make_run
from creak import codec
from creak.alarm_records import AlarmRules, BaselineRules
from creak.codec import memory, memory_bytes, memory_of
from creak.detection import LineSums
from creak.errors import InputError, RecordingError
from creak.judgement import Block
from creak.monitor import Monitor
from creak.records import (
    AlarmChange,
    AlarmState,
    Counts,
    ElementShare,
    Estimate,
    Excitation,
    Fault,
    FaultKind,
    Frame,
    FrameStatus,
    Limits,
    Node,
    NodeLevel,
    Rig,
    Run,
    RunEnd,
    RunStatus,
    Scope,
    Spectra,
)
from creak.statistics import Sums
from recorded import exact

EXCITED = Excitation("multisine")
text = st.text(max_size=8)
whole = st.integers(-(2**63), 2**63 - 1)
number = st.floats(width=64)
perhaps = st.none() | number
index = st.none() | whole
# Any 64 bits are a sample: negative zero, subnormals and NaNs with a payload included.
samples = arrays(np.uint64, array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=5)).map(
    lambda bits: bits.view(np.float64)
)
pairs = st.lists(st.tuples(text, text), max_size=3).map(tuple)

nodes = st.lists(st.builds(Node, text, text, st.none() | text), max_size=3).map(tuple)
rigs = st.builds(
    Rig,
    name=text,
    sample_rate=number,
    period_samples=whole,
    transient_periods=whole,
    lines=st.lists(whole, max_size=5).map(tuple),
    nodes=nodes,
    grid=st.sampled_from(["full", "odd", "random-odd"]),
    hold=st.sampled_from(["band-limited", "zero-order"]),
    network=st.none() | pairs,
)
runs = st.builds(
    Run,
    id=text,
    rig=rigs,
    steady_periods=whole,
    start=whole,
    excitation=st.builds(Excitation, st.sampled_from(["multisine", "measured"]), perhaps, index),
    source=text,
    window=whole,
    limits=st.builds(Limits, number, number, number, whole, whole, perhaps, perhaps),
    software=text,
    alarms=st.builds(AlarmRules, number, number, perhaps, number, perhaps, number),
    baseline=st.builds(BaselineRules, whole, number, number, perhaps),
    before=st.binary(max_size=20),
)
frames = st.builds(Frame, whole, whole, whole, whole, samples, samples, st.sampled_from(FrameStatus), text)
faults = st.builds(Fault, st.sampled_from(FaultKind), whole, text, index, index, index)
levels = st.builds(NodeLevel, text, number, *[perhaps] * 8)
estimates = st.builds(
    Estimate,
    scope=st.sampled_from(Scope),
    time=whole,
    realisation=whole,
    realisations=whole,
    experiments=whole,
    periods=whole,
    nodes=st.lists(levels, max_size=3).map(tuple),
    spectra=st.builds(Spectra, *[samples] * 8, *[st.none() | samples] * 3),
    located=st.booleans(),
    elements=st.lists(
        st.builds(ElementShare, st.tuples(text, text), number, number, st.booleans()), max_size=2
    ).map(tuple),
    unavailable=st.lists(text, max_size=2).map(tuple),
)
changes = st.builds(
    AlarmChange,
    id=text,
    rig=text,
    node=text,
    class_=st.sampled_from(["process", "quality"]),
    severity=st.sampled_from(["warning", "alarm"]),
    event=text,
    state=st.sampled_from(AlarmState),
    active=st.booleans(),
    acknowledged=st.booleans(),
    shelved=st.booleans(),
    since=whole,
    time=whole,
    level_db=number,
    version=whole,
    condition=text,
    by=text,
    comment=text,
    shelved_until=index,
    suppressed=st.booleans(),
    out_of_service=st.booleans(),
    latched=st.booleans(),
    guidance=text,
)
counts = st.builds(Counts, whole, whole, whole, whole, whole, st.dictionaries(text, whole, max_size=3))
ends = st.builds(RunEnd, whole, st.sampled_from(RunStatus), counts, text)


@given(st.one_of(runs, frames, faults, estimates, levels, changes, ends))
def test_every_record_survives_bytes_exactly(record: Any) -> None:
    """Catches a field left out of the layout, None read as 0, a float rounded, a shape lost."""
    assert exact(codec.decode(type(record).__name__, codec.encode(record))) == exact(record)


@given(runs, ends, st.integers(1, 9999), st.booleans())
def test_opening_and_closing_survive_metadata_exactly(run: Run, end: RunEnd, part: int, continues: bool) -> None:
    """Catches a recording that cannot be opened any more once its first chunk is damaged."""
    opening, closing = codec.Opening(run, part), codec.Closing(end, continues)
    kept = codec.opening_of(codec.opening_text(opening))
    assert kept is not None
    assert exact(kept) == exact(opening) == exact(codec.decode_opening(codec.encode(opening)))
    ended = codec.closing_of(codec.closing_text(closing))
    assert ended is not None
    assert exact(ended) == exact(closing) == exact(codec.decode_closing(codec.encode(closing)))


def test_a_recording_without_rules_has_the_usual_ones() -> None:
    """Kills a reader that takes what an older version never wrote as None or 0."""
    message = codec.protobuf.MESSAGES["Run"].FromString(codec.encode(Run("r", make_rig(), 2, 0, EXCITED, "test")))
    message.ClearField("alarms")
    message.ClearField("baseline")
    message.limits.ClearField("warning_db")
    run = codec.decode_opening(message.SerializeToString()).run
    assert (run.alarms, run.baseline, run.limits) == (AlarmRules(), BaselineRules(), Limits())


def test_altered_metadata_is_not_believed() -> None:
    text = codec.closing_text(codec.Closing(RunEnd(5, RunStatus.COMPLETED, Counts(frames=60))))
    assert codec.closing_of(text | {"closing": text["closing"].replace("60", "61")}) is None
    assert codec.closing_of({}) is None


@given(st.sampled_from(["Run", "Frame", "Estimate", "RunEnd", "Fault"]), st.binary(max_size=200))
def test_bytes_that_are_no_record_are_refused_as_such(name: str, data: bytes) -> None:
    """Catches a traceback of protobuf, an enum or numpy reaching the user."""
    with contextlib.suppress(RecordingError):  # most of such bytes; some are a record after all
        codec.decode(name, data)


def test_a_newer_format_is_refused_by_name() -> None:
    run = Run(
        "r", Rig("r", 1.0, 8, 0, (1,), (Node("1", "m"),)), 2, 0, Excitation("measured"), "stream", software="9.0"
    )
    newer = codec.encode(run) + b"\x50\x63"  # field 10, format, is 99
    with pytest.raises(RecordingError, match=r"creak 9\.0 in format 99"):
        codec.decode_opening(newer)


def test_the_descriptors_alone_decode_a_frame() -> None:
    """Catches a descriptor set that other tools cannot resolve, and field numbers that moved."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(codec.DESCRIPTOR_SET).file:
        pool.Add(file)
    described = message_factory.GetMessageClass(pool.FindMessageTypeByName("creak.Frame"))
    frame = Frame(1, 2, 3, 4, np.arange(6.0).reshape(2, 3), np.ones((1, 3)), FrameStatus.REJECTED, "late")
    message = described.FromString(codec.encode(frame))
    assert (message.time, message.realisation, message.status, message.reason) == (4, 1, "rejected", "late")
    assert list(message.u.values) == [0, 1, 2, 3, 4, 5]
    assert list(message.u.shape) == [2, 3]
    assert message.DESCRIPTOR.fields_by_name["y"].number == 8


@given(whole)
def test_times_survive_their_text_exactly(time: int) -> None:
    """Catches a time that passed through a float, and one that other software reads as local."""
    shown = codec.time_json(time)
    assert codec.parse_time(shown) == time
    assert shown.endswith("Z")
    elsewhere = datetime.fromisoformat(shown)  # reads microseconds
    assert abs(elsewhere.timestamp() - time / 1e9) < 1e-4


@pytest.mark.parametrize(
    ("written", "time"),
    [
        ("1970-01-01", 0),
        ("1970-01-02T00:00Z", 86_400 * 10**9),
        ("1970-01-01 01:00:00.5+01:00", 500_000_000),
        ("1969-12-31T23:59:59.999999999Z", -1),
        ("2026-05-01T08:30:00,25-0530", 1_777_644_000_250_000_000),
    ],
)
def test_times_as_people_write_them(written: str, time: int) -> None:
    assert codec.parse_time(written) == time


@pytest.mark.parametrize(
    "written",
    [
        *("", "now", "2026-13-01", "2026-02-30", "2026-01-01T25:00", "01.02.2026", "20260101", "\u0662026-01-01"),
        *(
            "2026-01-01T00:00:00.0000000001Z",
            "2026-01-01T00:00.5",
            "2026-01-01T00:00+99:00",
            "1600-01-01",
            "9999-12-31",
        ),
    ],
)
def test_what_is_no_time_is_refused_with_what_is_allowed(written: str) -> None:
    with pytest.raises(InputError, match=r"allowed is ISO 8601|lies outside"):
        codec.parse_time(written)


@given(estimates, counts, changes, faults, st.booleans())
def test_json_has_no_nan(estimate: Estimate, count: Counts, change: AlarmChange, fault: Fault, cut: bool) -> None:
    """Catches NaN and Infinity, which Python writes and no other JSON reader takes."""
    names = {level.name: AlarmState.NORMAL for level in estimate.nodes}
    for shown in (
        codec.summary_json("r", count, estimate, names, cut),
        codec.alarm_json(change),
        codec.fault_json(fault),
    ):
        assert json.loads(json.dumps(shown, allow_nan=False)) == shown


ALARM_KEYS = "id rig node class severity state active acknowledged shelved since level_db"
SUMMARY_KEYS = "rig frames rejected_frames experiments realisations truncated nodes elements located"
NODE_KEYS = (
    "name signal_db noise_db total_db nonlinear_db total_to_noise_db classical_total_to_noise_db p_value alarm"
)


def test_summary_has_the_keys_of_the_contract_in_order() -> None:
    level = NodeLevel("1", -48.6, -97.1, -97.2, None, -0.1, -90.0, -63.2, 26.8, 0.4)
    nothing = np.empty((0, 1))
    estimate = Estimate(
        Scope.RUN, 0, 9, 10, 30, 2, (level,), Spectra(np.empty(0), *[nothing] * 7), True,
        (ElementShare(("3", "ground"), 0.99, 0.999, True),), ("said",),
    )  # fmt: skip
    alarms = {"1": AlarmState.RETURNED_UNACKNOWLEDGED}
    shown = codec.summary_json(
        "three-mass", Counts(60, 0, 60, 10, 30), estimate, alarms, False, unavailable=("more",)
    )
    assert list(shown)[:9] == SUMMARY_KEYS.split()
    assert list(shown["nodes"][0])[:9] == NODE_KEYS.split()
    assert shown["nodes"][0]["alarm"] == "returned_unacknowledged"
    assert shown["nodes"][0]["nonlinear_db"] is None
    assert shown["nodes"][0]["classical_total_db"] == -63.2
    assert shown["elements"] == [
        {"between": ["3", "ground"], "share": 0.99, "confidence": 0.999, "separable": True}
    ]
    assert shown["located"] is True
    assert shown["unavailable"] == ["said", "more"]


def test_summary_of_a_run_without_estimate_still_lists_its_nodes() -> None:
    alarms = {"1": AlarmState.NORMAL, "2": AlarmState.NORMAL}
    shown = codec.summary_json("r", Counts(), None, alarms, True)
    assert [node["name"] for node in shown["nodes"]] == ["1", "2"]
    assert all(node["signal_db"] is None for node in shown["nodes"])
    assert (shown["located"], shown["truncated"], shown["elements"]) == (False, True, [])


def test_spectrum_is_null_where_power_is_not_positive() -> None:
    """Catches minus infinity for an empty line, and the columns of nodes mixed up."""
    power = np.array([[1.0, 100.0], [9.0, 0.0], [9.0, -1.0], [9.0, np.nan]])
    level = NodeLevel("1", 0.0, *[None] * 8)
    estimate = Estimate(
        Scope.RUN, 0, 0, 1, 1, 1, (level, dataclasses.replace(level, name="2")),
        Spectra(np.arange(4.0), *[power] * 7), False,
    )  # fmt: skip
    shown = codec.spectrum_json(estimate, "2")
    assert shown.pop("frequency_hz") == [0.0, 1.0, 2.0, 3.0]
    shown = {key: levels for key, levels in shown.items() if key.endswith("_db")}
    assert len(shown) == 7
    assert all(column == [20.0, None, None, None] for column in shown.values())
    with pytest.raises(InputError, match="'3' is not a node; there are 1, 2"):
        codec.spectrum_json(estimate, "3")


def test_alarm_has_the_keys_of_the_contract() -> None:
    change = AlarmChange(
        "a",
        "r",
        "3",
        "process",
        "alarm",
        "raised",
        AlarmState.UNACKNOWLEDGED,
        True,
        False,
        False,
        10**9,
        2 * 10**9,
        7.5,
    )
    shown = codec.alarm_json(change)
    assert "class_" not in shown
    assert shown["class"] == "process"
    assert shown["state"] == "unacknowledged"
    assert shown["since"] == "1970-01-01T00:00:01.000000Z"
    assert set(shown) >= set(ALARM_KEYS.split())


def test_arrays_keep_their_order_in_memory_and_shared_ones_are_written_once(rng):
    """Kills a restart with every matrix in another order than the loops want, and bytes written four times."""
    lines_last = rng.standard_normal((2, 3, 50)).transpose(2, 0, 1)
    shared, seen = rng.standard_normal((50, 2, 3)) + 1j, rng.standard_normal((2, 50, 3)) + 0j
    sums = [Sums(1, 2, shared, lines_last, shared, shared, seen, shared) for _ in range(4)]
    nothing = LineSums(1, 2, np.empty((0, 2)), np.empty((0, 2)))
    blocks = tuple(Block(one, nothing, nothing) for one in sums)
    data = memory_bytes(dataclasses.replace(Monitor(make_run(make_rig(2))).memory, blocks=blocks))
    assert len(data) < shared.nbytes + lines_last.nbytes + seen.nbytes + 8_000
    for block in memory_of(data).blocks:
        np.testing.assert_array_equal(block.sums.S, shared)
        np.testing.assert_array_equal(block.sums.spread, lines_last)
        np.testing.assert_array_equal(block.sums.period_sums, seen)
        assert block.sums.spread.strides == lines_last.strides


def test_arrays_come_back_to_the_last_bit_and_zeros_take_no_bytes(rng):
    """Kills a zero whose sign is lost, and an order of axes that is not kept."""
    moments = (rng.standard_normal((3, 3, 400)) + 1j * rng.standard_normal((3, 3, 400))).transpose(2, 0, 1)
    for array in (moments, moments.copy(), np.zeros_like(moments), -np.zeros((3, 2))):
        back = codec.unpacked(np.ndarray, codec.packed(array))
        assert (back.tobytes(), back.strides) == (array.tobytes(), array.strides)
    assert len(codec.packed(np.zeros((1000, 6, 6), complex))) < 200


def test_sums_of_the_format_before_are_read(rng):
    """Its moments were full matrices; kills an update that forgets what a rig knew."""
    sums = Sums.of(rng.standard_normal((2, 3, 5, 4)) + 1j * rng.standard_normal((2, 3, 5, 4)), 2)
    none = LineSums(2, 3, np.zeros((0, 2)), np.zeros((0, 2)))
    arrays = memory._Arrays()
    record = memory._plain(Block(sums, none, none), arrays)
    fields = record[2]["sums"][2]
    for name in ("between", "within"):
        del fields[f"packed_{name}"]
        fields[name] = arrays.add(getattr(sums, name))
    text = json.dumps({"format": 2, "memory": record}).encode()
    back = codec.unpacked(Block, b"".join((len(text).to_bytes(8, "little"), text, *arrays.parts))).sums
    for name in ("S", "packed_between", "packed_within", "period_sums"):
        np.testing.assert_array_equal(getattr(back, name), getattr(sums, name))
