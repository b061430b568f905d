"""Change of a law's force along a period when the motion changes a little, compiled; memory included."""

import math

import numpy as np

from creak.compiling import compiled
from creak.mechanics import laws
from creak.records import Real


@compiled
def bouc_wen_slopes(path: float, z0: float, bound: float) -> tuple[float, float]:
    """Derivatives of `laws.bouc_wen` to the path and to the memory at its beginning."""
    side = 1.0 if path > 0.0 else -1.0
    start = side * z0
    way = abs(path)
    if start < 0.0:
        if way <= -start:
            return 1.0, 1.0
        t = math.tanh((way + start) / bound)
        return 1.0 - t * t, 1.0 - t * t
    t = math.tanh(way / bound)
    by_start = (1.0 - t * t) / (1.0 + start * t / bound) ** 2
    return by_start * (1.0 - (start / bound) ** 2), by_start


@compiled
def force_change(code: int, p: float, q: float, d: Real, v: Real, f: Real, dd: Real, dv: Real) -> Real:
    """First-order change of the periodic force of `laws.force_over_period`.

    Parameters
    ----------
    code, p, q : int, float, float
        As for `laws.force`.
    d, v, f : array, (N,)
        One period of motion and the force along it.
    dd, dv : array, (N,)
        Change of the motion.

    Returns
    -------
    array, (N,)
        Change of the force. That of a hysteresis is periodic as its memory is: the changes of the memory
        along a period form a linear recursion, whose beginning is chosen so that it closes.
    """
    size = d.size
    out = np.empty(size)
    if code != laws.HYSTERESIS:
        for i in range(size):
            _, by_d, by_v, _ = laws.force(code, p, q, d[i], v[i], 0.0, 0.0)
            out[i] = by_d * dd[i] + by_v * dv[i]
        return out
    begin = 0.0
    for turn in range(2):
        change = begin
        kept = 1.0
        for i in range(size):
            by_path, by_memory = bouc_wen_slopes(d[i] - d[i - 1], f[i - 1] / p, q)
            change = by_memory * change + by_path * (dd[i] - dd[i - 1])
            kept *= by_memory
            out[i] = p * change
        if turn == 0:
            # A loop so small that the memory only follows the path has no beginning of its own.
            begin = change / (1.0 - kept) if kept < 1.0 - 1e-12 else 0.0
    return out
