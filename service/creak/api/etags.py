"""Entity tags of alarms: the version that a client has seen, so that it does not act on what it has not."""

import re
from typing import Annotated

from fastapi import Header

from creak.api.problems import ProblemError, bad_parameter
from creak.records import AlarmChange

IF_MATCH = Annotated[
    str | None,
    Header(max_length=200, description="`ETag` of the alarm that the client has seen; another one is a 412."),
]
IF_NONE_MATCH = Annotated[
    str | None, Header(max_length=200, description="`ETag` that the client has; the same one is a 304.")
]

_TAGS = re.compile(r'\*|(?:W/)?"[\x21\x23-\x7e]*"(?:\s*,\s*(?:W/)?"[\x21\x23-\x7e]*")*')


def etag(change: AlarmChange) -> str:
    """Return the entity tag of an alarm: its versions count its changes."""
    return f'"{change.version}-{change.time:x}"'


def matches(header: str, change: AlarmChange, name: str) -> bool:
    """Tell whether a list of entity tags has that of an alarm; If-None-Match takes weak ones too."""
    text = header.strip()
    if not _TAGS.fullmatch(text):
        raise bad_parameter("header", name, 'no entity tag; for instance "3-18a2f" in its quotes, or *')
    own = etag(change)
    tags = re.findall(r'(?:W/)?"[^"]*"', text)
    return text == "*" or own in tags or (name == "if-none-match" and f"W/{own}" in tags)


def version_of(header: str, change: AlarmChange) -> int | None:
    """Return the version that a client insists on, None for any.

    Raises
    ------
    ProblemError
        If the alarm is not, or no longer, the one that the client has seen.
    """
    if not matches(header, change, "if-match"):
        detail = f"the alarm has changed: its ETag is {etag(change)}"
        raise ProblemError(412, "alarm-changed", "Alarm changed", detail)
    return None if header.strip() == "*" else change.version
