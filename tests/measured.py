"""Measurements of every file format, written as the programs that make such files write them."""

import warnings

import h5py
import numpy as np
import pytest
import pyuff
import scipy.io

from creak.errors import MeasurementError
from creak.records import Node, Rig
from creak.sources.measurement import read_measurement


def make_rig(q=2, n=3, *, transient=1, rate=100.0):
    """A rig of n nodes named 1, 2 ... of which the first q are driven, with periods of 16 samples."""
    nodes = tuple(Node(str(i + 1), "m", "N" if i < q else None) for i in range(n))
    return Rig("rig", rate, 16, transient, (1, 2, 3), nodes)


def measure(rig, *, realisations=1, periods=3, seed=0):
    """Random periodic inputs and responses; the experiments of a realisation are independent."""
    rng = np.random.default_rng(seed)
    u, y = (rng.standard_normal((realisations * rig.q, c, rig.period_samples)) for c in (rig.q, rig.n))
    return np.tile(u, periods), np.tile(y, periods)


def refusal(files, rig):
    """The one line with which reading is refused."""
    with pytest.raises(MeasurementError) as caught:
        read_measurement(files, rig)
    text = str(caught.value)
    assert "\n" not in text
    return text


def write_npz(path, u, y, _rig):
    np.savez(path, u=u, y=y)
    return [path]


def write_mat5(path, u, y, _rig):
    scipy.io.savemat(path, {"u": u, "y": y})
    return [path]


def write_mat7(path, u, y, _rig):
    scipy.io.savemat(path, {"u": u, "y": y}, do_compression=True)
    return [path]


def write_mat73(path, u, y, _rig):
    """MATLAB stores columns first, so HDF5 shows reversed axes; trailing axes of length one are dropped."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in (("u", u), ("y", y)):
            shape = array.shape
            while len(shape) > 2 and shape[-1] == 1:
                shape = shape[:-1]
            file[name] = np.atleast_2d(array.reshape(shape)).T
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    return [path]


def write_csv(path, u, y, rig, delimiter=","):
    """Full digits, a remark, a byte order mark; with another delimiter than the comma a decimal comma."""
    files = []
    inputs = [f"u:{rig.nodes[i].name}" for i in rig.driven]
    responses = [f"y:{node.name} [{node.output}]" for node in rig.nodes]
    for e in range(len(u)):
        table = np.column_stack([np.arange(u.shape[-1]) / rig.sample_rate, *u[e], *y[e]])
        lines = ["# a logger's remark", delimiter.join(["Time (s)", *inputs, *responses])]
        lines += [delimiter.join(repr(float(x)) for x in row) for row in table]
        text = "\n".join(lines) + "\n"
        file = path.with_stem(f"{path.stem}-{e}")
        file.write_text(text if delimiter == "," else text.replace(".", ","), encoding="utf-8-sig")
        files.append(file)
    return files


def dataset58(data, rate, *, node, kind, id1="NONE", unit="NONE", binary=0):
    """A time history in direction +Z; ``kind`` is the ordinate's specific data type."""
    return pyuff.prepare_58(
        binary=binary,
        func_type=1,
        id1=id1,
        rsp_node=node,
        rsp_dir=3,
        ref_node=0,
        ref_dir=0,
        data=data,
        x=np.arange(len(data)) / rate,
        abscissa_spacing=1,
        abscissa_spec_data_type=17,
        ordinate_spec_data_type=kind,
        ordinate_axis_units_lab=unit,
        orddenom_spec_data_type=0,
    )


def write_sets(path, *sets):
    path.unlink(missing_ok=True)
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):  # pyuff leaves binary files open
        pyuff.UFF(str(path)).write_sets(list(sets), "add")
    return [path]


def write_uff(path, u, y, rig, *, labels=False):
    """Channels told by labels in ASCII, or by data types and node numbers in binary; last channel first."""
    files = []
    for e in range(len(u)):
        sets = []
        for kind, prefix, rows, channels in ((13, "u", rig.driven, u[e]), (8, "y", range(rig.n), y[e])):
            for i, row in zip(rows, channels, strict=True):
                name = rig.nodes[i].name
                if labels:
                    sets.append(dataset58(row, rig.sample_rate, node=0, kind=0, id1=f"{prefix}:{name}"))
                else:
                    sets.append(dataset58(row, rig.sample_rate, node=int(name), kind=kind, binary=1))
        files += write_sets(path.with_stem(f"{path.stem}-{e}"), *reversed(sets))
    return files


FORMATS = {  # suffix, writer, relative precision
    "npz": (".npz", write_npz, 0.0),
    "mat-5": (".mat", write_mat5, 0.0),
    "mat-7": (".mat", write_mat7, 0.0),
    "mat-7.3": (".mat", write_mat73, 0.0),
    "csv": (".csv", write_csv, 0.0),
    "csv-decimal-comma": (".CSV", lambda *a: write_csv(*a, delimiter=";"), 0.0),
    "csv-tab": (".csv", lambda *a: write_csv(*a, delimiter="\t"), 0.0),
    "uff-binary": (".uff", write_uff, 0.0),
    "unv-ascii-labels": (".unv", lambda *a: write_uff(*a, labels=True), 1e-11),
}
