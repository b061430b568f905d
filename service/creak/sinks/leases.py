"""Work that one process at a time may do: a row that its holder renews, and others may take once it is old."""

import os
import socket
import uuid

import sqlalchemy as sa

from creak.sinks.operator_tables import leases


def new_owner() -> str:
    """Return a name for the holder of a lease: host, process, and something unique."""
    return f"{socket.gethostname()}/{os.getpid()}/{uuid.uuid4().hex}"


def hold(connection: sa.Connection, name: str, owner: str, now: int, until: int) -> bool:
    """Take or renew a lease until a wall-clock time; False if somebody else holds it.

    A holder on this machine whose process is gone holds nothing any more, so a restart need not wait.
    """
    row = connection.execute(sa.select(leases).where(leases.c.name == name)).mappings().first()
    values = {"owner": owner, "until_at": until}
    if row is None:
        try:
            with connection.begin_nested():
                connection.execute(sa.insert(leases).values(name=name, **values))
        except sa.exc.IntegrityError:  # somebody was quicker
            return False
        return True
    if row["owner"] != owner and row["until_at"] > now and _alive(row["owner"]):
        return False
    taken = sa.update(leases).where(leases.c.name == name, leases.c.owner == row["owner"]).values(values)
    return bool(connection.execute(taken).rowcount)


def release(connection: sa.Connection, name: str, owner: str) -> None:
    """Give a lease back."""
    connection.execute(sa.delete(leases).where(leases.c.name == name, leases.c.owner == owner))


def _alive(owner: str) -> bool:
    host, _, rest = owner.partition("/")
    process = rest.partition("/")[0]
    if host != socket.gethostname() or not process.isdigit():
        return True  # not for us to say
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
