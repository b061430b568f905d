"""One clear line from what pydantic found wrong."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from creak.errors import ConfigurationError

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
    key = key_path(found["loc"])
    more = f" (and {len(error.errors()) - 1} more)" if len(error.errors()) > 1 else ""
    if found["type"] == "missing":
        return ConfigurationError(source, key, f"is missing{more}")
    if found["type"] == "extra_forbidden":
        return ConfigurationError(source, key, f"is not a known key{more}")
    value = repr(found["input"])
    if len(value) > _SHOWN:
        value = value[:_SHOWN] + "…"
    message = found["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    if found["type"] != "value_error":
        message = f"{value} is not allowed: should be {message}"
    return ConfigurationError(source, key, message + more)
