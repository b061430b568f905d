"""Reading measurements: every file format, and every refusal that belongs to a format."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
import pyuff
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from creak.errors import MeasurementError
from creak.records import Node
from creak.sources.measurement import read_excitation, read_measurement
from measured import (
    FORMATS,
    dataset58,
    make_rig,
    measure,
    refusal,
    write_csv,
    write_npz,
    write_sets,
)

RIG = make_rig()
U, Y = measure(RIG, realisations=2)

in_tmp_path = settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])


@st.composite
def measurements(draw):
    """A rig and a measurement on it."""
    q = draw(st.integers(1, 3))
    rig = make_rig(q, q + draw(st.integers(0, 2)), transient=draw(st.integers(0, 1)))
    periods = rig.transient_periods + draw(st.integers(1, 3))
    return rig, *measure(rig, realisations=draw(st.integers(1, 2)), periods=periods, seed=draw(st.integers(0, 99)))


@pytest.mark.parametrize("form", FORMATS)
@in_tmp_path
@given(measurement=measurements())
def test_every_format_gives_the_arrays_back(form, tmp_path, measurement):
    # Kills swapped axes (HDF5's reversed order), dropped axes of one input or one experiment, channels in the
    # file's order instead of the rig's, and lost digits.
    suffix, write, tolerance = FORMATS[form]
    rig, u, y = measurement
    files = write(tmp_path / f"m{suffix}", u, y, rig)
    got_u, got_y = read_measurement(files, rig)
    for got, array in ((got_u, u), (got_y, y)):
        assert got.shape == array.shape
        assert got.dtype == np.float64
        np.testing.assert_allclose(got, array, rtol=tolerance, atol=0)


@pytest.mark.parametrize("form", ["npz", "mat-5", "mat-7.3"])
def test_dropped_axes_and_other_number_types_are_understood(form, tmp_path):
    # Kills a reader that needs three axes where squeeze has left fewer, or float64 in the file.
    suffix, write, _ = FORMATS[form]
    rig = make_rig(q=1, n=2)
    u, y = (np.round(100 * a).astype(np.int16) for a in measure(rig))
    got_u, got_y = read_measurement(write(tmp_path / f"m{suffix}", u[0], y[0].astype(np.float32), rig), rig)
    np.testing.assert_array_equal(got_u, u)
    np.testing.assert_array_equal(got_y, y)
    assert got_u.dtype == got_y.dtype == np.float64


def test_matlab_types_that_are_no_numbers_are_refused(tmp_path):
    # Kills samples made of MATLAB's character codes, of the shape that it stores for no samples, or of real parts.
    path = tmp_path / "m.mat"

    def refused(value, **attributes):
        with h5py.File(path, "w") as file:
            file["y"] = Y.T
            if value is None:
                file.create_group("u")
            else:
                file["u"] = value
            for name, attribute in attributes.items():
                file["u"].attrs[name] = attribute
        return refusal([path], RIG)

    assert "u: holds a MATLAB char" in refused(np.full(U.T.shape, 65, "u2"), MATLAB_class=np.bytes_("char"))
    assert "u: holds a MATLAB struct" in refused(None, MATLAB_class=np.bytes_("struct"))
    assert "u: shape (0, 0)" in refused(np.zeros(2, "u8"), MATLAB_class=np.bytes_("double"), MATLAB_empty=1)
    pairs = np.zeros(U.T.shape, dtype=[("real", "f8"), ("imag", "f8")])
    assert "u: holds complex numbers" in refused(pairs, MATLAB_class=np.bytes_("double"))


def test_pickled_objects_are_not_loaded(tmp_path):
    # Kills allow_pickle=True, which would run code of the file's choosing.
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    path = tmp_path / "m.npz"
    np.savez(path, u=np.array([Trap()], dtype=object), y=Y)
    assert "u: holds pickled objects" in refusal([path], RIG)
    assert not (tmp_path / "sprung").exists()


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".csv", ".uff"])
@pytest.mark.parametrize("content", [None, b"", b"MATLAB 5.0 MAT-file" + bytes(range(256)), b"    -1\n    58\n"])
def test_unreadable_files_are_refused(suffix, content, tmp_path):
    # Kills tracebacks of zipfile, scipy and pyuff on missing, empty and garbled files.
    path = tmp_path / f"m{suffix}"
    if content is not None:
        path.write_bytes(content)
    text = refusal([path], RIG)
    assert text.startswith(str(path))
    assert content is not None or "No such file" in text


@pytest.mark.parametrize("form", FORMATS)
@in_tmp_path
@given(data=st.data())
def test_a_cut_file_is_refused_or_read_in_full(form, tmp_path, data):
    # Kills a half-read measurement: what a cut leaves is either all of it or refused.
    suffix, write, tolerance = FORMATS[form]
    rig = make_rig(q=1, n=1)
    u, y = measure(rig, periods=2)
    (path,) = write(tmp_path / f"m{suffix}", u, y, rig)
    content = path.read_bytes()
    path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    refused = None
    try:
        got_u, got_y = read_measurement([path], rig)
    except MeasurementError as error:
        refused = str(error)
    if refused is not None:
        assert "\n" not in refused
    elif "csv" in form:  # a table has no end mark: the last digits may be gone
        assert got_y.shape == y.shape
    else:
        np.testing.assert_allclose(got_u, u, rtol=tolerance)
        np.testing.assert_allclose(got_y, y, rtol=tolerance)


@pytest.mark.parametrize("form", FORMATS)
@in_tmp_path
@given(data=st.data())
def test_a_flipped_byte_is_refused_in_one_line_or_harmless(form, tmp_path, data):
    # Kills tracebacks, and ends of the process: scipy's MAT reader crashes on a damaged data type code.
    suffix, write, _ = FORMATS[form]
    rig = make_rig(q=1, n=1)
    (path,) = write(tmp_path / f"m{suffix}", *measure(rig, periods=2), rig)
    content = bytearray(path.read_bytes())
    content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    try:
        u, y = read_measurement([path], rig)
    except MeasurementError as error:
        text = str(error)
    else:
        text = ""
        assert u.shape == y.shape == (1, 1, 32)
        assert np.isfinite(u).all()
        assert np.isfinite(y).all()
    assert "\n" not in text


@pytest.mark.parametrize("form", ["npz", "mat-5", "mat-7.3"])
def test_an_excitation_is_read_from_what_a_measurement_is_read_from(form, tmp_path):
    # Kills a file that MATLAB has saved again in its newer format, and one damaged byte that ends the process.
    suffix, write, _ = FORMATS[form]
    (path,) = write(tmp_path / f"plan{suffix}", U, Y, RIG)
    np.testing.assert_array_equal(read_excitation(path), U)
    with pytest.raises(MeasurementError, match=r"plan\.csv: an excitation is read from"):
        read_excitation(path.rename(tmp_path / "plan.csv"))


def test_a_damaged_excitation_is_one_line(tmp_path):
    # Kills an end of the process in scipy's reader, which takes a wrong data type code for an index.
    path = tmp_path / "plan.mat"
    scipy.io.savemat(path, {"u": U})
    content = bytearray(path.read_bytes())
    at = content.index(b"u\0\0\0") + 4  # the tag of the samples
    content[at : at + 4] = (1000).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(MeasurementError, match=r"plan\.mat: u"):
        read_excitation(path)


def test_the_choice_of_files_is_checked(tmp_path):
    npz = write_npz(tmp_path / "m.npz", U, Y, RIG)[0]
    assert "suffix .txt, expected one of .npz, .mat, .csv, .uff, .unv" in refusal([tmp_path / "m.txt"], RIG)
    assert "single NPZ or MAT file" in refusal([npz, npz], RIG)
    assert "no file given" in refusal([], RIG)
    files = write_csv(tmp_path / "m.csv", U, Y, RIG)
    short = write_csv(tmp_path / "short.csv", U[..., :32], Y[..., :32], RIG)
    text = refusal([files[0], short[1]], RIG)
    assert text.startswith(str(short[1]))
    assert "32 samples, expected 48" in text
    lost = Y.copy()
    lost[2, 0, 7] = np.nan
    files = write_csv(tmp_path / "lost.csv", U, lost, RIG)
    assert refusal(files, RIG).startswith(str(files[2]))  # names the file of the experiment


HEADER = "time,u:1,u:2,y:1,y:2,y:3"
REFUSED_TABLES = {
    "channel": ("time,u:1,u:2,y:1,y:2,y:3rd\n0,1,2,3,4,5\n", ["no channel y:3", "y:3rd"]),
    "twice": (HEADER + ",y:1\n0,1,2,3,4,5,6\n", ["column y:1: is there twice"]),
    "unit": ("u:1 [V],u:2,y:1,y:2,y:3\n1,2,3,4,5\n", ["column u:1 [V]: unit V, expected N"]),
    "milliseconds": ("time [ms]" + HEADER[4:] + "\n0,1,2,3,4,5\n", ["unit ms, expected s"]),
    "number": (HEADER + "\n0,1,2,3,4,5\n\n.01,1,2,three,4,5\n", ["line 4: y:1: 'three' is no real number"]),
    "complex": (HEADER + "\n0,1,2,3,4,1+2j\n", ["line 2: y:3: '1+2j'"]),
    "gap": (HEADER + "\n0,1,2,3,4,\n", ["line 2: y:3: ''"]),
    "cells": (HEADER + "\n0,1,2,3,4,5\n.01,1,2\n", ["line 3: 3 cells", "column y:1"]),
    "rate": (HEADER + "\n0,1,2,3,4,5\n.0101,1,2,3,4,5\n", ["time: sample rate 99.0099 Hz, expected 100 Hz"]),
    "lost": (HEADER + "\n0,1,2,3,4,5\n.01,1,2,3,4,5\n.04,1,2,3,4,5\n", ["3 sample periods after sample 1"]),
    "header": (HEADER + "\n", ["1 rows"]),
}


@pytest.mark.parametrize("case", REFUSED_TABLES)
def test_wrong_tables_are_refused_in_one_line(case, tmp_path):
    text, expected = REFUSED_TABLES[case]
    path = tmp_path / "m.csv"
    path.write_text(text)
    found = refusal([path], RIG)
    assert found.startswith(str(path))
    for part in expected:
        assert part in found


def test_universal_files_say_which_dataset_is_wrong(tmp_path):
    # Kills telling channels apart by their order, and silent acceptance of other units and rates.
    rig = make_rig(q=1, n=1, transient=0)
    data = np.random.default_rng(0).standard_normal(16)

    def write(name, *sets):
        return write_sets(tmp_path / name, *sets)

    force, motion = dataset58(data, 100.0, node=1, kind=13), dataset58(-data, 100.0, node=1, kind=8)
    frf = pyuff.prepare_58(
        binary=0, func_type=4, rsp_node=1, rsp_dir=3, ref_node=1, ref_dir=3, data=data + 0j, x=np.arange(16.0),
        abscissa_spacing=1, abscissa_spec_data_type=18, ordinate_spec_data_type=8, orddenom_spec_data_type=13,
    )  # fmt: skip
    si, mm = (
        pyuff.prepare_164(units_code=code, units_description="", temp_mode=1, length=length, force=1.0, temp=1.0,
                          temp_offset=0.0)
        for code, length in ((1, 1.0), (5, 1000.0))
    )  # fmt: skip
    u, y = read_measurement(write("good.uff", si, frf, motion, force), rig)
    np.testing.assert_array_equal(y, -u)

    dofs = replace(rig, nodes=(Node("1:+Z", "m", "N"),))  # a rig may name degrees of freedom
    np.testing.assert_array_equal(read_measurement([tmp_path / "good.uff"], dofs)[0], u)

    assert "dataset 1: units" in refusal(write("mm.uff", mm, motion, force), rig)
    assert "no channel u:1, found NONE (1:+Z, data type 8)" in refusal(write("only.uff", motion), rig)
    assert "dataset 3: u:1: is there twice" in refusal(write("twice.uff", motion, force, force), rig)
    other = dataset58(data, 100.0, node=1, kind=12)
    assert "y:1: data type 12 (m/s^2), expected m" in refusal(write("kind.uff", force, other), rig)
    pounds = dataset58(data, 100.0, node=1, kind=13, unit="lbf")
    assert "u:1: unit lbf, expected N" in refusal(write("unit.uff", pounds, motion), rig)
    slow = dataset58(data, 50.0, node=1, kind=8)
    assert "y:1: time" in refusal(write("rate.uff", force, slow), rig)
