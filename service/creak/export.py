"""What a recording holds as files of other programs: CSV, MAT and UFF 58, which ``creak import`` reads back."""

import csv
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from creak import codec
from creak.errors import InputError
from creak.notebook import QUANTITIES, Experiment, Levels, OpenedRecording
from creak.records import Real, Rig

_MAT_BYTES = 2**31 - 1  # of one variable, by the format
_SPECIFIC_TYPES = {"N": 13, "m": 8, "m/s": 11, "m/s^2": 12}  # of dataset 58: force, displacement, ...
_GENERAL = 1
_LABEL = 20  # characters of a unit in dataset 58


def write_csv(path: Path, experiment: Experiment, recording: OpenedRecording) -> None:
    """Write one experiment as a table: time in s from its first sample, inputs, responses; every bit is kept."""
    channels = _channels(experiment, recording.rig)
    samples = len(channels[0][2])
    columns = [np.arange(samples) / recording.rig.sample_rate, *(values for _, _, values in channels)]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(
            ["time [s]", *(f"{label} [{unit}]" for label, unit, _ in channels)]
        )
        np.savetxt(file, np.column_stack(columns), delimiter=",", fmt="%.17g")


def write_uff(path: Path, experiment: Experiment, recording: OpenedRecording) -> None:
    """Write one experiment as universal file datasets 58 (binary, double), beside a dataset 164 that says SI.

    A lost transient period is written as zeros: pyuff writes no NaN.
    """
    import pyuff

    rig = recording.rig
    nodes = {node.name: number for number, node in enumerate(rig.nodes, start=1)}
    sets: list[dict[str, Any]] = [
        pyuff.prepare_164(
            units_code=1,
            units_description="SI",
            temp_mode=1,
            length=1.0,
            force=1.0,
            temp=1.0,
            temp_offset=273.15,
        )
    ]
    for label, unit, values in _channels(experiment, rig):
        sets.append(
            pyuff.prepare_58(
                binary=1,
                func_type=1,
                id1=label,
                id2=rig.name,
                id3=str(experiment.times[0]),
                id4=f"realisation {experiment.realisation} experiment {experiment.experiment}",
                rsp_node=nodes[label[2:]],
                rsp_dir=0,
                ref_node=0,
                ref_dir=0,
                data=values,
                x=np.arange(len(values)) / rig.sample_rate,
                abscissa_spacing=1,
                abscissa_spec_data_type=17,
                ordinate_spec_data_type=_SPECIFIC_TYPES.get(unit, _GENERAL),
                ordinate_axis_units_lab=unit if len(unit) <= _LABEL else "NONE",
                orddenom_spec_data_type=0,
            )
        )
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):  # pyuff leaves binary files open
        pyuff.UFF(str(path)).write_sets(sets, "overwrite")


def write_mat(path: Path, experiments: Sequence[Experiment], recording: OpenedRecording) -> None:
    """Write experiments as MATLAB's version 5: ``u`` and ``y``, and with them the rig, levels and alarms.

    Raises
    ------
    InputError
        If a variable would be larger than the format allows.
    """
    import scipy.io

    u, y = (np.stack([_joined(getattr(e, name)) for e in experiments]) for name in ("u", "y"))
    if max(u.nbytes, y.nbytes) > _MAT_BYTES:
        raise InputError(
            f"{path.name}: {max(u.nbytes, y.nbytes)} bytes in one variable, a MAT file takes {_MAT_BYTES}; "
            "choose a stretch with --first-realisation and --last-realisation"
        )
    rig, levels = recording.rig, recording.levels
    about = {
        "rig": rig.name,
        "sample_rate": rig.sample_rate,
        "period_samples": rig.period_samples,
        "transient_periods": rig.transient_periods,
        "lines": np.asarray(rig.lines),
        "frequencies": rig.frequencies,
        "nodes": _cells([node.name for node in rig.nodes]),
        "output_units": _cells([node.output for node in rig.nodes]),
        "inputs": _cells([rig.nodes[i].name for i in rig.driven]),
        "realisations": np.array([e.realisation for e in experiments]),
        "times": _seconds(np.array([e.times[0] for e in experiments])),
        "levels": {"times": _seconds(levels.times), "realisations": levels.realisations, **levels.values},
        "alarms": _cells([f"{codec.time_json(c.time)} {codec.alarm_line(c)}" for c in recording.alarms]),
    }
    with path.open("wb") as file:
        scipy.io.savemat(file, {"u": u, "y": y, **about}, do_compression=True)


def write_levels(path: Path, levels: Levels) -> None:
    """Write live levels as a table, a row each window and node; a quantity that is not known is left empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["time", "realisation", "node", *QUANTITIES])
        for w, (time, realisation) in enumerate(zip(levels.times, levels.realisations, strict=True)):
            for n, node in enumerate(levels.nodes):
                values = (levels[quantity][w, n] for quantity in QUANTITIES)
                shown = ("" if np.isnan(value) else repr(float(value)) for value in values)
                rows.writerow([codec.time_json(int(time.astype(np.int64))), realisation, node, *shown])


def _channels(experiment: Experiment, rig: Rig) -> list[tuple[str, str, Real]]:
    """Label, unit and samples of every channel, inputs first, named as ``creak import`` reads them."""
    inputs = [(f"u:{rig.nodes[i].name}", str(rig.nodes[i].input)) for i in rig.driven]
    responses = [(f"y:{node.name}", node.output) for node in rig.nodes]
    values = (*_joined(experiment.u), *_joined(experiment.y))
    return [(label, unit, row) for (label, unit), row in zip((*inputs, *responses), values, strict=True)]


def _joined(periods: Real) -> Real:
    """``(periods, channel, N)`` as ``(channel, periods N)``."""
    return np.ascontiguousarray(np.moveaxis(periods, 0, 1)).reshape(periods.shape[1], -1)


def _seconds(times: Any) -> Real:
    """Seconds since the Unix epoch; NaN of a period that never came."""
    return np.where(np.isnat(times), np.nan, times.astype(np.int64) / 1e9)


def _cells(texts: Sequence[str]) -> Any:
    """A cell array of MATLAB."""
    cells = np.empty(len(texts), dtype=object)
    cells[:] = texts
    return cells
