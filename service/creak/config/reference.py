"""Every key of ``creak.toml``, told from the models that read it, so that its description is never out of date."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from creak.config.service import PREFIX, ServiceSettings

_Schema = Mapping[str, Any]
_TYPES = {
    "string": "text",
    "integer": "whole number",
    "number": "number",
    "boolean": "true or false",
    "object": "table",
}
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


@dataclass(frozen=True)
class Key:
    """One key of the service file.

    Parameters
    ----------
    name : str
        With the tables it is in; ``[]`` stands for one of an array of tables, ``<name>`` for a name of one's own.
    environment : str
        Variable that overrides it; empty where an array stands between: that is overridden as a whole.
    kind : str
        Of the source that it belongs to; empty for all other keys.
    allowed : str
        What it may be.
    default : str
        As TOML has it; empty where it may be left out, ``required`` where it may not.
    meaning : str
    """

    name: str
    environment: str
    kind: str
    allowed: str
    default: str
    meaning: str


def service_keys() -> list[Key]:
    """All keys, in the order of the models."""
    schema = ServiceSettings.model_json_schema()
    return list(_table(schema, schema["$defs"], "", PREFIX, ""))


def markdown(keys: list[Key]) -> str:
    """One table of keys."""
    rows = ["| key | environment | allowed | default | meaning |", "|---|---|---|---|---|"]
    for key in keys:
        name = f"`{key.name}`" + (f" ({key.kind})" if key.kind else "")
        default = key.default if key.default in {"", "required"} else f"`{key.default}`"
        environment = f"`{key.environment}`" if key.environment else ""
        cells = (name, environment, key.allowed, default, key.meaning)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows) + "\n"


def _table(table: _Schema, defs: _Schema, before: str, variable: str, kind: str) -> Iterator[Key]:
    for name, schema in table["properties"].items():
        required = name in table.get("required", ())
        own = f"{variable}{name.upper()}" if variable else ""
        yield from _entry(f"{before}{name}", own, schema, defs, kind, required)


def _entry(name: str, variable: str, schema: _Schema, defs: _Schema, kind: str, required: bool) -> Iterator[Key]:
    inner = _resolved(schema, defs)
    if "discriminator" in inner:
        for told, reference in inner["discriminator"]["mapping"].items():
            yield from _table(defs[reference.rpartition("/")[2]], defs, f"{name}.", "", told)
        return
    if "properties" in inner:
        yield from _table(inner, defs, f"{name}.", f"{variable}__" if variable else "", kind)
        return
    default = "required" if required else _toml(schema.get("default"))
    yield Key(name, variable, kind, _allowed(inner, defs), default, schema.get("description", ""))
    items, more = (_resolved(inner.get(part) or {}, defs) for part in ("items", "additionalProperties"))
    if "properties" in items:
        yield from _table(items, defs, f"{name}[].", "", kind)
    if "properties" in more:
        yield from _table(more, defs, f"{name}.<name>.", "", kind)


def _resolved(schema: Any, defs: _Schema) -> _Schema:
    """The schema itself, where it refers to another or may be null."""
    if not isinstance(schema, Mapping):
        return {}
    if "$ref" in schema:
        return dict(defs[schema["$ref"].rpartition("/")[2]])
    options = [option for option in schema.get("anyOf", ()) if option.get("type") != "null"]
    return _resolved(options[0], defs) if len(options) == 1 else schema


def _allowed(schema: _Schema, defs: _Schema) -> str:
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return " or ".join(json.dumps(word) for word in schema["enum"])
    if "anyOf" in schema:
        return " or ".join(_allowed(option, defs) for option in schema["anyOf"] if option.get("type") != "null")
    if schema.get("type") == "array":
        return f"list of {_allowed(_resolved(schema['items'], defs), defs)}s"
    what = "path" if schema.get("format") == "path" else _TYPES[schema["type"]]
    bounds = [f"{sign} {schema[key]:g}" for key, sign in _BOUNDS.items() if key in schema]
    return " ".join((what, ", ".join(bounds))).strip()


def _toml(value: Any) -> str:
    return "" if value is None else json.dumps(value)
