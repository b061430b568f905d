"""Receivers of webhooks as the store knows them."""

import time
import uuid
from dataclasses import dataclass
from typing import Literal

import sqlalchemy as sa

from creak.sinks.operator_tables import webhooks

Format = Literal["standard", "cloudevents"]


@dataclass(frozen=True)
class Receiver:
    """Where messages go.

    Parameters
    ----------
    id : str
    url : str
    events, rigs : tuple of str
        Types and rigs wanted; empty for all.
    format : str
        ``standard`` or ``cloudevents``.
    secret : str
        ``whsec_...``.
    created_at : int
        Wall clock, ns since the Unix epoch, as all times here.
    enabled : bool
    reason : str
        Why it is disabled.
    alarm : str or None
        Id of the alarm that tells that it is disabled.
    old_secret : str or None
        The secret before the last rotation; both sign until `old_secret_until_at`.
    failing_since_at : int or None
        First failure since the last success.
    paused_until_at : int
        The receiver asked to be left alone until then.
    seq : int
        Its place in lists.
    """

    id: str
    url: str
    events: tuple[str, ...]
    rigs: tuple[str, ...]
    format: Format
    secret: str
    created_at: int
    enabled: bool = True
    reason: str = ""
    alarm: str | None = None
    old_secret: str | None = None
    old_secret_until_at: int | None = None
    failing_since_at: int | None = None
    paused_until_at: int = 0
    seq: int = 0

    def wants(self, kind: str, rig: str) -> bool:
        """Tell whether a type of message about a rig is wanted."""
        group = kind.partition(".")[0] + ".*"
        return (not self.events or not {kind, group, "*"}.isdisjoint(self.events)) and (
            not self.rigs or not {rig, "*"}.isdisjoint(self.rigs)
        )

    def secrets(self, now: int) -> tuple[str, ...]:
        """Return the secrets that sign at a time, the newest first."""
        old = self.old_secret if self.old_secret_until_at is not None and now < self.old_secret_until_at else None
        return (self.secret,) if old is None else (self.secret, old)


def add(
    connection: sa.Connection,
    url: str,
    events: tuple[str, ...],
    rigs: tuple[str, ...],
    form: Format,
    secret: str,
) -> Receiver:
    """Add a receiver."""
    made = Receiver(f"wh_{uuid.uuid4().hex}", url, events, rigs, form, secret, time.time_ns())
    connection.execute(
        sa.insert(webhooks).values(
            id=made.id,
            url=url,
            events=list(events),
            rigs=list(rigs),
            format=form,
            secret=secret,
            created_at=made.created_at,
            enabled=True,
            reason="",
            paused_until_at=0,
        )
    )
    return made


def remove(connection: sa.Connection, identifier: str) -> bool:
    """Remove a receiver with its messages; False if there is none."""
    return bool(connection.execute(sa.delete(webhooks).where(webhooks.c.id == identifier)).rowcount)


def get(connection: sa.Connection, identifier: str) -> Receiver | None:
    """Return a receiver; None if there is none."""
    row = connection.execute(sa.select(webhooks).where(webhooks.c.id == identifier)).mappings().first()
    return None if row is None else _receiver(row)


def enabled(connection: sa.Connection) -> list[Receiver]:
    """Return all receivers that are not disabled."""
    return [_receiver(row) for row in connection.execute(sa.select(webhooks).where(webhooks.c.enabled)).mappings()]


def page(connection: sa.Connection, after: int | None, limit: int) -> list[Receiver]:
    """Return receivers in the order in which they were added."""
    query = sa.select(webhooks).order_by(webhooks.c.seq).limit(limit)
    if after is not None:
        query = query.where(webhooks.c.seq > after)
    return [_receiver(row) for row in connection.execute(query).mappings()]


def update(connection: sa.Connection, identifier: str, **values: object) -> None:
    """Change columns of a receiver."""
    connection.execute(sa.update(webhooks).where(webhooks.c.id == identifier).values(values))


def _receiver(row: sa.RowMapping) -> Receiver:
    return Receiver(**{**row, "events": tuple(row["events"]), "rigs": tuple(row["rigs"])})
