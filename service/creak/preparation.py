"""What a monitor needs of its process first: compiled loops, so that no rig in operation waits, and memory."""

from functools import cache

import numpy as np

from creak.location.evidence import along, place_powers, take_out
from creak.monitor import Monitor
from creak.records import Excitation, Frame, Node, Rig, Run


@cache
def prepare(*, edges: bool = False) -> None:
    """Let a monitor judge a small made-up rig, so that all of its loops are compiled, or read from the cache.

    The first time on a machine that takes fifteen seconds or more, later a fraction of one; a second call nothing.

    Parameters
    ----------
    edges : bool
        Whether the rig's network is given; a dense one takes other loops.
    """
    _keep_memory()
    network = (("1", "2"),) if edges else None
    rig = Rig("none", 1.0, 32, 1, tuple(range(1, 16, 2)), (_node("1"), _node("2")), network=network)
    run = Run("none", rig, 2, 0, Excitation("measured"), "simulated", window=1)
    monitor = Monitor(run)
    rng = np.random.default_rng(0)
    for m in range(3):
        for c in range(rig.q):
            for p in range(run.periods):
                monitor.take(Frame(m, c, p, 0, rng.standard_normal((2, 32)), rng.standard_normal((2, 32))))
    one = np.ones((1, 1, 1), dtype=np.complex128)  # only what distorts is located
    take_out(one, one.copy(), 0, 1)
    place_powers(one, np.empty((1, 1)))
    along(one, ((0, 1),))


def _keep_memory() -> None:
    """Let the C library keep the memory of arrays that are given up for those that follow.

    glibc hands it back to the system, which zeroes it anew for the next array, until an array as large as the
    largest that its threshold can grow to, 32 MiB, has been given up (``mallopt(3)``, ``M_MMAP_THRESHOLD``). Other
    libraries take no notice.
    """
    np.empty(2**25 - 2**16, dtype=np.uint8)


def _node(name: str) -> Node:
    return Node(name, "m", "N")
