"""Measured data as a source: arrays of whole periods, read from the files of laboratories and loggers."""

import hashlib
import threading
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from creak import __version__
from creak.errors import MeasurementError
from creak.records import Excitation, Fault, Frame, Limits, Real, Rig, Run
from creak.sources.measurement_arrays import mat_variables, npz_variables, read_mat, read_npz
from creak.sources.measurement_checks import (
    as_numbers,
    check_finite,
    check_inputs,
    check_period,
    check_shapes,
    never_came,
    shown,
)
from creak.sources.measurement_csv import read_csv
from creak.sources.measurement_uff import read_uff

_Reader = Callable[[Path, Rig], tuple[Real, Real]]

_WHOLE: dict[str, _Reader] = {".npz": read_npz, ".mat": read_mat}
_ONE_EXPERIMENT: dict[str, _Reader] = {".csv": read_csv, ".uff": read_uff, ".unv": read_uff}
SUFFIXES = (*_WHOLE, *_ONE_EXPERIMENT)
"""What `read_measurement` reads, told by the suffix of the file's name in either case."""


def read_measurement(files: Sequence[Path], rig: Rig) -> tuple[Real, Real]:
    """Read and check a measurement.

    Parameters
    ----------
    files : sequence of Path
        One NPZ or MAT file that holds the arrays whole, or CSV, UFF or UNV files with one experiment each,
        in order.
    rig : Rig
        What was measured.

    Returns
    -------
    u : array, (E, q, T)
        Inputs in the order of the driven nodes; whole periods, the transient ones included.
    y : array, (E, n, T)
        Responses in the order of the nodes.

    Raises
    ------
    MeasurementError
        One line that names the file and the variable, with what was found and what was expected: a file that
        cannot be read, a missing variable, a wrong shape, no whole periods, no steady period, an incomplete
        realisation, samples that are no finite real numbers (a whole transient period may be NaN: it was lost), an
        input matrix that is singular at a line.
    """
    if not files:
        raise MeasurementError("no file given, expected at least one")
    suffixes = {path.suffix.lower() for path in files}
    for path in files:
        if path.suffix.lower() not in SUFFIXES:
            found = f"suffix {path.suffix}" if path.suffix else "no suffix"
            raise MeasurementError(f"{path}: {found}, expected one of {', '.join(SUFFIXES)}")
    if len(files) > 1 and suffixes & _WHOLE.keys():
        raise MeasurementError(
            f"{files[1]}: one of {len(files)} files, expected a single NPZ or MAT file, "
            "or one CSV, UFF or UNV file an experiment"
        )
    if suffixes <= _WHOLE.keys():
        u, y = _read(files[0], _WHOLE, rig)
    else:
        u, y = _join(files, [_read(path, _ONE_EXPERIMENT, rig) for path in files])
    names = [str(path) for path in files]
    where = names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}"
    check_shapes(u, y, rig, where)
    check_finite(u, y, rig, names)
    check_inputs(u, rig, where)
    check_period(u, y, rig, where)
    return u, y


def read_excitation(path: Path) -> Real:
    """Read the multisines that a generator was to play, as `creak excitation` writes them (NPZ or MAT).

    Returns
    -------
    array, (experiment, input, sample)

    Raises
    ------
    MeasurementError
        If the file cannot be read or holds no ``u``.
    """
    reader = {".npz": npz_variables, ".mat": mat_variables}.get(path.suffix.lower())
    if reader is None:
        raise MeasurementError(f"{path}: an excitation is read from .npz or .mat")
    with _readable(path):
        return as_numbers(reader(path, ("u",))["u"], f"{path}: u")


def _read(path: Path, readers: dict[str, _Reader], rig: Rig) -> tuple[Real, Real]:
    with _readable(path):
        return readers[path.suffix.lower()](path, rig)


def _join(files: Sequence[Path], parts: Sequence[tuple[Real, Real]]) -> tuple[Real, Real]:
    samples = parts[0][0].shape[-1]
    for path, (u, _) in zip(files, parts, strict=True):
        if u.shape[-1] != samples:
            raise MeasurementError(f"{path}: {u.shape[-1]} samples, expected {samples} as {files[0]} has")
    return np.stack([u for u, _ in parts]), np.stack([y for _, y in parts])


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn whatever a parser of a foreign format stumbles over into one line."""
    try:
        with path.open("rb"):  # some readers take a missing file for an empty one
            pass
        yield
    except MeasurementError:
        raise
    except MemoryError as error:
        raise MeasurementError(f"{path}: needs more memory than there is: {error}") from error
    except Exception as error:  # scipy, h5py and pyuff raise whatever a damaged file provokes
        text = getattr(error, "strerror", None) or str(error) or type(error).__name__
        reason = shown(text.splitlines()[0])
        raise MeasurementError(f"{path}: cannot be read as {path.suffix}: {reason}") from error


class Measurement:
    """A measurement as a source of period frames, experiment by experiment.

    Parameters
    ----------
    u : array, (E, q, T)
        Inputs, as `read_measurement` returns them.
    y : array, (E, n, T)
        Responses.
    rig : Rig
    start : int
        Recorded time of the first sample, ns since the Unix epoch. The experiments follow each other without
        a gap.
    window : int
        Complete realisations over which levels are taken.
    limits : Limits
    run_id : str, optional
        By default made from all of the above, so that importing the same data twice gives the same recording.

    Raises
    ------
    MeasurementError
        If the arrays do not have the shape that the rig asks for.
    """

    live = False

    def __init__(
        self,
        u: Real,
        y: Real,
        rig: Rig,
        start: int = 0,
        *,
        window: int = Run.window,
        limits: Limits | None = None,
        run_id: str | None = None,
    ) -> None:
        check_shapes(u, y, rig, "measurement")
        limits = Limits() if limits is None else limits
        self._u, self._y = u, y
        self._closed = threading.Event()
        self.run = Run(
            id=_identity(u, y, (rig, start, window, limits)) if run_id is None else run_id,
            rig=rig,
            steady_periods=u.shape[-1] // rig.period_samples - rig.transient_periods,
            start=start,
            excitation=Excitation(kind="measured", rms=_common_rms(u, rig)),
            source="measurement",
            window=window,
            limits=limits,
            software=__version__,
        )

    def frames(self) -> Iterator[Frame | Fault]:
        """Yield all period frames, transient ones included, but for those that never came; in their order."""
        rig, N = self.run.rig, self.run.rig.period_samples
        lost = never_came(self._u, self._y, rig)
        for e in range(len(self._u)):
            realisation, experiment = divmod(e, rig.q)
            for period in range(self.run.periods):
                if self._closed.is_set():
                    return
                if period < rig.transient_periods and lost[e, period]:
                    continue
                samples = slice(period * N, (period + 1) * N)
                before = (e * self.run.periods + period) * N
                yield Frame(
                    realisation=realisation,
                    experiment=experiment,
                    period=period,
                    time=self.run.start + round(before * 1_000_000_000 / rig.sample_rate),
                    u=np.ascontiguousarray(self._u[e, :, samples]),
                    y=np.ascontiguousarray(self._y[e, :, samples]),
                )

    def close(self) -> None:
        """End the iteration before its next frame."""
        self._closed.set()


def _identity(u: Real, y: Real, circumstances: tuple[Rig, int, int, Limits]) -> str:
    digest = hashlib.sha256(repr(circumstances).encode())
    for array in (u, y):
        digest.update(np.ascontiguousarray(array, dtype="<f8").data)
    return str(uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest()))


def _common_rms(u: Real, rig: Rig) -> float | None:
    """Return the RMS value of the steady inputs if it is the same within 1 % everywhere, else None."""
    steady = u[..., rig.transient_periods * rig.period_samples :]
    rms = np.linalg.norm(steady, axis=-1) / np.sqrt(steady.shape[-1])
    mean = float(rms.mean())
    return mean if mean > 0 and np.ptp(rms) <= 0.01 * mean else None
