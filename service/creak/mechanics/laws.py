"""Scalar force laws, compiled: the one place where each law is written.

A law takes the relative displacement ``d`` and velocity ``v`` of an element at the end of a step and the
displacement ``d0`` and memory ``z0`` at its beginning. It returns force, both slopes, and the new memory.
Laws without memory ignore ``d0`` and hand ``z0`` on.
"""

import math
from typing import Final

import numpy as np

from creak.compiling import compiled
from creak.records import Real

CUBIC: Final = 0
QUADRATIC: Final = 1
CLEARANCE: Final = 2
STOP: Final = 3
COULOMB: Final = 4
QUADRATIC_DAMPING: Final = 5
HYSTERESIS: Final = 6

OF_VELOCITY: Final = frozenset({COULOMB, QUADRATIC_DAMPING})
"""Laws that ask for the velocity."""


@compiled
def bouc_wen(path: float, z0: float, bound: float) -> float:
    """Carry the memory of a Bouc-Wen element along a straight piece of path.

    The relation ``dz/ds = 1 - (1 + sign(ds z))/2 (z/bound)^2`` has a closed solution: away from its bound the
    memory follows the path one to one until it crosses zero, then it approaches the other bound as a tanh.
    So a step is exact however long it is.

    Parameters
    ----------
    path : float
        Signed length of the piece.
    z0 : float
        Memory at its beginning, ``|z0| < bound``.
    bound : float
        Yield displacement (or input), positive.

    Returns
    -------
    float
        Memory at its end.
    """
    side = 1.0 if path > 0.0 else -1.0
    start = side * z0
    way = abs(path)
    if start < 0.0:
        if way <= -start:
            return z0 + path
        way += start
        start = 0.0
    t = math.tanh(way / bound)
    return side * (start + bound * t) / (1.0 + start * t / bound)


@compiled
def force(
    code: int, p: float, q: float, d: float, v: float, d0: float, z0: float
) -> tuple[float, float, float, float]:
    """Force of one element at the end of a step.

    Parameters
    ----------
    code : int
        One of the constants of this module.
    p, q : float
        The law's two parameters, in the order of the effect's fields; q is unused where there is but one.
    d, v : float
        Relative displacement and velocity at the end of the step.
    d0, z0 : float
        Displacement and memory at its beginning.

    Returns
    -------
    force, slope_d, slope_v, z : float
        Force, its derivatives to d and v, and the memory at the end of the step.
    """
    if code == CUBIC:
        return p * d * d * d, 3.0 * p * d * d, 0.0, z0
    if code == QUADRATIC:
        return p * d * d, 2.0 * p * d, 0.0, z0
    if code == CLEARANCE:
        if d > q:
            return p * (d - q), p, 0.0, z0
        if d < -q:
            return p * (d + q), p, 0.0, z0
        return 0.0, 0.0, 0.0, z0
    if code == STOP:
        if d > q:
            return p * (d - q), p, 0.0, z0
        return 0.0, 0.0, 0.0, z0
    if code == COULOMB:
        t = math.tanh(v / q)
        return p * t, 0.0, p / q * (1.0 - t * t), z0
    if code == QUADRATIC_DAMPING:
        return p * v * abs(v), 0.0, 2.0 * p * abs(v), z0
    z = bouc_wen(d - d0, z0, q)
    loading = z * (d - d0) > 0.0
    return p * z, p * (1.0 - (z / q) ** 2 if loading else 1.0), 0.0, z


@compiled
def force_along(code: int, p: float, q: float, d: Real, v: Real, z: float, out: Real) -> float:
    """Fill the forces along one period of samples that begins with memory z; return the memory at its end."""
    d0 = d[-1]
    for i in range(d.size):
        out[i], _, _, z = force(code, p, q, d[i], v[i], d0, z)
        d0 = d[i]
    return z


@compiled
def force_over_period(code: int, p: float, q: float, d: Real, v: Real) -> Real:
    """Force along rows of samples, each one period of a periodic motion.

    The memory at the end of a period rises with that at its beginning, but by less, so there is exactly one
    with which the period repeats itself: it is bracketed and found by the Illinois rule. Waiting for it
    would take thousands of periods where the loops are small.

    Parameters
    ----------
    code, p, q : int, float, float
        As for `force`.
    d, v : array, (rows, N)

    Returns
    -------
    array, (rows, N)
    """
    out = np.empty_like(d)
    for row in range(d.shape[0]):
        if code != HYSTERESIS:
            force_along(code, p, q, d[row], v[row], 0.0, out[row])
            continue
        low, high = -q, q
        rest_low = force_along(code, p, q, d[row], v[row], low, out[row]) - low
        rest_high = force_along(code, p, q, d[row], v[row], high, out[row]) - high
        side = 0
        for _ in range(200):
            z = 0.0 if rest_low == rest_high else (low * rest_high - high * rest_low) / (rest_high - rest_low)
            rest = force_along(code, p, q, d[row], v[row], z, out[row]) - z
            if abs(rest) <= 1e-14 * q or high - low <= 1e-14 * q:
                break
            if rest > 0.0:
                low, rest_low = z, rest
                if side == 1:
                    rest_high *= 0.5
                side = 1
            else:
                high, rest_high = z, rest
                if side == -1:
                    rest_low *= 0.5
                side = -1
    return out


@compiled
def play(u: Real, u0: float, z0: float, bound: float) -> tuple[Real, float]:
    """Memory of a Bouc-Wen element along samples.

    Parameters
    ----------
    u : array, (N,)
        Path, straight between samples.
    u0, z0 : float
        Path and memory before the first sample.
    bound : float

    Returns
    -------
    array, (N,)
        Memory at the samples.
    float
        Memory at the last of them.
    """
    out = np.empty_like(u)
    z = z0
    before = u0
    for i in range(u.size):
        z = bouc_wen(u[i] - before, z, bound)
        before = u[i]
        out[i] = z
    return out, z
