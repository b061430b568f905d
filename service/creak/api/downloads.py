"""The route from which recordings are downloaded, whole or in part."""

import os
import re
from collections.abc import Iterator
from email.utils import formatdate
from pathlib import Path as FilePath
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import APIRouter, Header, Path, Response
from fastapi.responses import StreamingResponse
from pydantic import AfterValidator

from creak.api.describe import StoreOf, plain_name, refusals
from creak.api.problems import ProblemError
from creak.sinks.diagnosable import of_recording

router = APIRouter(tags=["recordings"])

_CHUNK = 262_144
_MEDIA_TYPE = "application/octet-stream"
_RANGE = re.compile(r"bytes=(?:(\d{1,18})-(\d{1,18})?|-(\d{1,18}))")
_BINARY: dict[str, Any] = {
    "content": {_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}, "example": "\x89MCAP0\r\n..."}}
}


def byte_range(header: str | None, size: int) -> tuple[int, int] | None:
    """Return the half-open range of bytes that a ``Range`` header asks for (RFC 9110, section 14).

    Returns
    -------
    (int, int) or None
        None for the whole file: no header, or one that may be ignored (another unit, several ranges, malformed).

    Raises
    ------
    ProblemError
        If the range lies outside the file.
    """
    found = None if header is None else _RANGE.fullmatch(header.strip().lower())
    if found is None:
        return None
    first, last, tail = found.groups()
    if tail is not None:
        start, stop = max(0, size - int(tail)), size
    else:
        start, stop = int(first), size if last is None else min(int(last) + 1, size)
        if last is not None and int(last) < start:
            return None
    if start >= stop:
        headers = {"Content-Range": f"bytes */{size}"}
        raise ProblemError(416, "no-such-range", "No such range", f"the file has {size} bytes", headers=headers)
    return start, stop


@router.get(
    "/recordings/{recording}/file",
    response_class=StreamingResponse,
    responses={
        200: {"description": "The file (MCAP).", **_BINARY},
        206: {"description": "The part of it that was asked for.", **_BINARY},
        **refusals(404, 410, 416, 422),
    },
)
def download_recording(
    store: StoreOf,
    recording: Annotated[str, Path(description="Id of the recording."), AfterValidator(plain_name)],
    wanted: Annotated[
        str | None, Header(alias="range", max_length=200, description="One range of bytes, to resume a download.")
    ] = None,
    if_range: Annotated[str | None, Header(max_length=200, description="`ETag` of the part one has.")] = None,
) -> Response:
    """Download a recording. One that is still written comes as far as it has reached the disk, and can be read."""
    with store.read() as connection:
        found = of_recording(connection, recording)
    if found is None:
        raise ProblemError(404, "unknown-recording", "Unknown recording", f"there is no recording {recording!r}")
    path = FilePath(found.files[0])
    try:
        state = os.stat(path)
    except OSError:
        raise ProblemError(
            410, "recording-gone", "Recording gone", f"the file {path.name} is no longer there"
        ) from None
    size = state.st_size
    tag = f'"{state.st_mtime_ns:x}-{size:x}"'
    part = byte_range(wanted, size) if if_range in {None, tag} else None
    start, stop = part or (0, size)
    headers = {
        "Accept-Ranges": "bytes",
        "Content-Disposition": f"attachment; filename*=UTF-8''{quote(path.name, safe='')}",
        "Content-Length": str(stop - start),
        "ETag": tag,
        "Last-Modified": formatdate(state.st_mtime, usegmt=True),
    }
    if part is not None:
        headers["Content-Range"] = f"bytes {start}-{stop - 1}/{size}"
    return StreamingResponse(
        _pieces(path, start, stop - start), 200 if part is None else 206, headers, media_type=_MEDIA_TYPE
    )


def _pieces(path: FilePath, start: int, count: int) -> Iterator[bytes]:
    """Read so many bytes and no more: the file may grow meanwhile."""
    with path.open("rb") as file:
        file.seek(start)
        while count > 0 and (piece := file.read(min(_CHUNK, count))):
            count -= len(piece)
            yield piece
