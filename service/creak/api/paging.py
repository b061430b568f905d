"""Cursors: where a page of a list ended, opaque to the client and of use only with the same list and filters."""

import base64
import binascii
import hashlib
import json
from collections.abc import Sequence
from typing import Annotated, TypeVar

from fastapi import Query

from creak.api.problems import ProblemError, bad_parameter

Place = tuple[int | str, ...]
Kind = TypeVar("Kind", int, str)

Limit = Annotated[int, Query(ge=1, le=1000, description="How many items a page holds at most.")]
CursorText = Annotated[
    str | None, Query(alias="cursor", max_length=2000, description="`next` of the page before this one.")
]

_LARGEST = 2**63 - 1


def write_cursor(place: Place | None, of: Sequence[object]) -> str | None:
    """Return the cursor of the page that follows a place; None if no page follows.

    Parameters
    ----------
    place : tuple of int and str, or None
    of : sequence
        The list and its filters, which the cursor is to be used with.
    """
    if place is None:
        return None
    text = json.dumps([_digest(of), *place], ensure_ascii=False, separators=(",", ":"))
    return base64.urlsafe_b64encode(text.encode()).decode().rstrip("=")


def read_cursor(
    cursor: str | None, of: Sequence[object], kinds: tuple[type[Kind], ...]
) -> tuple[Kind, ...] | None:
    """Return the place that a cursor holds; None for no cursor.

    Raises
    ------
    ProblemError
        If it is no cursor of this list with these filters.
    """
    if cursor is None:
        return None
    try:
        text = base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True)
        parts = json.loads(text)
    except (ValueError, binascii.Error, RecursionError) as error:
        raise _refused() from error
    if not isinstance(parts, list) or len(parts) != len(kinds) + 1 or parts[0] != _digest(of):
        raise _refused()
    place = parts[1:]
    for value, kind in zip(place, kinds, strict=True):
        if type(value) is not kind or (isinstance(value, int) and not -_LARGEST <= value <= _LARGEST):
            raise _refused()
    return tuple(place)


def _refused() -> ProblemError:
    return bad_parameter("query", "cursor", "not a cursor of this list with these filters; begin without one")


def _digest(of: Sequence[object]) -> str:
    return hashlib.sha256(repr(list(of)).encode()).hexdigest()[:12]
