"""Period frames in, in any order inside a realisation; complete realisations out; everything else is named.

An experiment with a missing or refused steady period is left out whole, and a realisation counts only when all
its experiments are complete: the input matrix of a line can be inverted only then.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from creak.detection import detection_lines
from creak.moments import responses
from creak.records import Complex, Fault, FaultKind, Frame, FrameStatus, Real, Rig, Run


@dataclass(frozen=True, eq=False)
class Realisation:
    """A complete realisation.

    Parameters
    ----------
    index : int
    end : int
        Recorded time at the end of its last period, ns since the Unix epoch.
    spectra : array, (q, P, F, q + n)
        DFT divided by N of inputs, then responses, at the excited lines.
    left_out : array, (q, P, lines, q + n)
        The same at the detection lines, odd ones first.
    S : array, (F, n, q)
        Its best linear approximation (28).
    """

    index: int
    end: int
    spectra: Complex
    left_out: Complex
    S: Complex


@dataclass(frozen=True)
class Collected:
    """What one frame led to."""

    frame: Frame
    faults: tuple[Fault, ...] = ()
    realisation: Realisation | None = None


def spectrum(rig: Rig, u: Real, y: Real, lines: Sequence[int] | None = None) -> Complex:
    """DFT of one period at some lines, divided by N.

    Parameters
    ----------
    u : array, (q, N)
    y : array, (n, N)
    lines : sequence of int, optional
        The excited ones if not given.

    Returns
    -------
    array, (F, q + n)
    """
    at = np.asarray(rig.lines if lines is None else lines)
    return np.fft.rfft(np.concatenate((u, y)), norm="forward")[:, at].T


_SPOILING = (FaultKind.WRONG_SHAPE, FaultKind.NOT_FINITE)


@dataclass
class _Open:
    """The realisation that is being filled: a slot for every steady period of every experiment.

    Its spectra hold the excited lines, then the detection lines, ``(q, P, q + n, lines)``.
    """

    index: int
    spectra: Complex
    filled: np.ndarray[tuple[int, int], np.dtype[np.bool_]]
    spoilt: set[int] = field(default_factory=set)  # experiments that cannot become complete
    end: int = 0


class Collector:
    """Judges frames one by one and gathers them into realisations; memory does not depend on their number.

    Parameters
    ----------
    run : Run
    """

    def __init__(self, run: Run) -> None:
        self._run = run
        rig = run.rig
        self._lines = np.array(rig.lines + detection_lines(rig).all)
        self._samples = np.empty((rig.q + rig.n, rig.period_samples))
        self._channels = np.empty((rig.q + rig.n, rig.period_samples // 2 + 1), dtype=np.complex128)
        self._open: _Open | None = None
        self._closed = -1  # index of the last realisation that takes no more frames

    @property
    def open_frames(self) -> int:
        """Good frames of the realisation that is being filled."""
        return 0 if self._open is None else int(self._open.filled.sum())

    def take(self, frame: Frame) -> Collected:
        """Judge one frame.

        Returns
        -------
        Collected
            The frame with its status, the faults that it caused, and the realisation that it completed.
            A frame of a later realisation closes the open one, which then is incomplete.
        """
        refusal = self._refusal(frame)
        if refusal is not None:
            return self._refuse(frame, *refusal)
        steady = frame.period >= self._run.rig.transient_periods
        if steady:
            channels = self._transform(frame)
            refusal = _not_finite(frame, channels)
            if refusal is not None:
                return self._refuse(frame, *refusal)
        faults = self._turn_to(frame.realisation) if frame.realisation > self._closed else ()
        if not steady:
            return Collected(_judged(frame, FrameStatus.TRANSIENT), faults)
        current = self._open
        assert current is not None
        period = frame.period - self._run.rig.transient_periods
        if current.filled[frame.experiment, period]:
            refused = self._refuse(frame, FaultKind.DOUBLED, "came already; the first one counts")
            return Collected(refused.frame, faults + refused.faults)
        slot = current.spectra[frame.experiment, period]
        np.take(channels, self._lines, axis=1, out=slot, mode="clip")  # "raise" would fill a copy first
        current.filled[frame.experiment, period] = True
        current.end = max(current.end, frame.time + round(self._run.rig.period_ns))
        accepted = _judged(frame, FrameStatus.ACCEPTED)
        if not current.filled.all() or current.spoilt:
            return Collected(accepted, faults)
        self._open, self._closed = None, current.index
        rig = self._run.rig
        F = len(rig.lines)
        S = np.empty((rig.n, rig.q, F), dtype=np.complex128)
        condition = np.empty(F)
        responses(current.spectra, rig.q, S, condition)
        if not (condition < _SINGULAR).all():
            fault = _singular(self._run, current)
            if fault is not None:
                return Collected(accepted, (*faults, fault))
        spectra = current.spectra.swapaxes(2, 3)
        found = Realisation(current.index, current.end, spectra[:, :, :F], spectra[:, :, F:], S.transpose(2, 0, 1))
        return Collected(accepted, faults, found)

    def _transform(self, frame: Frame) -> Complex:
        """DFT of all channels divided by N, ``(q + n, N/2 + 1)``, until the next one.

        Side by side channels take less time than one by one, and in memory that is there already less than in new.
        """
        q = self._run.rig.q
        self._samples[:q] = frame.u
        self._samples[q:] = frame.y
        with np.errstate(invalid="ignore", over="ignore"):  # samples that are not finite are found in the result
            return np.fft.rfft(self._samples, norm="forward", out=self._channels)

    def lose(self, fault: Fault) -> tuple[Fault, ...]:
        """Take note of a frame that a source says never came; gives what follows from it."""
        if fault.realisation is None or fault.experiment is None or fault.period is None:
            return ()
        if fault.realisation <= self._closed:
            return ()
        faults = self._turn_to(fault.realisation)
        if fault.period >= self._run.rig.transient_periods and self._open is not None:
            self._open.spoilt.add(fault.experiment)
        return faults

    def finish(self) -> tuple[Fault, ...]:
        """Close the run; gives a fault if a realisation was left incomplete."""
        return self._close_open()

    def _refusal(self, frame: Frame) -> tuple[FaultKind, str] | None:
        """Kind and reason if the frame cannot be used by itself."""
        run, rig = self._run, self._run.rig
        if not (frame.realisation >= 0 and 0 <= frame.experiment < rig.q and 0 <= frame.period < run.periods):
            return FaultKind.OUT_OF_PLAN, f"is none of the run's {rig.q} experiments of {run.periods} periods"
        if frame.period < rig.transient_periods:
            return None  # it counts for nothing, so nothing about it can do harm
        if frame.realisation <= self._closed:
            return FaultKind.LATE, "came after its realisation was closed"
        expected = ((rig.q, rig.period_samples), (rig.n, rig.period_samples))
        if (frame.u.shape, frame.y.shape) != expected:
            return (
                FaultKind.WRONG_SHAPE,
                f"has inputs {frame.u.shape} and responses {frame.y.shape}; "
                f"should be {expected[0]} and {expected[1]} (channel, sample)",
            )
        return None

    def _refuse(self, frame: Frame, kind: FaultKind, reason: str) -> Collected:
        """Reject a frame; one whose samples are bad spoils its experiment, even if it is sent again."""
        faults: tuple[Fault, ...] = ()
        if kind in _SPOILING:
            faults = self._turn_to(frame.realisation)
            if self._open is not None:
                self._open.spoilt.add(frame.experiment)
        where = f"period {frame.period} of experiment {frame.experiment} of realisation {frame.realisation}"
        fault = Fault(kind, frame.time, f"{where} {reason}", frame.realisation, frame.experiment, frame.period)
        return Collected(_judged(frame, FrameStatus.REJECTED, reason), (*faults, fault))

    def _turn_to(self, index: int) -> tuple[Fault, ...]:
        """Make a realisation the open one, closing an earlier one first."""
        if self._open is not None and self._open.index == index:
            return ()
        faults = self._close_open()
        rig, steady = self._run.rig, self._run.steady_periods
        self._closed = index - 1
        self._open = _Open(
            index=index,
            spectra=np.empty((rig.q, steady, rig.q + rig.n, len(self._lines)), dtype=np.complex128),
            filled=np.zeros((rig.q, steady), dtype=np.bool_),
        )
        return faults

    def _close_open(self) -> tuple[Fault, ...]:
        current = self._open
        if current is None:
            return ()
        self._open, self._closed = None, current.index
        unfilled = np.flatnonzero(~current.filled.all(axis=1)).tolist()
        missing = sorted({*unfilled, *current.spoilt})
        names = ", ".join(str(c) for c in missing)
        whole = int(current.filled.sum())
        return (
            Fault(
                FaultKind.INCOMPLETE,
                current.end,
                f"realisation {current.index} is left out with its {whole} good frames: "
                f"experiment {names} of {self._run.rig.q} is not complete",
                realisation=current.index,
            ),
        )


def _not_finite(frame: Frame, channels: Complex) -> tuple[FaultKind, str] | None:
    """Kind and reason if a sample is not finite, which leaves no line of its channel finite."""
    if np.isfinite(channels[:, 0]).all():
        return None
    for label, samples in (("input", frame.u), ("response", frame.y)):
        wrong = ~np.isfinite(samples)
        if wrong.any():
            channel, sample = np.argwhere(wrong)[0]
            return (
                FaultKind.NOT_FINITE,
                f"holds {int(wrong.sum())} samples that are not finite, the first in {label} {channel + 1}, "
                f"sample {sample}",
            )
    return None


def _judged(frame: Frame, status: FrameStatus, reason: str = "") -> Frame:
    if frame.status is status and frame.reason == reason:
        return frame
    return Frame(frame.realisation, frame.experiment, frame.period, frame.time, frame.u, frame.y, status, reason)


_SINGULAR = 1e8  # condition number of the input matrix beyond which its inverse is rounding


def _singular(run: Run, current: _Open) -> Fault | None:
    """Fault if the input matrix ``(q, q)`` of a line, averaged over periods, cannot be inverted."""
    q, F = run.rig.q, len(run.rig.lines)
    inputs = current.spectra[:, :, :q, :F].mean(axis=1).transpose(2, 1, 0)  # (F, q inputs, q experiments)
    condition = np.linalg.cond(inputs)
    worst = int(np.argmax(np.nan_to_num(condition, nan=np.inf)))
    if condition[worst] < _SINGULAR:
        return None
    return Fault(
        FaultKind.SINGULAR,
        current.end,
        f"realisation {current.index} is left out: its input matrix is singular at line {run.rig.lines[worst]} "
        f"({run.rig.frequencies[worst]:g} Hz, condition number {condition[worst]:.1e})",
        realisation=current.index,
    )
