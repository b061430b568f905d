"""The page at ``/`` and its parts, served from packages: no script, style or picture from elsewhere.

The parts lie under a path that holds a digest of them all, so browsers keep them for good and a newer version of
the page never meets parts of an older one. Charts are drawn by uPlot, whose script the package `youplot` carries.
"""

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Header
from fastapi.responses import Response

from creak.api.problems import ProblemError

router = APIRouter(include_in_schema=False)

_TYPES = {".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_CHARTS = {"uplot.js": "vendor/uplot.iife.min.js", "uplot.css": "vendor/uplot.min.css"}


@dataclass(frozen=True)
class Site:
    """The page, and its parts by name; ``version`` stands for all of their content."""

    index: bytes
    parts: Mapping[str, bytes]
    version: str


@cache
def site() -> Site:
    """Read the page from the installed packages, once."""
    folder = Path(str(files("creak.api") / "static"))
    parts = dict(_own(folder) | _charts())
    index = (folder / "index.html").read_text(encoding="utf-8")
    digest = hashlib.sha256(index.encode())
    for name, content in sorted(parts.items()):
        digest.update(f"{name} {len(content)} ".encode() + content)
    version = digest.hexdigest()[:16]
    return Site(index.replace("{version}", version).encode(), parts, version)


@router.get("/")
async def page(if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """Fleet, rigs, nodes, alarms, recordings and diagnoses for a person."""
    found = site()
    return _cached(found.index, "text/html; charset=utf-8", found.version, "no-cache", if_none_match)


@router.get("/static/{version}/{name:path}")
async def part(version: str, name: str, if_none_match: Annotated[str | None, Header()] = None) -> Response:
    """Return a part of the page; of another version of it there is none."""
    found = site()
    if version != found.version or name not in found.parts:
        raise ProblemError(404, "not-found", "Not Found", f"the page has no part {name!r} of version {version!r}")
    kind = _TYPES[Path(name).suffix]
    kept = "public, max-age=31536000, immutable"
    return _cached(found.parts[name], kind, found.version, kept, if_none_match)


def _cached(content: bytes, kind: str, version: str, kept: str, if_none_match: str | None) -> Response:
    tag = f'"{version}"'
    headers = {"ETag": tag, "Cache-Control": kept}
    if if_none_match is not None and tag in if_none_match:
        return Response(status_code=304, headers=headers, media_type=kind)  # which the policy hangs on
    return Response(content, media_type=kind, headers=headers)


def _own(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in _files(folder)}


def _files(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if path.suffix in _TYPES)


def _charts() -> dict[str, bytes]:
    """Return the script and the style of uPlot, without running the package that carries them."""
    spec = find_spec("youplot")
    assert spec is not None
    assert spec.submodule_search_locations is not None
    folder = Path(spec.submodule_search_locations[0])
    return {name: (folder / path).read_bytes() for name, path in _CHARTS.items()}
