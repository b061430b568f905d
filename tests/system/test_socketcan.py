"""Sender and service over the kernel's real SocketCAN: this machine's kernel, or one in a virtual machine."""

import os
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import canvm
import pytest

ROOT = Path(__file__).parents[2]
GUEST = ROOT / "tests" / "system" / "socketcan_guest.py"
TESTS = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--timeout=250"]
TESTS += ["tests/system/test_can.py", "-k", "two_processes"]


def has_vcan():
    """Whether this kernel has SocketCAN, and a vcan0 that is up."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as probe:
            probe.bind(("vcan0",))
    except (OSError, AttributeError):
        return False
    return True


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_sender_and_service_over_the_kernels_socketcan():
    """Kills what only a real CAN socket refuses: a classic frame sent as FD, a payload of odd length, a filter."""
    if has_vcan():
        own = {**os.environ, "CREAK_TEST_BUS": "vcan0"}
        done = subprocess.run(TESTS, cwd=ROOT, env=own, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout[-4000:]
        return
    lacking = canvm.missing()
    if lacking:
        message = f"no SocketCAN in this kernel, and no virtual machine without the Debian packages: {lacking}"
        if os.environ.get("CREAK_REQUIRE_SOCKETCAN"):  # set by .ci/run, which installs them
            pytest.fail(message)
        pytest.skip(message)
    cache = Path(os.environ.get("CREAK_CANVM", tempfile.gettempdir())) / "creak-canvm"
    environment = {"PYTHONPATH": os.environ.get("PYTHONPATH", str(ROOT / "service"))}
    # An emulated processor takes minutes to compile the monitor's loops, so they are compiled here, for any one.
    environment |= {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(cache / "compiled")}
    compiling = [sys.executable, "-c", "from creak.preparation import prepare; prepare()"]
    subprocess.run(compiling, env=os.environ | environment, check=True)
    before = os.getcwd()
    os.chdir(ROOT)
    try:
        status, output = canvm.run([sys.executable, str(GUEST)], cache, **environment)
    finally:
        os.chdir(before)
    assert status == 0, output[-4000:]
    assert "all periods but the lost one are the same" in output
