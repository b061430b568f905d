"""The amplitude spectrum that a user wants an excitation to have."""

from pathlib import Path

import numpy as np

from creak.config.validation import read_text
from creak.errors import ConfigurationError
from creak.records import Real, Rig


def load_spectrum(path: Path, rig: Rig) -> Real:
    """Relative amplitudes at the excited lines from a CSV table.

    The header names the columns: ``frequency_hz``, and ``amplitude`` for all inputs alike or the name of every
    driven node. Between the given frequencies amplitudes are interpolated linearly. Lines that begin with ``#``
    are skipped.

    Parameters
    ----------
    path : Path
    rig : Rig

    Returns
    -------
    array, (q, F)
        All above 0; their scale has no meaning.

    Raises
    ------
    ConfigurationError
        One line that names file, column or row, and what is allowed.
    """
    source = str(path)
    rows = [
        (number, [cell.strip() for cell in line.split(",")])
        for number, line in enumerate(read_text(path).lstrip("\ufeff").splitlines(), 1)
        if line.strip() and not line.startswith("#")
    ]
    header = rows[0][1] if rows else []
    names = [rig.nodes[i].name for i in rig.driven]
    wanted = ["amplitude"] if "amplitude" in header else names
    for column in ("frequency_hz", *wanted):
        if header.count(column) != 1:
            raise ConfigurationError(
                source,
                column,
                f"no such column, or two; should be frequency_hz and either amplitude or {', '.join(names)}",
            )
    if len(rows) < 2:
        raise ConfigurationError(source, "", "holds no row below its header")
    table = np.array([_numbers(source, number, cells, header) for number, cells in rows[1:]])
    frequency = table[:, header.index("frequency_hz")]
    if (np.diff(frequency) <= 0).any():
        raise ConfigurationError(source, "frequency_hz", "should rise from row to row")
    low, high = rig.frequencies[[0, -1]]
    slack = 1e-9 * high
    if frequency[0] > low + slack or frequency[-1] < high - slack:
        raise ConfigurationError(
            source,
            "frequency_hz",
            f"{frequency[0]:g} to {frequency[-1]:g}; should span the excited lines, {low:g} to {high:g} Hz",
        )
    found = [np.interp(rig.frequencies, frequency, table[:, header.index(column)]) for column in wanted]
    for column, amplitudes in zip(wanted, found, strict=True):
        if not (amplitudes > 0).all():
            at = rig.frequencies[int(np.argmin(amplitudes > 0))]
            raise ConfigurationError(
                source,
                column,
                f"is not above 0 at {at:g} Hz, which the rig excites; leave the line out of the rig",
            )
    return np.array(np.broadcast_to(np.array(found), (rig.q, len(rig.lines))), dtype=np.float64)


def _numbers(source: str, number: int, cells: list[str], header: list[str]) -> list[float]:
    if len(cells) != len(header):
        raise ConfigurationError(source, f"line {number}", f"has {len(cells)} cells, should have {len(header)}")
    values = []
    for cell, column in zip(cells, header, strict=True):
        try:
            value = float(cell)
        except ValueError:
            value = np.nan
        if not 0 <= value < np.inf:
            raise ConfigurationError(source, f"line {number}, {column}", f"{cell!r} is not a number of at least 0")
        values.append(value)
    return values
