"""Sender and acquisition in two processes on vcan0: what the virtual machine of test_socketcan.py runs.

The acquisition is the service's own source and monitor; API and simulator stay outside: an emulated processor
takes minutes to load them. Where the host has vcan0, test_can.py runs whole commands on it.
"""

import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

import numpy as np
import pytest

import can_rigs
from conftest import make_frames, make_rig, make_run
from creak.errors import ConfigurationError
from creak.monitor import Monitor
from creak.records import Fault, FaultKind, Frame
from creak.sources.can_controller import Controller, quantised
from creak.sources.can_frames import EXTENDED
from creak.sources.canbus import CanBus, open_bus

RUN = make_run(make_rig(2, samples=256, lines=range(2, 60)))
FRAMES = make_frames(RUN, 4)
LOST = 700  # the frame that the sender leaves out
RATE = 400.0  # frames a second: vcan has no back-pressure


def described(layout, **keys):
    text, signals = can_rigs.LAYOUTS[layout]
    folder = Path(tempfile.mkdtemp())
    keys = {"interface": "socketcan", "channel": "vcan0", **keys}
    return can_rigs.source(folder, text(2), signals, **keys), can_rigs.mapping(
        folder, RUN, text(2), signals, **keys
    )


def send():
    import can

    source, mapping = described("one frame")
    bus = open_bus(source)
    controller, count, due = Controller(RUN, mapping), 0, time.monotonic()
    for index, frame in enumerate(FRAMES):
        frames = controller.frames(frame, index)
        for row in range(len(frames)):
            count += 1
            due += 1 / RATE
            time.sleep(max(0.0, due - time.monotonic()))
            if count != LOST:
                data = frames.data[row, : frames.lengths[row]].tobytes()
                number = int(frames.identifiers[row]) & ~EXTENDED
                bus.send(can.Message(arbitration_id=number, is_extended_id=False, data=data, is_fd=True))
        if index == 3:
            bus.send(can.Message(arbitration_id=0x08, is_error_frame=True, data=bytes(8)))
    bus.shutdown()


def receive():
    source, mapping = described("one frame", silence=150.0)
    bus = CanBus(RUN, mapping, source)
    killer = threading.Timer(200, bus.close)
    killer.start()
    sender = subprocess.Popen([sys.executable, __file__, "send"])
    monitor, items = Monitor(RUN), []
    for item in bus.frames():
        items.append(item)
        monitor.take(item)
        if sum(isinstance(i, Frame) for i in items) == len(FRAMES) - 1:
            bus.close()
    killer.cancel()
    assert sender.wait(30) == 0
    lost = (LOST - 1) // (256 // 4)
    expected = [quantised(frame, mapping) for index, frame in enumerate(FRAMES) if index != lost]
    got = [item for item in items if isinstance(item, Frame)]
    assert len(got) == len(expected), [i for i in items if isinstance(i, Fault)]
    for one, other in zip(got, expected, strict=True):
        assert (one.realisation, one.experiment, one.period) == (other.realisation, other.experiment, other.period)
        np.testing.assert_array_equal(one.u, other.u)
        np.testing.assert_array_equal(one.y, other.y)
    faults = [item for item in items if isinstance(item, Fault)]
    assert sorted(f.kind for f in faults) == [FaultKind.BUS_ERROR, FaultKind.LOST], faults
    assert monitor.counts.realisations == 3
    absent = source.model_copy(update={"channel": "can97"})
    with pytest.raises(
        ConfigurationError, match=r"rigs\[0\]\.source\.channel: 'can97' of socketcan cannot be opened: "
    ):
        CanBus(RUN, mapping, absent, "creak.toml", "rigs[0].source")
    print("all periods but the lost one are the same")  # noqa: T201


if __name__ == "__main__":
    send() if sys.argv[1:] == ["send"] else receive()
