"""A response matrix as it was measured, and how it goes on between the measured lines and beyond them."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.interpolate import CubicSpline

from creak.records import Complex, Real, Rig

_ORDER: Final = {"m/s": 1, "m/s^2": 2, "rad/s": 1, "rad/s^2": 2}
"""Units that are derivatives; every other one counts as a displacement."""

_EDGE: Final = 8  # share of the lines, as a divisor, that tell how the response goes on beyond the band
_FEWEST: Final = 6  # lines for the same
_FITS: Final = 0.1  # relative error up to which they go on as mass, damping and stiffness


@dataclass(frozen=True, eq=False)
class Response:
    """Response matrix of a structure at the lines at which it was measured.

    Parameters
    ----------
    rig : Rig
        That measured it.
    S : array, (F, n, q)
        At the rig's lines, in units of output per unit of input; the hold is in it, as it was measured.
    variance : array, (N//2 + 1, n)
        Of an experiment's mean about ``S U``: noise and the distortion that the structure has of itself.
    distortion : array, (N//2 + 1, n)
        The distortion alone.
    leverage : array, (F, q, q)
        ``(sum U U^H)^-1``: the covariance of a row i of S is this times ``variance[:, i]``.
    """

    rig: Rig
    S: Complex
    variance: Real
    distortion: Real
    leverage: Complex


def derivatives(rig: Rig) -> tuple[int, ...]:
    """How often the coordinate of every node is differentiated for its output, ``(n,)``."""
    return tuple(_ORDER.get(node.output, 0) for node in rig.nodes)


@dataclass(frozen=True, eq=False)
class Continued:
    """Matrix function of frequency known at some lines: interpolated between them, continued beyond them.

    Beyond the band the dynamic stiffness between the driven nodes goes on as ``K + s C + s^2 M`` where the
    outermost lines are of that form; if not, the response stays what it is below, and falls as a mass does above.

    Parameters
    ----------
    rig : Rig
    frequencies : array, (F,)
        Hz, rising.
    values : array, (F, n, q)
        Displacements per unit of input.
    """

    rig: Rig
    frequencies: Real
    values: Complex

    def at(self, frequencies: Real) -> Complex:
        """Values at any frequencies ``(L,)``, as ``(L, n, q)``."""
        wanted = np.asarray(frequencies, dtype=np.float64)
        out = np.empty((len(wanted), *self.values.shape[1:]), dtype=np.complex128)
        low, high = self.frequencies[0], self.frequencies[-1]
        near = 1e-9 * high
        inside = (wanted >= low - near) & (wanted <= high + near)
        if len(self.frequencies) > 1:
            out[inside] = CubicSpline(self.frequencies, self.values, axis=0)(np.clip(wanted[inside], low, high))
        else:
            out[inside] = self.values
        for beyond, below in ((wanted < low - near, True), (wanted > high + near, False)):
            if beyond.any():
                out[beyond] = self._beyond(wanted[beyond], below=below)
        return out

    def _beyond(self, wanted: Real, *, below: bool) -> Complex:
        count = min(max(_FEWEST, len(self.frequencies) // _EDGE), len(self.frequencies))
        at = slice(None, count) if below else slice(-count, None)
        known, values = 2j * np.pi * self.frequencies[at], self.values[at]
        s = 2j * np.pi * wanted
        driven = list(self.rig.driven)
        edge = values[0] if below else values[-1]
        stiffness = np.linalg.inv(values[:, driven])
        through = values @ stiffness  # motion of all nodes per motion of the driven ones
        terms: Complex = np.asarray(np.stack([np.ones(count), known, known**2], axis=-1), dtype=np.complex128)
        entries = np.asarray(stiffness.reshape(count, -1), dtype=np.complex128)
        fitted = _real_fit(terms, entries)
        off = np.linalg.norm(terms @ fitted - entries) / np.linalg.norm(entries)
        if count >= _FEWEST and off < _FITS:
            size = len(driven)
            dynamic = (np.stack([np.ones(len(s)), s, s**2], axis=-1) @ fitted).reshape(-1, size, size)
            carried = through[0] if below else through[-1]
            return np.asarray(carried.real @ np.linalg.inv(dynamic))
        if below:
            return np.broadcast_to(edge.real, (len(s), *edge.shape)).astype(np.complex128)
        return np.asarray(edge * (known[-1] / s)[:, None, None] ** 2)


def _real_fit(terms: Complex, values: Complex) -> Real:
    """Real coefficients of least squares."""
    left, right = np.concatenate([terms.real, terms.imag]), np.concatenate([values.real, values.imag])
    scale = np.linalg.norm(left, axis=0)
    scale[scale == 0] = 1.0
    return np.asarray(np.linalg.lstsq(left / scale, right, rcond=None)[0] / scale[:, None])


def held(rig: Rig) -> Complex:
    """What the hold does to the rig's lines of an input, ``(F,)``."""
    half = np.pi * np.asarray(rig.lines) / rig.period_samples
    if rig.hold == "band-limited":
        return np.ones(half.shape, dtype=np.complex128)
    return np.asarray(np.exp(-1j * half) * np.sinc(half / np.pi))
