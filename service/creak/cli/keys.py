"""Commands for the keys of the API."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from creak.config.service import load_service
from creak.errors import InputError
from creak.sinks import keys
from creak.sinks.database import Store, open_store
from creak.sinks.keys import KeyScope

Config = Annotated[Path, typer.Option("--config", help="Service file.")]
_LONGEST = 100


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    group = typer.Typer(
        name="key",
        help="Keys of the API, needed as soon as it listens beyond loopback.",
        no_args_is_help=True,
        rich_markup_mode="markdown",
    )
    group.command("add")(add)
    group.command("list")(show)
    group.command("remove")(remove)
    app.add_typer(group)


def add(
    name: Annotated[str, typer.Argument(help="Name, by which the audit log knows it.")],
    scope: Annotated[KeyScope, typer.Option(help="What it allows, each with all before it.")] = KeyScope.READ,
    config: Config = Path("creak.toml"),
) -> int:
    """Make a key and show it, this once.

    Example: `creak key add control-room --scope operate --config creak.toml`
    """
    if not name.isprintable() or not 0 < len(name) <= _LONGEST:
        raise InputError(
            f"{name!r} is not allowed as the name of a key: should be 1 to {_LONGEST} printable characters"
        )
    with _store(config) as store, store.write() as connection:
        token = keys.add(connection, name, scope)
    typer.echo(token)
    return 0


def show(config: Config = Path("creak.toml")) -> int:
    """List the names and scopes of all keys.

    Example: `creak key list --config creak.toml`
    """
    with _store(config) as store, store.read() as connection:
        for key in keys.everyone(connection):
            typer.echo(f"{key.scope.value:8}{key.name}")
    return 0


def remove(
    name: Annotated[str, typer.Argument(help="Name of the key.")], config: Config = Path("creak.toml")
) -> int:
    """Remove a key; a service that runs refuses it a few seconds later.

    Example: `creak key remove control-room --config creak.toml`
    """
    with _store(config) as store, store.write() as connection:
        if not keys.remove(connection, name):
            raise InputError(f"there is no key {name!r}")
    return 0


@contextmanager
def _store(config: Path) -> Iterator[Store]:
    settings = load_service(config)
    store = open_store(settings.store_url, source=str(config), key="store.url")
    try:
        yield store
    finally:
        store.close()
