"""Keys of the API: 256 random bits, of which the store keeps a hash."""

import hashlib
import hmac
import secrets
import time
from dataclasses import dataclass
from enum import StrEnum

import sqlalchemy as sa

from creak.errors import InputError
from creak.sinks.operator_tables import keys

_PREFIX = "creak"


class KeyScope(StrEnum):
    """What a key allows, each with all before it."""

    READ = "read"
    OPERATE = "operate"  # acknowledge, shelve, start computations
    ADMIN = "admin"  # webhooks, the audit log

    def covers(self, needed: "KeyScope") -> bool:
        """Tell whether this scope is enough."""
        order = list(KeyScope)
        return order.index(self) >= order.index(needed)


@dataclass(frozen=True)
class Key:
    """A key as it is known: everything but its secret."""

    id: str
    name: str
    scope: KeyScope
    created_at: int


def add(connection: sa.Connection, name: str, scope: KeyScope) -> str:
    """Make a key; return it, this once.

    Raises
    ------
    InputError
        If there is a key of this name.
    """
    if connection.execute(sa.select(keys.c.id).where(keys.c.name == name)).first() is not None:
        raise InputError(f"there is a key {name!r} already; remove it first, or choose another name")
    identifier, secret = secrets.token_hex(8), secrets.token_urlsafe(32)
    connection.execute(
        sa.insert(keys).values(
            id=identifier, name=name, scope=scope.value, hash=_hash(secret), created_at=time.time_ns()
        )
    )
    return f"{_PREFIX}_{identifier}_{secret}"


def remove(connection: sa.Connection, name: str) -> bool:
    """Remove a key; False if there is none of this name."""
    return bool(connection.execute(sa.delete(keys).where(keys.c.name == name)).rowcount)


def everyone(connection: sa.Connection) -> list[Key]:
    """Return all keys by name."""
    return [_key(row) for row in connection.execute(sa.select(keys).order_by(keys.c.name)).mappings()]


def find(connection: sa.Connection, token: str) -> Key | None:
    """Return the key that a text is; None if it is none.

    The hash is compared in constant time, also for an id that does not exist. It needs no salt and no stretching:
    nobody can try 2^256 secrets.
    """
    prefix, _, rest = token.partition("_")
    identifier, _, secret = rest.partition("_")
    row = connection.execute(sa.select(keys).where(keys.c.id == identifier)).mappings().first()
    known = _hash("") if row is None else row["hash"]
    same = hmac.compare_digest(known, _hash(secret))
    return _key(row) if row is not None and same and prefix == _PREFIX else None


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def _key(row: sa.RowMapping) -> Key:
    return Key(row["id"], row["name"], KeyScope(row["scope"]), row["created_at"])
