"""What measured arrays must satisfy before they become period frames."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from creak.errors import MeasurementError
from creak.quality import period_drift, wrong_inputs
from creak.records import Real, Rig

# A matrix beyond this is singular in double precision for every purpose here.
WORST_CONDITION = 1e6
# Independent experiments have condition numbers of the order of q at most lines. Where the median lies beyond
# this, one experiment repeats another, and only the noise of the recorded inputs keeps the matrix regular.
TYPICAL_CONDITION = 1e3
# An input counts as silent at a line where it lies this far (in amplitude) below its strongest line.
SILENT = 1e-6
# No quantity that is measured comes near it, and powers of larger samples overflow.
LARGEST = 1e100


def shown(name: str) -> str:
    """Return a name from a foreign file so that it fits into one line of a terminal."""
    return name if name.isprintable() else ascii(name)


def listing(names: Iterable[str], most: int = 20) -> str:
    """Return names for a message, in one line, not more than a person wants to read."""
    found = [shown(name) for name in names]
    more = f" and {len(found) - most} more" if len(found) > most else ""
    return (", ".join(found[:most]) or "none") + more


def as_numbers(array: Any, where: str) -> Real:
    """Return an array as float64, or refuse what does not hold real numbers.

    Parameters
    ----------
    array : array_like
        What a file reader returned.
    where : str
        File and variable, for the message.

    Raises
    ------
    MeasurementError
        If it is complex, or no array of integers or floating-point numbers.
    """
    if not isinstance(array, np.ndarray):
        raise MeasurementError(f"{where}: holds a {type(array).__name__}, expected an array of real numbers")
    if array.dtype.kind == "c" or array.dtype.names == ("real", "imag"):
        raise MeasurementError(f"{where}: holds complex numbers, expected real samples in time")
    if array.dtype.kind not in "iuf":
        raise MeasurementError(f"{where}: holds {_kind(array.dtype)}, expected real numbers")
    return array.astype(np.float64, copy=False)


def _kind(dtype: np.dtype[Any]) -> str:
    names = {"b": "logical values", "S": "text", "U": "text", "O": "objects", "V": "structures"}
    return names.get(dtype.kind, f"values of type {dtype}")


def check_shapes(u: NDArray[Any], y: NDArray[Any], rig: Rig, where: str) -> None:
    """Check numbers of axes, channels, experiments and periods against the rig.

    Parameters
    ----------
    u : array, (E, q, T)
    y : array, (E, n, T)
    rig : Rig
    where : str
        File name for the message.

    Raises
    ------
    MeasurementError
        Naming the array, the shape found and the shape expected.
    """
    for name, array, channels, what in (("u", u, rig.q, "inputs"), ("y", y, rig.n, "nodes")):
        if array.ndim != 3 or array.shape[1] != channels:
            axes = f"(experiments, {channels} {what}, samples)"
            raise MeasurementError(f"{where}: {name}: shape {array.shape}, expected {axes}")
    if u.shape[::2] != y.shape[::2]:
        expected = (u.shape[0], rig.n, u.shape[2])
        raise MeasurementError(f"{where}: y: shape {y.shape}, expected {expected} to go with u of {u.shape}")
    experiments, _, samples = u.shape
    periods, left = divmod(samples, rig.period_samples)
    if left:
        raise MeasurementError(
            f"{where}: {samples} samples an experiment are {periods} periods of {rig.period_samples} "
            f"and {left} samples left over, expected whole periods"
        )
    if periods <= rig.transient_periods:
        raise MeasurementError(
            f"{where}: {periods} periods an experiment of which {rig.transient_periods} are transient, "
            "expected at least one steady period"
        )
    if experiments == 0 or experiments % rig.q:
        raise MeasurementError(
            f"{where}: {experiments} experiments, expected a multiple of {rig.q}, "
            "as many a realisation as there are inputs"
        )


def never_came(u: Real, y: Real, rig: Rig) -> NDArray[np.bool_]:
    """Transient periods that hold nothing but NaN, as `creak export` writes those that were lost.

    Parameters
    ----------
    u : array, (E, q, T)
    y : array, (E, n, T)
    rig : Rig

    Returns
    -------
    array, (E, transient periods)
    """
    periods = rig.transient_periods
    lost = np.ones((len(u), periods), dtype=np.bool_)
    for array in (u, y):
        begun = array[..., : periods * rig.period_samples].reshape(*array.shape[:2], periods, rig.period_samples)
        lost &= np.isnan(begun).all(axis=(1, 3))
    return lost


def check_finite(u: Real, y: Real, rig: Rig, files: Sequence[str]) -> None:
    """Refuse samples that are not finite, or so large that their powers would not be.

    Transient periods that never came are passed over.

    Parameters
    ----------
    u : array, (E, q, T)
    y : array, (E, n, T)
    rig : Rig
    files : sequence of str
        One file name for all experiments, or one for each.

    Raises
    ------
    MeasurementError
        With their number and the first place: experiment, channel and sample, counted from 0.
    """
    inputs = [rig.nodes[i].name for i in rig.driven]
    lost = np.repeat(never_came(u, y, rig), rig.period_samples, axis=1)[:, None]  # (E, 1, transient samples)
    for name, array, channels in (("u", u, inputs), ("y", y, [node.name for node in rig.nodes])):
        bad = ~(np.abs(array) < LARGEST)
        bad[..., : lost.shape[-1]] &= ~lost
        count = int(np.count_nonzero(bad))
        if count:
            experiment, channel, sample = (int(i) for i in np.unravel_index(np.argmax(bad), bad.shape))
            file = files[experiment] if len(files) > 1 else files[0]
            raise MeasurementError(
                f"{file}: {name}: {count} of {array.size} samples are not finite or beyond {LARGEST:g}, "
                f"the first in experiment {experiment}, channel {channels[channel]}, sample {sample}"
            )


def check_inputs(u: Real, rig: Rig, where: str) -> None:
    """Refuse a realisation whose input matrix cannot be inverted at an excited line, see (28).

    The matrix holds the DFT of input i in experiment c, averaged over the steady periods. Its rows are scaled to
    unit RMS over the experiments first, so that inputs in different units, and spectra that fall with frequency,
    count alike.

    Parameters
    ----------
    u : array, (E, q, T)
    rig : Rig
    where : str
        File name for the message.

    Raises
    ------
    MeasurementError
        With the input that is silent, or the realisation, its worst line and the condition number there.
    """
    N, q = rig.period_samples, rig.q
    lines, frequencies = np.asarray(rig.lines), rig.frequencies
    steady = u.reshape(len(u), q, -1, N)[:, :, rig.transient_periods :].mean(axis=2)
    largest = np.abs(steady).max(axis=(0, 2))[:, None]
    U = np.fft.rfft(steady / np.where(largest > 0, largest, 1), axis=-1)[..., lines] / N
    U = U.reshape(-1, q, q, len(lines)).transpose(0, 3, 2, 1)  # (M, F, input, experiment)

    amplitude = np.sqrt(np.mean(np.abs(U) ** 2, axis=-1))  # (M, F, input)
    silent = amplitude <= SILENT * amplitude.max(axis=1, keepdims=True)
    if silent.any():
        m, k, i = (int(j) for j in np.unravel_index(np.argmax(silent), silent.shape))
        raise MeasurementError(
            f"{where}: u: the input at node {rig.nodes[rig.driven[i]].name} is silent at line {lines[k]} "
            f"({frequencies[k]:g} Hz) of realisation {m}, expected it to be excited at every line of the rig"
        )

    condition = np.linalg.cond(U / amplitude[..., None])  # (M, F)
    worst, typical = condition.max(axis=1), np.median(condition, axis=1)
    singular = (worst > WORST_CONDITION) | (typical > TYPICAL_CONDITION)
    if singular.any():
        m = int(np.argmax(singular))
        k = int(np.argmax(condition[m]))
        raise MeasurementError(
            f"{where}: u: the input matrix of realisation {m} is singular: condition number {worst[m]:.2g} "
            f"at line {lines[k]} ({frequencies[k]:g} Hz), median over the lines {typical[m]:.2g}, expected at "
            f"most {WORST_CONDITION:.0e} and {TYPICAL_CONDITION:.0e}: {q} independent experiments a realisation"
        )


def check_period(u: Real, y: Real, rig: Rig, where: str) -> None:
    """Refuse a measurement whose period is off by half a sample or more, judged on its first realisation.

    Parameters
    ----------
    u : array, (E, q, T)
    y : array, (E, n, T)
    rig : Rig
    where : str
        File name for the message.

    Raises
    ------
    MeasurementError
        With the period that fits.
    """
    channels = np.concatenate((u[: rig.q], y[: rig.q]), axis=1)
    periods = channels.reshape(rig.q, rig.q + rig.n, -1, rig.period_samples)[:, :, rig.transient_periods :]
    spectra = np.fft.rfft(periods)[..., list(rig.lines)].transpose(0, 2, 3, 1)
    drift = period_drift(spectra, rig.lines, rig.period_samples)
    if drift is not None and abs(drift.period_samples - rig.period_samples) >= 0.5:
        raise MeasurementError(
            f"{where}: {drift.described(rig.period_samples)} as the rig says (period_samples): that explains "
            f"{100 * drift.share:.0f} % of the change from period to period"
        )


def check_excitation(u: Real, planned: Real, rig: Rig, where: str, source: str) -> None:
    """Refuse inputs that are not those of the file which the generator was to play.

    Parameters
    ----------
    u : array, (E, q, T)
    planned : array, (E, q, periods)
        Whole periods, of which the first counts.
    rig : Rig
    where, source : str
        Names of the measurement and of the excitation's file, for the message.

    Raises
    ------
    MeasurementError
        Naming the first input that differs, and what it is instead.
    """
    N, q = rig.period_samples, rig.q
    if planned.ndim != 3 or planned.shape[1] != q or planned.shape[2] % N or len(planned) < len(u):
        raise MeasurementError(
            f"{source}: u: shape {planned.shape}, expected at least {len(u)} experiments of {q} inputs "
            f"and whole periods of {N} samples"
        )
    lines = list(rig.lines)
    steady = u.reshape(len(u), q, -1, N)[:, :, rig.transient_periods :].mean(axis=2)
    have, want = (np.fft.rfft(array)[..., lines] for array in (steady, planned[: len(u), :, :N]))
    names = tuple(f"input {rig.nodes[i].name}" for i in rig.driven)
    for m in range(len(u) // q):
        own = slice(m * q, (m + 1) * q)
        wrong = wrong_inputs(have[own], want[own], rig.lines, N, names)
        if wrong is not None:
            raise MeasurementError(f"{where}: u: realisation {m}: {wrong} ({source})")
