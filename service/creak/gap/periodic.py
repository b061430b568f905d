"""Complete realisations of a recording with all their lines, as a diagnosis needs them."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from creak.errors import MeasurementError
from creak.gap.layout import settle
from creak.gap.quiet import quiet_variance
from creak.realisations import Collector
from creak.records import Complex, Fault, Frame, FrameStatus, Real, Rig, Run


@dataclass(frozen=True, eq=False)
class PeriodicData:
    """Steady period means of all experiments, and the noise that they carry.

    Parameters
    ----------
    realisation : array of int, (E,)
        To which realisation an experiment belongs; as they were recorded.
    u : array, (E, q, N)
        Inputs, mean over the steady periods.
    y : array, (E, n, N)
        Responses, mean over the steady periods.
    Y : array, (E, L, n)
        DFT of the means divided by N at all lines, ``L = N//2 + 1``.
    variance : array, (L, n)
        Variance of the noise of the *mean* of an experiment's periods, ``sigma_n^2/P`` of (40); infinite at lines
        that do not count.
    degrees : float
        Complex degrees of freedom behind each variance, ``E (P - 1)`` times the lines that were pooled.
    periods : int
        P.
    pooled : int
        Neighbouring lines whose scatter makes one variance.
    """

    realisation: np.ndarray[tuple[int], np.dtype[np.int64]]
    u: Real
    y: Real
    Y: Complex
    variance: Real
    degrees: float
    periods: int
    pooled: int = 1

    def __post_init__(self) -> None:
        """Settle the layout."""
        settle(self)

    @property
    def counts(self) -> NDArray[np.bool_]:
        """Lines that count, ``(L,)``."""
        return np.asarray(np.isfinite(self.variance).all(axis=1))

    def of(self, experiments: np.ndarray[tuple[int], np.dtype[np.int64]]) -> "PeriodicData":
        """Some of the experiments, under the noise that all of them have told."""
        return replace(
            self,
            realisation=self.realisation[experiments],
            u=self.u[experiments],
            y=self.y[experiments],
            Y=self.Y[experiments],
        )


_FEWEST_DEGREES = 24  # below this the noise of neighbouring lines is pooled: a few periods give no weight
_REPEATS = 0.01  # power by which an input may differ from period to period, relative to its own
_FLOOR = 1e-10  # least noise power relative to the response: rounding, where a recording has no noise at all


def gather(run: Run, items: Iterable[Frame | Fault]) -> PeriodicData:
    """Gather what a source yields; what the monitor would refuse is left out here too.

    Parameters
    ----------
    run : Run
    items : iterable of Frame or Fault
        For instance ``Recording.frames()``.

    Returns
    -------
    PeriodicData

    Raises
    ------
    MeasurementError
        If no realisation is complete, or an experiment has one steady period only and all lines are excited; if
        an input does not repeat from period to period.
    """
    rig = run.rig
    collector = Collector(run)
    pending: dict[tuple[int, int], Frame] = {}  # of the realisation at hand
    current = -1
    indices: list[int] = []
    u: list[Real] = []
    y: list[Real] = []
    scatter = np.zeros((rig.period_samples // 2 + 1, rig.n))
    for item in items:
        if isinstance(item, Fault):
            collector.lose(item)
            continue
        collected = collector.take(item)
        frame = collected.frame
        if frame.status is FrameStatus.ACCEPTED:
            if frame.realisation > current:  # the one before is over, complete or not
                current = frame.realisation
                pending.clear()
            pending[frame.experiment, frame.period] = frame
        if collected.realisation is None:
            continue
        index = collected.realisation.index
        for c in range(rig.q):
            whole = [pending[c, p] for p in range(rig.transient_periods, run.periods)]
            mean = np.mean([frame.y for frame in whole], axis=0)
            for frame in whole:
                scatter += np.abs(scipy.fft.rfft(frame.y - mean, axis=-1).T / rig.period_samples) ** 2
            indices.append(index)
            u.append(_repeated(rig, np.array([frame.u for frame in whole]), index, c))
            y.append(mean)
        pending.clear()
    if not indices:
        raise MeasurementError("the recording has no complete realisation, so there is nothing to diagnose")
    if run.steady_periods == 1:
        return _of_one_period(rig, np.array(indices), np.array(u), np.array(y))
    degrees = len(indices) * (run.steady_periods - 1)
    return _data(np.array(indices), np.array(u), np.array(y), scatter, degrees, run.steady_periods)


def _repeated(rig: Rig, periods: Real, realisation: int, experiment: int) -> Real:
    """Mean of the input's periods ``(P, q, N)``, if they are periods.

    Derivatives, steady simulation and the noise itself rest on the period, so that no answer would be one.
    """
    mean = np.asarray(periods.mean(axis=0))
    power, differing = np.mean(mean**2), np.mean((periods - mean) ** 2) * len(periods) / max(len(periods) - 1, 1)
    share = 100 * np.sqrt(differing / max(power, np.finfo(float).tiny))
    if differing > _REPEATS * power:
        raise MeasurementError(
            f"the inputs of realisation {realisation}, experiment {experiment} do not repeat every "
            f"{rig.period_samples} samples (period_samples): they differ by {share:.0f} % "
            "from period to period, and only periodic measurements can be diagnosed"
        )
    return mean


def _of_one_period(
    rig: Rig, realisation: np.ndarray[tuple[int], np.dtype[np.int64]], u: Real, y: Real
) -> PeriodicData:
    size = y.shape[-1]
    Y = np.ascontiguousarray(np.swapaxes(scipy.fft.rfft(y, axis=-1), -1, -2)) / size
    variance, degrees = quiet_variance(rig, Y)
    return PeriodicData(realisation, u, y, Y, np.maximum(variance, _floor(Y)), degrees, 1, round(degrees / len(y)))


def _floor(Y: Complex) -> Real:
    power = np.mean(np.sum(np.abs(Y) ** 2, axis=1), axis=0)
    return np.asarray(_FLOOR * power / Y.shape[1] + np.finfo(float).tiny)


def _data(
    realisation: np.ndarray[tuple[int], np.dtype[np.int64]],
    u: Real,
    y: Real,
    scatter: Real,
    degrees: int,
    periods: int,
) -> PeriodicData:
    size = y.shape[-1]
    Y = np.ascontiguousarray(np.swapaxes(scipy.fft.rfft(y, axis=-1), -1, -2)) / size
    pooled = 1
    variance = scatter / degrees
    if degrees < _FEWEST_DEGREES:
        pooled = 2 * (-(-_FEWEST_DEGREES // degrees) // 2) + 1
        kernel = np.ones(pooled) / pooled
        padded = np.pad(variance, ((pooled // 2, pooled // 2), (0, 0)), mode="reflect")
        variance = np.stack(
            [np.convolve(padded[:, i], kernel, mode="valid") for i in range(variance.shape[1])], -1
        )
    return PeriodicData(
        realisation, u, y, Y, np.maximum(variance / periods, _floor(Y)), float(degrees * pooled), periods, pooled
    )
