"""The receive loop: what a dead, silent or overfull bus leads to; no bus of the machine is needed."""

import threading
import time

import can
import pytest

import can_rigs
from conftest import make_frames, make_rig, make_run
from creak.monitor import Monitor
from creak.records import AlarmChange, Fault, FaultKind, Frame
from creak.sources import canbus
from creak.sources.can_controller import Controller
from creak.sources.canbus import CanBus
from test_can_logs import messages

RUN = make_run(make_rig(2, samples=64, lines=range(2, 10)))


class Bus:
    """Plays a list: messages, None for nothing heard, exceptions that the interface raises."""

    def __init__(self, script):
        self.script = iter(script)
        self.closed = False

    def recv(self, timeout):
        item = next(self.script, None)
        if item is None:
            time.sleep(0.01)
        if isinstance(item, Exception):
            raise item
        return item

    def shutdown(self):
        self.closed = True


@pytest.fixture
def source(tmp_path, monkeypatch):
    """Builds a CanBus over scripted buses, one after the other; gives it and its opened buses."""
    monkeypatch.setattr(canbus, "_BACK_OFF", (0.02, 0.1))

    def build(*scripts, **keys):
        buses = iter([Bus(s) if not isinstance(s, Exception) else s for s in scripts])
        opened = []

        def open_bus(_source):
            bus = next(buses)
            if isinstance(bus, Exception):
                raise bus
            opened.append(bus)
            return bus

        monkeypatch.setattr(canbus, "open_bus", open_bus)
        given = can_rigs.source(tmp_path, can_rigs.one_frame(2), **keys)
        mapping = can_rigs.mapping(tmp_path, RUN, can_rigs.one_frame(2))
        return CanBus(RUN, mapping, given), mapping, opened

    return build


def played(mapping, count=1):
    controller = Controller(RUN, mapping)
    return [list(messages(controller.frames(f, i))) for i, f in enumerate(make_frames(RUN, count))]


def collect(bus, until, seconds=10.0):
    out = []
    killer = threading.Timer(seconds, bus.close)
    killer.start()
    for item in bus.frames():
        out.append(item)
        if until(out):
            bus.close()
    killer.cancel()
    return out


def kinds(out):
    return [o.kind for o in out if isinstance(o, Fault)]


def test_an_interface_that_dies_is_opened_again_and_the_gap_is_named(source, tmp_path):
    """Kills a receive thread that dies silently."""
    mapping = can_rigs.mapping(tmp_path, RUN, can_rigs.one_frame(2))
    periods = played(mapping, 2)
    first = [*periods[0], *periods[1][:5], can.CanOperationError("device gone")]
    rest = [m for period in periods[2:] for m in period]
    bus, _, opened = source(first, OSError("still gone"), OSError("still gone"), rest)
    out = collect(bus, lambda o: sum(isinstance(i, Frame) for i in o) == 11)
    assert sum(isinstance(i, Frame) for i in out) == 11
    assert kinds(out) == [FaultKind.DISCONNECTED, FaultKind.LOST]  # said once, not at every attempt
    assert next(o.message for o in out if isinstance(o, Fault)).startswith("virtual x: device gone")
    assert [type(o) for o in out[:2]] == [Frame, Fault]  # in the order in which they happened
    assert [b.closed for b in opened] == [True, True]


def test_any_exception_of_an_interface_is_survived(source, tmp_path):
    """Kills a loop that knows only the exceptions that python-can documents."""
    mapping = can_rigs.mapping(tmp_path, RUN, can_rigs.one_frame(2))
    periods = played(mapping)
    bus, _, _ = source([ZeroDivisionError("driver bug")], [m for p in periods for m in p])
    out = collect(bus, lambda o: sum(isinstance(i, Frame) for i in o) == 6)
    assert sum(isinstance(i, Frame) for i in out) == 6
    assert FaultKind.DISCONNECTED in kinds(out)


def test_silence_and_bus_off_raise_a_quality_alarm_that_the_next_period_clears(source, tmp_path):
    """Kills a quality alarm that looks like a change of the machine, or stands for ever."""
    mapping = can_rigs.mapping(tmp_path, RUN, can_rigs.one_frame(2))
    periods = played(mapping)
    off = can.Message(arbitration_id=0x40, is_error_frame=True)
    bus, _, _ = source([*periods[0], *[None] * 30, off], [m for p in periods[1:] for m in p], silence=0.1)
    out = collect(bus, lambda o: sum(isinstance(i, Frame) for i in o) == 6)
    assert kinds(out)[:2] == [FaultKind.SILENT, FaultKind.BUS_OFF]
    monitor = Monitor(RUN)
    changes = [c for item in out for c in monitor.take(item) if isinstance(c, AlarmChange)]
    assert [(c.class_, c.node, c.event, c.active) for c in changes[:2]] == [
        ("quality", "", "raised", True),
        ("quality", "", "cleared", False),
    ]
    assert set(monitor.alarms) == {"1", "2"}


def test_what_decoding_has_no_room_for_is_counted_where_it_is_dropped(source, tmp_path, monkeypatch):
    """Kills a queue that grows without bound, or one that drops without a word."""
    monkeypatch.setattr(canbus, "_QUEUE_BATCHES", 1)
    monkeypatch.setattr(canbus, "_BATCH_FRAMES", 4)
    mapping = can_rigs.mapping(tmp_path, RUN, can_rigs.one_frame(2))
    periods = played(mapping, 2)
    script = [m for p in periods[:6] for m in p]
    bus, _, _ = source([*script, *[None] * 20, *[m for p in periods[6:] for m in p for m in (m, None)]])
    stream = bus.frames()
    receiver = threading.Thread(target=bus._receive, daemon=True)
    receiver.start()
    time.sleep(0.15)  # nobody takes while the first six periods come
    bus.close()
    receiver.join()
    assert bus._dropped >= 80
    assert "frames were dropped" in " ".join(item.message for item in stream if isinstance(item, Fault))
