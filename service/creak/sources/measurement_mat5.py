"""A look at the headers of a MAT file of version 5 before scipy reads it.

scipy's reader uses the data type codes of the file as indices into a table of pointers without checking them
(scipy/scipy#25829), so that one damaged byte ends the process instead of raising. Here the headers of the
variables that are to be read are checked first; the layout is that of MathWorks' "MAT-File Format".
"""

import struct
import zlib
from collections.abc import Collection, Iterator
from pathlib import Path

from creak.errors import MeasurementError

_COMPRESSED, _MATRIX = 15, 14
_NUMBERS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13}  # codes of element types that hold integers or floating-point numbers
_CLASSES = {1: "cell array", 2: "struct", 3: "object", 4: "char array", 5: "sparse matrix"}
_NUMERIC_CLASSES = range(6, 16)
_OPAQUE = 17  # has no dimensions, and its name is not that of the variable
_LOGICAL, _COMPLEX = 0x0200, 0x0800
_HEADER = 4096  # bytes that hold flags, dimensions, name and the tag of the samples


def check_mat5(path: Path, wanted: Collection[str]) -> list[str]:
    """Check the headers of the wanted variables and return the names of all.

    Raises
    ------
    MeasurementError
        If the file is no MAT file of version 5, or a wanted variable is no full, real, numeric array.
    """
    names = []
    for body, order in _matrices(path):
        elements = _elements(body, order)
        flags = struct.unpack_from(order + "I", next(elements)[1])[0]
        matlab_class = flags & 0xFF
        if matlab_class == _OPAQUE:
            continue
        next(elements)  # dimensions
        name = next(elements)[1].decode("utf-8", errors="replace")
        names.append(name)
        if name not in wanted:
            continue
        where = f"{path}: {name}"
        if matlab_class not in _NUMERIC_CLASSES or flags & _LOGICAL:
            kind = "logical array" if flags & _LOGICAL else _CLASSES.get(matlab_class, f"class {matlab_class}")
            raise MeasurementError(f"{where}: holds a MATLAB {kind}, expected an array of real numbers")
        if flags & _COMPLEX:
            raise MeasurementError(f"{where}: holds complex numbers, expected real samples in time")
        code = next(elements)[0]
        if code not in _NUMBERS:
            raise MeasurementError(f"{where}: is damaged, data type code {code}")
    return names


def _matrices(path: Path) -> Iterator[tuple[bytes, str]]:
    """Yield the first bytes of every variable, and the byte order of the file."""
    with path.open("rb") as file:
        order = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}.get(file.read(128)[124:])
        if order is None:
            raise MeasurementError(f"{path}: is no MAT file, expected MATLAB's version 5 or 7.3")
        while len(tag := file.read(8)) == 8:
            code, size = struct.unpack(order + "2I", tag)
            start = file.tell()
            body = file.read(min(size, _HEADER))
            if code == _COMPRESSED:
                body = zlib.decompressobj().decompress(body, _HEADER)
                code, body = struct.unpack_from(order + "I", body)[0], body[8:]
            if code == _MATRIX:
                yield body, order
            file.seek(start + size)


def _elements(body: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type code and content of the elements of a variable; the last one may be cut."""
    at = 0
    while True:
        code, size = struct.unpack_from(order + "2I", body, at)
        if code >> 16:  # up to four bytes, beside their tag
            code, size = code & 0xFFFF, code >> 16
            yield code, body[at + 4 : at + 4 + size]
            at += 8
        else:
            yield code, body[at + 8 : at + 8 + size]
            at += 8 + (size + 7) // 8 * 8
