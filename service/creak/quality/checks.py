"""Flaws of one signal or of one realisation's spectra: pure functions, each with its rule in its docstring."""

from dataclasses import dataclass

import numpy as np

from creak.compiling import part, reducing
from creak.quality.spectra import coherent_power, early_differences, noise_gains, period_changes
from creak.records import Complex, Real


@dataclass(frozen=True)
class Drift:
    """Period that fits the data better than the rig's.

    Parameters
    ----------
    period_samples : float
    share : float
        Part of the change from period to period that a shift explains.
    """

    period_samples: float
    share: float

    def described(self, believed: int) -> str:
        """Words for a message; a period is named whole if it nearly is, as leakage biases the fit a little."""
        whole = round(self.period_samples)
        near = whole != believed and abs(self.period_samples - whole) < 0.05
        period = str(whole) if near else f"{self.period_samples:.7g}"
        return f"the period is {period} samples, not {believed}"


@dataclass(frozen=True)
class Clipping:
    """Samples that pile up at a limit: their share of all, and the limit."""

    share: float
    limit: float


def transient_share(kept: Complex, node: int, discarded: Complex | None = None) -> float | None:
    """Power of what has not died out in the second of the given periods, as a share of the response's.

    Takes the differences ``D0`` of the first and ``D1`` of the second period from the mean of those that follow.
    Noise makes the two independent; a transient makes ``D1 = z D0`` with the same ``z`` in neighbouring lines and
    in all experiments, so their coherence over 15 values or more is near 1.

    Rule: a transient is found where the chance of so high a coherence, over all lines, is below 1e-9, and what
    is coherent there amounts to more than 1e-8 of the response (-80 dB).

    Parameters
    ----------
    kept : array, (q, P, F, channels)
        Spectra of the kept periods.
    node : int
        Which channel's.
    discarded : array, (q, F), or None
        That channel's in the last discarded period, the first of the given ones if it is known. Three in all.

    Returns
    -------
    float or None
    """
    q, _, F = kept.shape[:3]
    width = min(F, 2 * (int(np.ceil(15 / q)) // 2) + 1)
    if width * q < 12:  # too few lines for a coherence to mean anything
        return None
    first, second, cross = np.empty(F), np.empty(F), np.empty(F, dtype=np.complex128)
    before = np.zeros((0, 0), dtype=np.complex128) if discarded is None else np.ascontiguousarray(discarded)
    response = early_differences(_lines_last(kept), node, before, first, second, cross)
    found = coherent_power(first, second, cross, width, q, float(np.log(1e-9 / F)))
    share = found / response if response > 0 else 0.0
    return share if share > 1e-8 else None


def period_drift(spectra: Complex, lines: tuple[int, ...], period_samples: int) -> Drift | None:
    """Period that fits better, where successive periods are shifted copies of each other.

    Rule: a drift is found where one shift of at least 0.001 samples a period, common to all channels and lines,
    explains more than half of the power of the change from period to period.

    Parameters
    ----------
    spectra : array, (q, P, F, channels)
        Periods in their order.
    lines : tuple of int
    period_samples : int
        N, as it is believed to be.

    Returns
    -------
    Drift or None
    """
    if spectra.shape[1] < 2:
        return None
    F, channels = spectra.shape[2:]
    powers, changes, crosses = np.empty(channels), np.empty(channels), np.empty((channels, F), dtype=np.complex128)
    period_changes(_lines_last(spectra), powers, changes, crosses)
    weight = np.divide(1.0, powers, out=np.zeros_like(powers), where=powers > 0)
    cross = (weight[:, None] * crosses).sum(axis=0)
    moved = float((weight * changes).sum())
    turned = 2 * float((np.abs(cross) - cross.real).sum())  # what a turn of its own at every line would explain
    if moved <= 0 or turned <= 0.5 * moved:
        return None
    at = np.asarray(lines)
    fine = 8
    padded = np.zeros(fine * period_samples // 2 + 1, dtype=np.complex128)
    padded[at] = cross
    fit = np.fft.irfft(padded, n=fine * period_samples)  # at shifts of 0, -1/8, -2/8 ... samples, modulo a period
    near = np.arange(-fine * period_samples // 20, fine * period_samples // 20 + 1)
    good = near[fit[-near] >= 0.999 * fit[-near].max()]
    shift = float(good[np.argmin(np.abs(good))]) / fine  # the smallest of those that a sparse grid cannot tell
    turn = 2 * np.pi * at / period_samples
    for _ in range(20):  # Newton on the slope of Re sum cross exp(-j turn shift)
        rotated = cross * np.exp(-1j * turn * shift)
        slope, bend = float((turn * rotated.imag).sum()), float((turn**2 * rotated.real).sum())
        if bend <= 0:
            break
        shift += float(np.clip(slope / bend, -0.5 / fine, 0.5 / fine))
    before, after = spectra[:, :-1], spectra[:, 1:]
    rest = float(_power(after - np.exp(1j * turn * shift)[:, None] * before).sum(axis=(0, 1, 2)) @ weight)
    share = 1 - rest / moved
    if abs(shift) < 1e-3 or share <= 0.5:
        return None
    return Drift(period_samples - shift, share)


@part
def _range(x: Real) -> tuple[float, float]:
    """Smallest and largest sample; in lanes, since the compiler does not split such a search by itself."""
    lanes = 64
    low, high = np.full(lanes, x[0]), np.full(lanes, x[0])
    whole = x.size - x.size % lanes
    for first in range(0, whole, lanes):
        for t in range(lanes):
            value = x[first + t]
            low[t] = value if value < low[t] else low[t]
            high[t] = value if value > high[t] else high[t]
    for i in range(whole, x.size):
        low[0], high[0] = min(low[0], x[i]), max(high[0], x[i])
    return low.min(), high.max()


@part
def _piled_up(x: Real, low: float, high: float, strip: float) -> int:
    """How many samples lie in a strip at the larger or at the smaller end, whichever holds more."""
    above, below = 0, 0
    for i in range(x.size):
        above += high - x[i] < strip
        below += x[i] - low < strip
    return max(above, below)


@reducing
def unremarkable(x: Real) -> bool:
    """Tell in a few passes that a signal is neither clipped nor held, as nearly all are.

    Parameters
    ----------
    x : array, (N,)

    Returns
    -------
    bool
        True only if `clipping` finds nothing and `longest_hold` is 1.
    """
    equal = 0
    for i in range(1, x.size):
        equal += x[i] == x[i - 1]
    if equal > 0:
        return False
    low, high = _range(x)
    few = max(16.0, 0.005 * x.size)
    # A little more than the strip of `clipping`, for rounding; and no signal's RMS is above half its range.
    if _piled_up(x, low, high, 0.0011 * (high - low) / 2) < few:
        return True
    total, power = 0.0, 0.0
    for i in range(x.size):
        total += x[i]
    mean = total / x.size
    for i in range(x.size):
        power += (x[i] - mean) ** 2
    return _piled_up(x, low, high, 0.0011 * np.sqrt(power / x.size)) < few


def _power(values: Complex) -> Real:
    return np.asarray(values.real**2 + values.imag**2)


def _lines_last(spectra: Complex) -> Complex:
    """``(q, P, F, channels)`` as the loops take them, ``(q, P, channels, F)``."""
    return np.ascontiguousarray(spectra.swapaxes(2, 3))


def clipping(x: Real) -> Clipping | None:
    """Samples that pile up at the largest or the smallest value of a signal.

    Rule: in an outermost strip of 0.001 RMS values lie at least 16 samples and 0.5 % of all, and four times as
    many as in the strip next to it (a smooth peak has 2.4 times as many, and few in so thin a strip); of a
    quantised signal the outermost levels are compared instead. A signal that spends 40 % of its time there is
    meant to have two levels. Noise that comes after the limit hides it: a converter clips what it samples, its
    noise included.

    Parameters
    ----------
    x : array, (N,)

    Returns
    -------
    Clipping or None
    """
    rms = float(x.std())
    if rms <= 0:
        return None
    worst: Clipping | None = None
    for sign in (1.0, -1.0):
        depth = float((sign * x).max()) - sign * x  # below the largest value
        outer = np.sort(depth[depth < 0.8 * rms])
        there, both = (int(count) for count in np.searchsorted(outer, (0.001 * rms, 0.002 * rms)))
        if there < max(16, 0.005 * x.size) or there <= 4 * (both - there) or there > 0.4 * x.size:
            continue
        share = _piled(outer, there) / x.size
        if share and (worst is None or share > worst.share):
            worst = Clipping(share, float(sign * (sign * x).max()))
    return worst


def _piled(outer: Real, there: int) -> int:
    """How many samples lie at the limit; 0 if they are but the top level of a quantised signal.

    Parameters
    ----------
    outer : array
        Distances of the outermost samples from the largest one, rising.
    there : int
        How many of them are in the strip that is suspected.
    """
    levels, counts = np.unique(outer, return_counts=True)
    if counts[0] == 1:  # a continuous signal
        return there
    if len(levels) == 1 or counts[0] <= 4 * counts[1]:
        return 0
    return int(counts[0])


def longest_hold(x: Real) -> int:
    """Longest run of samples that do not change, ``(N,)``; 1 if every sample differs from the one before."""
    changes = np.flatnonzero(x[1:] != x[:-1])
    edges = np.concatenate(([-1], changes, [x.size - 1]))
    return int(np.diff(edges).max())


@dataclass(frozen=True)
class InputMatch:
    """How a measured input resembles the one that was to be played.

    Parameters
    ----------
    correlation : float
        At the delay where it is largest; 1 for the same but for gain and delay.
    gain : float
        RMS value over the one that was to be.
    """

    correlation: float
    gain: float

    @property
    def right(self) -> bool:
        """Rule: correlation of at least 0.9, and an RMS value within 10 %."""
        return self.correlation >= 0.9 and abs(self.gain - 1) <= 0.1


def match_input(U: Complex, planned: Complex, lines: tuple[int, ...], period_samples: int) -> InputMatch:
    """Compare a measured input with the planned one, both as spectra ``(F,)`` at the excited lines."""
    have, want = float(np.linalg.norm(U)), float(np.linalg.norm(planned))
    if have == 0 or want == 0:
        return InputMatch(0.0, have / want if want else np.inf)
    cross = np.zeros(period_samples // 2 + 1, dtype=np.complex128)
    cross[list(lines)] = U * planned.conj()
    peak = float(np.fft.irfft(cross, n=period_samples).max()) * period_samples / 2
    return InputMatch(min(1.0, peak / (have * want)), have / want)


def _plainly_right(U: Complex, planned: Complex) -> bool:
    """Tell without a search for the delay that an input ``(F,)`` is right: with the best one it matches better."""
    have, want = float(np.vdot(U, U).real), float(np.vdot(planned, planned).real)
    if have == 0 or want == 0:
        return False
    return InputMatch(float(np.vdot(planned, U).real) / np.sqrt(have * want), np.sqrt(have / want)).right


def orthogonality_loss_db(U: Complex) -> float:
    """How much more noise the response matrix has than with orthogonal experiments of the same power, dB.

    Median over the lines of the mean diagonal of ``(U U^H / q)^-1``, the rows of ``U`` scaled to unit power.

    Parameters
    ----------
    U : array, (F, q, q)
        Line, input, experiment; not singular.
    """
    gains = np.empty(len(U))
    noise_gains(np.ascontiguousarray(U.transpose(2, 1, 0)), gains)
    return float(10 * np.log10(np.median(gains)))


def wrong_inputs(
    U: Complex, planned: Complex, lines: tuple[int, ...], period_samples: int, names: tuple[str, ...]
) -> str | None:
    """Say which inputs of a realisation are not the planned ones.

    Parameters
    ----------
    U, planned : array, (q, q, F)
        Experiment, input, line.
    lines : tuple of int
    period_samples : int
    names : tuple of str
        Of the inputs.

    Returns
    -------
    str or None
        The first wrong one, what it is instead, and how many more there are.
    """
    q = len(U)
    places = [(c, i) for c in range(q) for i in range(q)]
    doubtful = [place for place in places if not _plainly_right(U[place], planned[place])]
    matches = {place: match_input(U[place], planned[place], lines, period_samples) for place in doubtful}
    wrong = [place for place in doubtful if not matches[place].right]
    if not wrong:
        return None
    c, i = wrong[0]
    text = f"{names[i]} in experiment {c} is not what the excitation says: "
    if matches[c, i].correlation >= 0.9:
        text += f"its rms is {matches[c, i].gain:.3g} times the planned one"
    else:
        text += f"correlation {matches[c, i].correlation:.2f}"
        for d, j in places:
            if match_input(U[c, i], planned[d, j], lines, period_samples).correlation >= 0.99:
                text += f"; it is that of {names[j]} in experiment {d}"
                break
    return text + (f", and {len(wrong) - 1} more like it" if len(wrong) > 1 else "")
