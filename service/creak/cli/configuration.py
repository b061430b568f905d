"""The command that tells every key of the service file."""

import json
from dataclasses import asdict
from typing import Annotated

import typer

from creak.config.reference import markdown, service_keys

_HEADING = """# Keys of creak.toml

Made by `creak configuration`. Paths count from the file. A variable of the environment wins over the file; lists
and tables are given to it as JSON (`CREAK_WEBHOOKS__ALLOW='["10.20.0.0/16"]'`). What stands in an array of tables
(`[]`) is overridden with the array, as a whole.

"""


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(configuration)


def configuration(
    *, as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False
) -> None:
    """List every key of a service file: its variable, what is allowed, its default, what it means.

    Example: `creak configuration --json`
    """
    keys = service_keys()
    if as_json:
        typer.echo(json.dumps([asdict(key) for key in keys], indent=1, ensure_ascii=False))
    else:
        typer.echo(_HEADING + markdown(keys), nl=False)
