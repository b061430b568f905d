"""Recordings for notebooks: arrays, levels and alarms, read when they are asked for."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from creak.errors import RecordingError
from creak.records import (
    AlarmChange,
    Estimate,
    Fault,
    Frame,
    FrameStatus,
    NodeLevel,
    Real,
    Rig,
    Run,
    Scope,
)
from creak.sources.recording import Recording

Times = NDArray[np.datetime64]
"""Recorded times, UTC, in nanoseconds."""

QUANTITIES = tuple(field.name for field in fields(NodeLevel) if field.name != "name")
"""Names of the levels of a node, as in `creak.records.NodeLevel`."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """All periods of one experiment of a complete realisation, the transient ones first.

    Parameters
    ----------
    realisation, experiment : int
    times : array, (periods,)
        Recorded time of every period's first sample; NaT for a transient period that never came.
    u : array, (periods, q, N)
        Inputs, in their units; NaN for a transient period that never came.
    y : array, (periods, n, N)
        Responses, likewise.
    """

    realisation: int
    experiment: int
    times: Times
    u: Real
    y: Real


@dataclass(frozen=True, eq=False)
class Levels:
    """Live levels of a run over its windows; NaN where the data do not carry a quantity.

    Parameters
    ----------
    nodes : tuple of str
    times : array, (W,)
        Recorded time at the end of every window.
    realisations : array, (W,)
        Index of the last realisation of every window.
    values : dict of str to array, (W, n)
        By the names in `QUANTITIES`, also as ``levels["total_to_noise_db"]``.
    """

    nodes: tuple[str, ...]
    times: Times
    realisations: NDArray[np.int64]
    values: dict[str, Real]

    def __getitem__(self, quantity: str) -> Real:
        """Return one quantity, (W, n)."""
        return self.values[quantity]


@dataclass(frozen=True)
class _Findings:
    windows: tuple[Estimate, ...]
    estimate: Estimate | None
    alarms: tuple[AlarmChange, ...]
    faults: tuple[Fault, ...]


class OpenedRecording:
    """A recording, opened for looking at it; nothing but its head is read before it is asked for.

    What is asked for is then kept. Only complete realisations count, as in the monitor; of a file that was cut or
    damaged they are those that are whole. Symbols and axis order are those of `creak.records`.

    Attributes
    ----------
    run : Run
        All that was known when it began.
    rig : Rig
    """

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self.run: Run = recording.run
        self.rig: Rig = recording.run.rig

    def experiments(self, first: int | None = None, last: int | None = None) -> Iterator[Experiment]:
        """Yield the experiments of complete realisations one by one, so that any file fits into memory.

        Parameters
        ----------
        first, last : int, optional
            Realisations that count, ends included.
        """
        index, frames = -1, dict[tuple[int, int], Frame]()
        for record in self._recording.recorded():
            if isinstance(record, Frame) and record.status is not FrameStatus.REJECTED:
                if record.realisation > index:
                    index, frames = record.realisation, {}
                if record.realisation == index:  # a late copy of a transient frame belongs to an earlier one
                    frames[record.experiment, record.period] = record
            elif isinstance(record, Estimate) and record.scope is Scope.RUN:  # its realisation is complete
                index_counts = (first is None or index >= first) and (last is None or index <= last)
                if index_counts and record.realisation == index:
                    yield from (_experiment(self.run, frames, index, e) for e in range(self.rig.q))

    @cached_property
    def samples(self) -> tuple[Real, Real]:
        """Inputs ``(E, P, q, N)`` and responses ``(E, P, n, N)`` of the steady periods; E may be 0."""
        skipped, rig = self.rig.transient_periods, self.rig
        found = [(item.u[skipped:], item.y[skipped:]) for item in self.experiments()]
        if not found:
            shape = (0, self.run.steady_periods)
            return np.empty((*shape, rig.q, rig.period_samples)), np.empty((*shape, rig.n, rig.period_samples))
        return np.stack([u for u, _ in found]), np.stack([y for _, y in found])

    @property
    def u(self) -> Real:
        """Inputs of the steady periods, ``(E, P, q, N)``, in their units."""
        return self.samples[0]

    @property
    def y(self) -> Real:
        """Responses in the steady periods, ``(E, P, n, N)``, in their units."""
        return self.samples[1]

    @cached_property
    def times(self) -> Times:
        """Recorded time of the first sample of every steady period, ``(E, P)``."""
        found = [item.times[self.rig.transient_periods :] for item in self.experiments()]
        return np.stack(found) if found else np.empty((0, self.run.steady_periods), "datetime64[ns]")

    @property
    def time(self) -> Real:
        """Time within a period, ``(N,)``, s."""
        return np.arange(self.rig.period_samples) / self.rig.sample_rate

    @property
    def frequencies(self) -> Real:
        """Excited lines, ``(F,)``, Hz: bins `rig.lines` of ``numpy.fft.rfft(y)``."""
        return self.rig.frequencies

    @cached_property
    def levels(self) -> Levels:
        """Live levels, a window each."""
        windows = self._findings.windows
        table = {
            quantity: np.array(
                [[getattr(node, quantity) for node in window.nodes] for window in windows], dtype=np.float64
            ).reshape(len(windows), self.rig.n)  # None becomes NaN
            for quantity in QUANTITIES
        }
        return Levels(
            nodes=tuple(node.name for node in self.rig.nodes),
            times=_times([window.time for window in windows]),
            realisations=np.array([window.realisation for window in windows], dtype=np.int64),
            values=table,
        )

    @property
    def estimate(self) -> Estimate | None:
        """Levels and ``spectra`` over the whole run as of its last complete realisation; None before the first."""
        return self._findings.estimate

    @property
    def alarms(self) -> tuple[AlarmChange, ...]:
        """Every change of every alarm, in their order."""
        return self._findings.alarms

    @property
    def faults(self) -> tuple[Fault, ...]:
        """All data that were refused or never came, each with its reason."""
        return self._findings.faults

    @property
    def truncated(self) -> bool:
        """True if the recording ended before its end record."""
        return bool(self._findings) and self._recording.truncated

    @property
    def damage(self) -> tuple[str, ...]:
        """A line for each stretch of the file that could not be read."""
        return self._recording.losses if self._findings else ()

    def __repr__(self) -> str:
        """Name what it is a recording of, without reading it."""
        names = ", ".join(path.name for path in self._recording.paths)
        return f"<recording of {self.rig.name!r}: {names}>"

    @cached_property
    def _findings(self) -> _Findings:
        windows, whole, alarms, faults = [], None, [], []
        for record in self._recording.recorded():
            match record:
                case Estimate(scope=Scope.WINDOW):
                    windows.append(record)
                case Estimate():
                    whole = record
                case AlarmChange():
                    alarms.append(record)
                case Fault():
                    faults.append(record)
        return _Findings(tuple(windows), whole, tuple(alarms), tuple(faults))


def open_recording(*paths: Path | str) -> OpenedRecording:
    """Open a recording of one file, of several parts, or of a directory that holds the parts.

    Parameters
    ----------
    *paths : Path or str

    Raises
    ------
    RecordingError
        A file that is missing or no recording of creak, parts of different runs, no path at all.

    Examples
    --------
    The distortion of node 3 over a day, and its spectrum of the whole run::

        import creak
        import matplotlib.pyplot as plt

        recording = creak.open_recording("creak-demo/")
        levels = recording.levels
        plt.plot(levels.times, levels["total_to_noise_db"][:, levels.nodes.index("3")])

        spectra = recording.estimate.spectra            # each (F, n), unit squared
        plt.loglog(recording.frequencies, spectra.total[:, 2])

        y = recording.y.mean(axis=1)                    # period means, (E, n, N)
    """
    if not paths:
        raise RecordingError("no recording is given")
    return OpenedRecording(Recording(*(Path(path) for path in paths)))


def _experiment(run: Run, frames: dict[tuple[int, int], Frame], realisation: int, experiment: int) -> Experiment:
    rig = run.rig
    found = [frames.get((experiment, period)) for period in range(run.periods)]
    u = np.full((run.periods, rig.q, rig.period_samples), np.nan)
    y = np.full((run.periods, rig.n, rig.period_samples), np.nan)
    for period, frame in enumerate(found):
        if frame is not None:
            u[period], y[period] = frame.u, frame.y
    return Experiment(realisation, experiment, _times([None if f is None else f.time for f in found]), u, y)


def _times(nanoseconds: list[int | None] | list[int]) -> Times:
    return np.array([np.datetime64("NaT") if t is None else t for t in nanoseconds], dtype="datetime64[ns]")
