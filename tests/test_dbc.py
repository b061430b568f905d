"""Bulk decoding against cantools: any DBC, any payload."""

import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from creak.errors import ConfigurationError
from creak.sources.dbc import Database, Message, _message


def bits_of(start, length, big_endian):
    """Positions (8 byte + bit) that a signal takes."""
    if not big_endian:
        return list(range(start, start + length))
    taken, position = [], start
    for _ in range(length):
        taken.append(position)
        position = position - 1 if position % 8 else position + 15
    return taken


@st.composite
def databases(draw):
    """Text of a DBC with one message, its signals free of overlap, and how many bytes it has."""
    size = draw(st.sampled_from([1, 2, 3, 8, 12, 48, 64]))
    free = set(range(8 * size))
    lines, kinds = [], []
    mux = draw(st.booleans())
    if mux:
        lines.append(' SG_ Mux M : 0|3@1+ (1,0) [0|0] "" X')
        free -= {0, 1, 2}
    shared = set(free)
    for index in range(draw(st.integers(1, 12))):
        group = draw(st.sampled_from([None, 0, 1, 5])) if mux else None
        room = free if group is None else shared
        floating = draw(st.sampled_from([None, None, None, 32, 64]))
        length = floating or draw(st.integers(1, 64))
        big = draw(st.booleans())
        start = draw(st.integers(0, 8 * size - 1))
        taken = bits_of(start, length, big)
        # signals of other multiplexer values may share bits; to keep it simple they share none
        if not set(taken) <= (room & free):
            continue
        free -= set(taken)
        signed = floating is not None or draw(st.booleans())
        scale = draw(st.sampled_from(["1", "0.5", "-2", "0.001", "1e-06", "3"]))
        offset = draw(st.sampled_from(["0", "-40", "0.25", "1e3"]))
        m = "" if group is None else f" m{group}"
        lines.append(
            f" SG_ S{index}{m} : {start}|{length}@{0 if big else 1}{'-' if signed else '+'}"
            f' ({scale},{offset}) [0|0] "" X'
        )
        if floating:
            kinds.append(f"SIG_VALTYPE_ 100 S{index} : {1 if floating == 32 else 2};")
    text = 'VERSION ""\nNS_ :\nBS_:\nBU_: X\n\n' + f"BO_ 100 Msg: {size} X\n" + "\n".join(lines) + "\n\n"
    return text + "\n".join(kinds) + "\n", size


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_bulk_decoding_equals_cantools(data):
    """Kills a wrong shift, sign, byte order, ninth byte, scale, or a multiplexed value taken where it is not."""
    text, size = data.draw(databases())
    theirs = cantools.database.load_string(text, "dbc").messages[0]
    ours = _message(theirs)
    assert isinstance(ours, Message)
    payloads = data.draw(st.lists(st.binary(min_size=size, max_size=size), min_size=1, max_size=6))
    payloads += [bytes(size), b"\xff" * size, b"\x80" + bytes(size - 1)]
    array = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, size)
    expected = []
    for payload in payloads:
        try:
            expected.append(theirs.decode(payload, decode_choices=False))
        except cantools.database.DecodeError:  # a multiplexer value that the DBC does not know
            expected.append(None)
    for name, signal in ours.signals.items():
        values, present = signal.values(array), signal.present(array)
        for i, wanted in enumerate(expected):
            if wanted is None:
                continue
            assert present[i] == (name in wanted)
            if name in wanted:
                # cantools keeps whole numbers of any size; a double holds 53 bits of them
                np.testing.assert_allclose(values[i], float(wanted[name]), rtol=3e-16, atol=0, equal_nan=True)


DBC = """VERSION ""
NS_ :
BS_:
BU_: X

BO_ 100 One: 8 X
 SG_ A : 0|16@1+ (1,0) [0|0] "" X
 SG_ B : {start}|16@1+ (1,0) [0|0] "" X

BO_ 101 Two: 8 X
 SG_ A : 0|16@1+ (1,0) [0|0] "" X
"""


def test_what_a_dbc_must_not_be(tmp_path):
    """Every slip is one line that names the file and what is wrong."""
    path = tmp_path / "rig.dbc"
    with pytest.raises(ConfigurationError, match=r"rig\.dbc: cannot be read: No such file"):
        Database(path)
    path.write_text(DBC.format(start=8))
    with pytest.raises(ConfigurationError, match=r"rig\.dbc: .*B and A are overlapping") as found:
        Database(path)
    assert "\n" not in str(found.value)
    path.write_text("no DBC at all")
    with pytest.raises(ConfigurationError, match=r"rig\.dbc: cannot be used as a DBC"):
        Database(path)
    path.write_text(DBC.format(start=56))
    with pytest.raises(ConfigurationError, match=r"rig\.dbc: .*B does not fit in message One"):
        Database(path)
    path.write_text(DBC.format(start=16))
    database = Database(path)
    for name, problem in (
        ("One.C", "message 'One' of .* has no signal 'C'; it has A, B"),
        ("Three.A", "no message 'Three'; it has One, Two"),
        ("A", "ambiguous .* write One.A and Two.A"),
        ("Z", "no such signal"),
    ):
        with pytest.raises(ConfigurationError, match=rf"creak\.toml: signals\.counter: '{name}'.*{problem}"):
            database.signal(name, "signals.counter", "creak.toml")
    assert database.signal("B", "", "")[1].name == "One.B"


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_what_is_written_is_what_cantools_writes(data):
    """Kills a rig that sends other bits than the DBC says."""
    text, size = data.draw(databases())
    theirs = cantools.database.load_string(text, "dbc").messages[0]
    ours = _message(theirs)
    payload = np.frombuffer(data.draw(st.binary(min_size=size, max_size=size)), np.uint8).reshape(1, -1)
    written = np.zeros_like(payload)
    for signal in ours.signals.values():
        signal.put_bits(written, signal.bits(payload))
    for signal in ours.signals.values():
        np.testing.assert_array_equal(signal.bits(written), signal.bits(payload))
    plain = [s for s in theirs.signals if not s.is_float and s.length <= 40 and s.multiplexer_ids is None]
    if any(s.multiplexer_ids for s in theirs.signals) or len(plain) < len(theirs.signals):
        return
    raw = {s.name: int(ours.signals[s.name].raw(payload)[0]) for s in plain}
    again = np.zeros_like(payload)
    for s in plain:
        signal = ours.signals[s.name]
        assert not signal.put(again, signal.values(payload)).any()
    assert again.tobytes() == theirs.encode(raw, scaling=False)
