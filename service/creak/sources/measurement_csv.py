"""Measurements as tables: CSV, one experiment a file."""

import csv
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from creak.errors import MeasurementError
from creak.records import Real, Rig
from creak.sources.measurement_channels import channel_of, check_time, require_channels, stack
from creak.sources.measurement_checks import shown

_TIME = re.compile(r"(?:time|t)\s*(?:[\[(]\s*(?P<unit>.*?)\s*[\])])?", re.IGNORECASE)

_Rows = Sequence[tuple[int, str]]  # number and text of every line that counts


def read_csv(path: Path, rig: Rig) -> tuple[Real, Real]:
    """Read one experiment from a table whose header row names the channels.

    Comma, semicolon or tab separate the columns; with the last two a decimal comma is understood. Blank lines and
    lines that begin with ``#`` are skipped. A column ``time`` or ``t``, in seconds, is checked against the rig's
    sample rate. Columns of other names are left alone.

    Returns
    -------
    u : array, (q, T)
    y : array, (n, T)

    Raises
    ------
    MeasurementError
        Naming the column, or the line and the column, that cannot be used.
    """
    with path.open(encoding="utf-8-sig") as file:
        rows = [(number, line) for number, line in enumerate(file, 1) if line.strip() and not line.startswith("#")]
    if len(rows) < 2:
        raise MeasurementError(f"{path}: {len(rows)} rows, expected a header row and samples")
    (_, header), *body = rows
    # More columns mean the right delimiter: none of the three is at home in the name of a channel.
    delimiter = max(",;\t", key=lambda candidate: len(_cells(header, candidate)))
    columns = _columns(_cells(header, delimiter), rig, path)
    if delimiter != ",":
        body = [(number, line.replace(",", ".")) for number, line in body]
    table = _numbers(body, columns, delimiter, path)
    if "time" in table:
        check_time(table["time"], rig, f"{path}: column time")
    return stack(table, rig, str(path))


def _cells(line: str, delimiter: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter))]


def _columns(cells: Sequence[str], rig: Rig, path: Path) -> dict[str, int]:
    """Return the indices of the columns that are used, by channel, and of ``time`` if it is there."""
    columns: dict[str, int] = {}
    for index, cell in enumerate(cells):
        where = f"{path}: column {shown(cell)}"
        time = _TIME.fullmatch(cell)
        if time and time["unit"] not in {None, "s"}:
            raise MeasurementError(f"{where}: unit {shown(time['unit'])}, expected s")
        name = "time" if time else channel_of(cell, rig, where)
        if name in columns:
            raise MeasurementError(f"{where}: is there twice")
        if name is not None:
            columns[name] = index
    require_channels(columns, rig, str(path), cells)
    return columns


def _numbers(body: _Rows, columns: Mapping[str, int], delimiter: str, path: Path) -> dict[str, Real]:
    try:
        table = np.loadtxt(
            [line for _, line in body],
            delimiter=delimiter,
            usecols=list(columns.values()),
            quotechar='"',
            comments=None,
            ndmin=2,
            unpack=True,
        )
    except ValueError as error:
        raise MeasurementError(_fault(body, columns, delimiter, path) or f"{path}: {error}") from error
    return dict(zip(columns, table, strict=True))


def _fault(body: _Rows, columns: Mapping[str, int], delimiter: str, path: Path) -> str | None:
    """Find the first cell that is no number, slowly, and say where it stands."""
    for number, line in body:
        cells = _cells(line, delimiter)
        for name, index in columns.items():
            if index >= len(cells):
                return f"{path}: line {number}: {len(cells)} cells, expected one for the column {name}"
            try:
                float(cells[index])
            except ValueError:
                return f"{path}: line {number}: {name}: {cells[index]!r} is no real number"
    return None
