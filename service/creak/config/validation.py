"""One clear line from what pydantic found wrong."""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from creak.errors import ConfigurationError

_SUBJECT = re.compile(r"^\w+(?= should )\s*")  # of pydantic's sentences: Input, String, List
_SHOWN = 60  # characters of a wrong value that are worth repeating


def read_text(path: Path) -> str:
    """Text of a configuration file.

    Raises
    ------
    ConfigurationError
        If the file cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(str(path), "", f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(str(path), "", "is not UTF-8 text") from None


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Tables of a TOML text.

    Raises
    ------
    ConfigurationError
        If it is no TOML; the message names line and column.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(source, "", f"is not TOML: {error}") from None


def key_path(location: Sequence[int | str]) -> str:
    """Dotted key as a person would write it: ``nodes[2].output``."""
    path = ""
    for part in location:
        path += f"[{part}]" if isinstance(part, int) else f".{part}" if path else part
    return path


def explain(error: ValidationError, source: str) -> ConfigurationError:
    """Turn the first finding of pydantic into one line that names file, key, value and what is allowed."""
    found = error.errors()[0]
    location = found["loc"]
    if found["type"] == "union_tag_invalid":
        context = found["ctx"]
        key = key_path((*location, context["discriminator"].strip("'")))
        return ConfigurationError(
            source, key, f"{context['tag']!r} is not allowed: should be one of {context['expected_tags']}"
        )
    # of a source pydantic names the kind too, which stands in no file
    key = key_path([part for i, part in enumerate(location) if not i or location[i - 1] != "source"])
    more = f" (and {len(error.errors()) - 1} more)" if len(error.errors()) > 1 else ""
    if found["type"] == "missing":
        return ConfigurationError(source, key, f"is missing{more}")
    if found["type"] == "extra_forbidden":
        return ConfigurationError(source, key, f"is not a known key{more}")
    value = repr(found["input"])
    if len(value) > _SHOWN:
        value = value[:_SHOWN] + "…"
    message = found["msg"].removeprefix("Value error, ")
    if found["type"] != "value_error":
        message = f"{value} is not allowed: {_SUBJECT.sub('', message)}"
    return ConfigurationError(source, key, message + more)
