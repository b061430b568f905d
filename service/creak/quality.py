"""Data quality before statistics: what is wrong with frames that are whole and finite.

Each check is a pure function that says what it found and how large it is, with its rule in its docstring;
:class:`Watch` collects what they need from the frames of a realisation and turns the findings into faults. A
finding flags the data; it does not keep them out of the sums, since only a person can say whether levels with a
known flaw are better than none.
"""

from dataclasses import dataclass

import numpy as np

from creak.multisine import realisation as multisine
from creak.realisations import Realisation, spectrum
from creak.records import Complex, Fault, FaultKind, Frame, FrameStatus, Real, Run

FLAWS = frozenset(
    {
        FaultKind.TRANSIENT,
        FaultKind.DRIFT,
        FaultKind.CLIPPED,
        FaultKind.STUCK,
        FaultKind.WRONG_INPUT,
        FaultKind.NOT_ORTHOGONAL,
    }
)
"""Kinds of faults that flag data which enter the sums all the same."""


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


def transient_share(periods: Complex) -> float | None:
    """Power of what has not died out in the second of the given periods, as a share of the response's.

    Takes the differences ``D0`` of the first and ``D1`` of the second period from the mean of those that follow.
    Noise makes the two independent; a transient makes ``D1 = z D0`` with the same ``z`` in neighbouring lines and
    in all experiments, so their coherence over 15 values or more is near 1.

    Rule: a transient is found where the chance of so high a coherence, over all lines, is below 1e-9, and what
    is coherent there amounts to more than 1e-8 of the response (-80 dB).

    Parameters
    ----------
    periods : array, (q, P, F)
        One response: spectra of the last discarded period, then of the kept ones; or of kept ones alone. P >= 3.

    Returns
    -------
    float or None
    """
    q, _, F = periods.shape
    first = periods[:, 0] - periods[:, 1:].mean(axis=1)
    second = periods[:, 1] - periods[:, 2:].mean(axis=1)
    width = min(F, 2 * (int(np.ceil(15 / q)) // 2) + 1)
    if width * q < 12:  # too few lines for a coherence to mean anything
        return None

    def gathered(values: Real | Complex) -> Real | Complex:
        return np.convolve(values.sum(axis=0), np.ones(width), mode="same")

    cross = np.abs(gathered(second * first.conj())) ** 2
    powers = np.asarray(gathered(np.abs(first) ** 2) * gathered(np.abs(second) ** 2), dtype=np.float64)
    coherence = np.divide(cross, powers, out=np.zeros(F), where=powers > 0)
    values = q * np.convolve(np.ones(F), np.ones(width), mode="same")  # fewer at the ends of the band
    found = (values - 1) * np.log1p(-np.minimum(coherence, 1 - 1e-15)) < np.log(1e-9 / F)
    response = (np.abs(periods[:, -1]) ** 2).sum()
    share = float(((np.abs(second) ** 2).sum(axis=0) * coherence)[found].sum() / response) if response > 0 else 0.0
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
    power = (np.abs(spectra) ** 2).sum(axis=(0, 1, 2))
    scaled = spectra[..., power > 0] / np.sqrt(power[power > 0])
    before, after = scaled[:, :-1], scaled[:, 1:]
    cross = (after * before.conj()).sum(axis=(0, 1, 3))
    moved = float((np.abs(after - before) ** 2).sum())
    if moved <= 0:
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
    rest = float((np.abs(after - np.exp(1j * turn * shift)[:, None] * before) ** 2).sum())
    share = 1 - rest / moved
    if abs(shift) < 1e-3 or share <= 0.5:
        return None
    return Drift(period_samples - shift, share)


def clipping(x: Real) -> Clipping | None:
    """Samples that pile up at the largest or the smallest value of a signal.

    Rule: in an outermost strip of 0.05, 0.1 or 0.2 RMS values lie at least 16 samples, and four times as many as
    in the strip next to it (a smooth peak has 2.4 times as many, at any width); of a coarsely quantised signal
    the outermost levels are compared instead. A signal that spends 40 % of its time there is meant to have two
    levels. The widths allow for noise after the limit of up to some -30 dB.

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
        for width in (0.05 * rms, 0.1 * rms, 0.2 * rms):
            there, both = (int(count) for count in np.searchsorted(outer, (width, 2 * width)))
            if there < 16 or there <= 4 * (both - there) or there > 0.4 * x.size:
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
    if counts[0] == 1 or len(levels) > there / 4:  # a continuous signal, with noise or without
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


def orthogonality_loss_db(U: Complex) -> float:
    """How much more noise the response matrix has than with orthogonal experiments of the same power, dB.

    Median over the lines of the mean diagonal of ``(U U^H / q)^-1``, the rows of ``U`` scaled to unit power.

    Parameters
    ----------
    U : array, (F, q, q)
        Line, input, experiment; not singular.
    """
    q = U.shape[1]
    scaled = U / np.sqrt((np.abs(U) ** 2).mean(axis=2, keepdims=True))
    inverse = np.linalg.inv(scaled @ scaled.conj().swapaxes(1, 2) / q)
    return float(10 * np.log10(np.median(np.einsum("fii->fi", inverse).real.mean(axis=1))))


class Watch:
    """Gathers from the frames of a realisation what its checks need; memory does not grow with frames.

    Parameters
    ----------
    run : Run
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        rig = run.rig
        driven = [f"input {rig.nodes[i].name}" for i in rig.driven]
        self._channels = (*driven, *(f"response {node.name}" for node in rig.nodes))
        self._index = -1
        self._begin(-1)

    def _begin(self, index: int) -> None:
        self._index = index
        self._discarded: dict[int, Complex] = {}
        self._clipped: dict[int, list[Clipping]] = {}
        self._held: dict[int, int] = {}

    def take(self, frame: Frame) -> None:
        """Look at a frame as the collector judged it; refused ones are passed over."""
        if frame.status is FrameStatus.REJECTED:
            return
        rig = self._run.rig
        if frame.realisation != self._index:
            self._begin(frame.realisation)
        if (frame.u.shape, frame.y.shape) != ((rig.q, rig.period_samples), (rig.n, rig.period_samples)):
            return
        if frame.status is FrameStatus.TRANSIENT:
            if frame.period == rig.transient_periods - 1 and np.isfinite(frame.y).all():
                self._discarded[frame.experiment] = spectrum(rig, frame.u, frame.y)[:, rig.q :]
            return
        for channel, x in enumerate((*frame.u, *frame.y)):
            hold = longest_hold(x)
            found = clipping(x)
            if found is not None:
                self._clipped.setdefault(channel, []).append(found)
            elif hold > rig.period_samples / 8 and (channel >= rig.q or x.any()):
                # An input may be at rest in an experiment that drives the others.
                self._held[channel] = max(hold, self._held.get(channel, 0))

    def judge(self, realisation: Realisation) -> tuple[Fault, ...]:
        """Give the findings about a complete realisation, whose frames were all taken."""
        if realisation.index != self._index:
            self._begin(realisation.index)
        findings = [
            *self._pinned(),
            *self._wrong_inputs(realisation),
            *self._not_orthogonal(realisation),
            *self._not_periodic(realisation),
        ]
        self._begin(-1)
        return tuple(
            Fault(kind, realisation.end, f"realisation {realisation.index}: {text}", realisation.index)
            for kind, text in findings
        )

    def _pinned(self) -> list[tuple[FaultKind, str]]:
        findings = []
        frames = self._run.rig.q * self._run.steady_periods
        for channel, found in sorted(self._clipped.items()):
            worst = max(found, key=lambda one: one.share)
            findings.append(
                (
                    FaultKind.CLIPPED,
                    f"{self._channels[channel]} is clipped at {worst.limit:.4g} in {len(found)} of {frames} "
                    f"periods, up to {100 * worst.share:.2g} % of the samples",
                )
            )
        for channel, hold in sorted(self._held.items()):
            findings.append(
                (FaultKind.STUCK, f"{self._channels[channel]} does not change for {hold} samples of a period")
            )
        return findings

    def _wrong_inputs(self, realisation: Realisation) -> list[tuple[FaultKind, str]]:
        run, rig = self._run, self._run.rig
        plan = run.excitation
        if plan.kind != "multisine" or plan.rms is None or plan.seed is None:
            return []
        planned = np.fft.rfft(multisine(rig, plan.rms, plan.seed, realisation.index))[..., list(rig.lines)]
        planned /= rig.period_samples
        U = realisation.spectra[..., : rig.q].mean(axis=1).swapaxes(1, 2)  # (experiment, input, F)
        wrong = wrong_inputs(U, planned, rig.lines, rig.period_samples, self._channels)
        return [(FaultKind.WRONG_INPUT, wrong)] if wrong else []

    def _not_orthogonal(self, realisation: Realisation) -> list[tuple[FaultKind, str]]:
        q = self._run.rig.q
        loss = orthogonality_loss_db(realisation.spectra[..., :q].mean(axis=1).transpose(1, 2, 0))
        if not loss > 1.0:
            return []
        text = f"the experiments are not orthogonal; the response matrix has {loss:.1f} dB more noise for it"
        return [(FaultKind.NOT_ORTHOGONAL, text)]

    def _not_periodic(self, realisation: Realisation) -> list[tuple[FaultKind, str]]:
        rig = self._run.rig
        drift = period_drift(realisation.spectra, rig.lines, rig.period_samples)
        if drift is not None:
            text = f"{drift.described(rig.period_samples)}: that explains {100 * drift.share:.0f} % of the change"
            return [(FaultKind.DRIFT, f"{text} from period to period")]
        periods = realisation.spectra[..., rig.q :]
        if len(self._discarded) == rig.q:
            before = np.stack([self._discarded[c] for c in range(rig.q)])
            periods = np.concatenate((before[:, None], periods), axis=1)
        if periods.shape[1] < 3:
            return []
        shares = [transient_share(periods[..., i]) for i in range(rig.n)]
        known = [share or 0.0 for share in shares]
        worst = int(np.argmax(known))
        if not known[worst]:
            return []
        text = (
            "the transient, or a drift, has not died out in the first kept period: "
            f"{10 * np.log10(known[worst]):.1f} dB of the response at node {rig.nodes[worst].name}"
        )
        return [(FaultKind.TRANSIENT, text)]


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
    matches = {place: match_input(U[place], planned[place], lines, period_samples) for place in places}
    wrong = [place for place in places if not matches[place].right]
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
