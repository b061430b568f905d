"""Measurements that one file holds whole, as arrays ``u`` and ``y``: NPZ, and MAT of either MATLAB format."""

import zipfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from creak.errors import MeasurementError
from creak.records import Real, Rig
from creak.sources.measurement_checks import as_numbers, listing
from creak.sources.measurement_mat5 import check_mat5


def read_npz(path: Path, rig: Rig) -> tuple[Real, Real]:
    """Read ``u`` and ``y`` from an NPZ file; pickled objects are refused.

    Returns
    -------
    u, y : array
        As float64, with the axes of the file where none was dropped; see `restore_axes`.

    Raises
    ------
    MeasurementError
        If a variable is missing or holds no real numbers.
    """
    return _pair(npz_variables(path, ("u", "y")), rig, path)


def read_mat(path: Path, rig: Rig) -> tuple[Real, Real]:
    """Read ``u`` and ``y`` from a MAT file, version 5 or 7.3, with the axes that MATLAB shows.

    Returns
    -------
    u, y : array
        As float64, with the axes of the file where none was dropped; see `restore_axes`.

    Raises
    ------
    MeasurementError
        If a variable is missing or holds no real numbers.
    """
    return _pair(mat_variables(path, ("u", "y")), rig, path)


def npz_variables(path: Path, wanted: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Arrays of an NPZ file by their names; MeasurementError if one is missing or pickled."""
    if not zipfile.is_zipfile(path):  # numpy would take it for a pickle
        names = f"variable{'s' * (len(wanted) > 1)} {' and '.join(wanted)}"
        raise MeasurementError(f"{path}: is no NPZ archive, expected one with the {names}")
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:  # numpy forgets to close a bad one
        _require(path, archive.files, wanted)
        return {name: _from_npz(archive, name, path) for name in wanted}


def mat_variables(path: Path, wanted: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Arrays of a MAT file of either format by their names; MeasurementError if one is missing or no number."""
    import h5py

    if h5py.is_hdf5(path):
        with h5py.File(path, "r") as file:
            _require(path, file, wanted)
            return {name: _from_hdf5(file[name], f"{path}: {name}") for name in wanted}
    import scipy.io

    _require(path, check_mat5(path, wanted), wanted)
    found = scipy.io.loadmat(path, variable_names=list(wanted))
    return {name: found[name] for name in wanted}


def restore_axes(array: Real, channels: int) -> Real:
    """Give back the axes of length one that a program dropped, as far as they are certain.

    Parameters
    ----------
    array : array
        ``(experiment, channel, sample)``, or with fewer axes.
    channels : int
        Inputs or nodes of the rig.

    Returns
    -------
    array
        ``(experiment, sample)`` of a single channel, ``(channel, sample)`` of a single experiment and
        ``(sample,)`` of both get their missing axes; anything else is returned as it is.
    """
    if array.ndim == 2 and channels == 1:
        return array[:, None, :]
    if array.ndim == 2 and array.shape[0] == channels:
        return array[None]
    if array.ndim == 1 and channels == 1:
        return array[None, None]
    return array


def _pair(arrays: dict[str, Any], rig: Rig, path: Path) -> tuple[Real, Real]:
    u, y = (as_numbers(arrays[name], f"{path}: {name}") for name in ("u", "y"))
    return restore_axes(u, rig.q), restore_axes(y, rig.n)


def _require(path: Path, names: Iterable[str], wanted: Sequence[str]) -> None:
    found = [name for name in names if name and not name.startswith(("__", "#"))]
    for name in wanted:
        if name not in found:
            raise MeasurementError(f"{path}: no variable {name}, found {listing(found)}")


def _from_npz(archive: Any, name: str, path: Path) -> NDArray[Any]:
    try:
        array: NDArray[Any] = archive[name]
    except ValueError as error:
        if "allow_pickle" not in str(error):
            raise
        raise MeasurementError(
            f"{path}: {name}: holds pickled objects, which are not loaded, expected real numbers"
        ) from error
    return array


def _from_hdf5(item: Any, where: str) -> NDArray[Any]:
    import h5py

    matlab_class = item.attrs.get("MATLAB_class", b"")
    name = matlab_class.decode() if isinstance(matlab_class, bytes) else str(matlab_class)
    if not isinstance(item, h5py.Dataset) or name in {"char", "logical", "cell", "struct", "function_handle"}:
        raise MeasurementError(f"{where}: holds a MATLAB {name or 'struct'}, expected an array of real numbers")
    if "MATLAB_empty" in item.attrs:  # the dataset then holds the shape instead of the values
        return np.empty([int(length) for length in item[()]])
    # MATLAB stores columns first and HDF5 names the axes of the bytes as they lie, so they come out reversed.
    return np.ascontiguousarray(np.transpose(item[()]))
