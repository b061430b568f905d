"""The audit log: who changed what through the API, and who was turned away."""

import time

import sqlalchemy as sa

from creak.sinks.operator_tables import audit

_KEPT = 100_000
_PRUNE_EVERY = 500


def note(connection: sa.Connection, who: str, address: str, method: str, path: str, status: int) -> None:
    """Add an entry."""
    row = {"who": who, "address": address, "method": method, "path": path[:2000], "status": status}
    key = connection.execute(sa.insert(audit).values(at=time.time_ns(), **row)).inserted_primary_key
    if key is not None and key[0] % _PRUNE_EVERY == 0:
        connection.execute(sa.delete(audit).where(audit.c.seq <= key[0] - _KEPT))


def page(connection: sa.Connection, after: int | None, limit: int) -> list[sa.RowMapping]:
    """Return entries, newest first."""
    query = sa.select(audit) if after is None else sa.select(audit).where(audit.c.seq < after)
    return list(connection.execute(query.order_by(audit.c.seq.desc()).limit(limit)).mappings())
