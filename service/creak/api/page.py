"""The page at ``/``, served from the package: no script, style or picture from elsewhere."""

from importlib.resources import files

from fastapi import APIRouter
from fastapi.responses import HTMLResponse, Response

router = APIRouter(include_in_schema=False)

_FILES = files("creak.api") / "static"


@router.get("/", response_class=HTMLResponse)
async def page() -> HTMLResponse:
    """Rigs, nodes and alarms for a person."""
    return HTMLResponse(_read("index.html"))


@router.get("/static/page.css")
async def style() -> Response:
    """Return the page's style."""
    return Response(_read("page.css"), media_type="text/css")


@router.get("/static/page.js")
async def script() -> Response:
    """Return the page's script."""
    return Response(_read("page.js"), media_type="text/javascript")


def _read(name: str) -> str:
    return (_FILES / name).read_text(encoding="utf-8")
