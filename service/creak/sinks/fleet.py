"""Rigs that several processes share: who owns which, how far each has come, and what its next owner has to know.

An owner holds a rig until a time by the clock of the database and renews that. Each change of owner raises the
rig's epoch; every transaction that writes for a rig begins with :func:`keep`, which locks the rig's row and finds
the epoch changed if somebody else has taken over. So an owner that was paused can write nothing any more.
"""

import time
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import sqlalchemy as sa

from creak.codec.letters import Place
from creak.errors import ServiceError
from creak.sinks import kept_sums
from creak.sinks.kept_sums import Kept, fleet_sums
from creak.sinks.operator_tables import leases
from creak.sinks.tables import metadata, runs

_ANALYSER = "analyser/"

fleet = sa.Table(
    "fleet",
    metadata,
    sa.Column("rig", sa.Text, primary_key=True),
    sa.Column("owner", sa.Text, index=True),
    sa.Column("epoch", sa.BigInteger, nullable=False),
    sa.Column("until_at", sa.BigInteger, nullable=False),
    sa.Column("begun", sa.BigInteger),  # place of the last digest that was taken: run ...
    sa.Column("realisation", sa.BigInteger),  # ... and index
    sa.Column("stream", sa.Text, nullable=False),  # that the next column counts in
    sa.Column("sequence", sa.BigInteger, nullable=False),  # up to which nothing has to be read again
    sa.Column("blocks", sa.BigInteger, nullable=False),  # complete realisations so far, over all runs
    sa.Column("opening", sa.LargeBinary),  # the run
    sa.Column("checkpoint", sa.LargeBinary),
)
"""One row a rig: its owner, and where its monitor stands but for the sums."""


class LostRigError(ServiceError):
    """Somebody else owns the rig now; nothing was written."""


@dataclass(frozen=True)
class Position:
    """How far a rig has been read.

    Parameters
    ----------
    place : tuple of int, or None
        Of the last digest that was taken.
    stream : str
        Identity of the stream in which sequences count.
    sequence : int
        Up to which nothing has to be read again.
    blocks : int
        Complete realisations so far, over all runs.
    """

    place: Place | None = None
    stream: str = ""
    sequence: int = 0
    blocks: int = 0


@dataclass(frozen=True)
class Saved:
    """What is kept of a rig.

    Parameters
    ----------
    position : Position
    opening, checkpoint : bytes or None
        None before the first digest.
    sums : Kept
    """

    position: Position
    opening: bytes | None
    checkpoint: bytes | None
    sums: Kept


def now_ns(connection: sa.Connection) -> int:
    """Return the time by the one clock that all owners share, ns."""
    if connection.dialect.name != "postgresql":
        return time.time_ns()  # an embedded store is used on one machine
    seconds = sa.func.extract("epoch", sa.func.clock_timestamp())
    return int(float(connection.execute(sa.select(seconds)).scalar_one()) * 1e9)


def new_analyser() -> str:
    """Return a name for a process that is to own rigs."""
    return _ANALYSER + uuid.uuid4().hex[:20]


def share(
    connection: sa.Connection, analyser: str, rigs: Sequence[str], seconds: float, idle: Iterable[str] = ()
) -> dict[str, int]:
    """Renew what an analyser owns, give back what is beyond its share, take what is free.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Of a writing transaction.
    analyser : str
    rigs : sequence of str
        That it may own.
    seconds : float
        For which they are held.
    idle : iterable of str
        Owned rigs with which nothing is being done, so that they can be given back.

    Returns
    -------
    dict of str to int
        Epochs of the rigs that it owns now.
    """
    now = now_ns(connection)
    until = now + round(seconds * 1e9)
    _be_seen(connection, analyser, until, now)
    others = sa.select(sa.func.count()).where(leases.c.name.startswith(_ANALYSER), leases.c.until_at > now)
    fair = -(-len(rigs) // max(1, int(connection.execute(others).scalar_one())))
    mine = sa.select(fleet.c.rig, fleet.c.epoch).where(fleet.c.owner == analyser, fleet.c.rig.in_(rigs))
    owned = {row.rig: row.epoch for row in connection.execute(mine)}
    surplus = [rig for rig in idle if rig in owned][: max(0, len(owned) - fair)]
    give_back(connection, analyser, surplus)
    owned = {rig: epoch for rig, epoch in owned.items() if rig not in surplus}
    _renew(connection, analyser, until)
    if len(owned) < fair:
        _enter(connection, rigs)
        free = (
            sa.select(fleet.c.rig)
            .where(fleet.c.rig.in_(rigs), sa.or_(fleet.c.owner.is_(None), fleet.c.until_at < now))
            .order_by(fleet.c.until_at)
            .limit(fair - len(owned))
            .with_for_update(skip_locked=True)
        )
        names = list(connection.execute(free).scalars())
        taken = (
            sa.update(fleet)
            .where(fleet.c.rig.in_(names))
            .values(owner=analyser, epoch=fleet.c.epoch + 1, until_at=until)
            .returning(fleet.c.rig, fleet.c.epoch)
        )
        owned |= {row.rig: row.epoch for row in connection.execute(taken)}
    return owned


def give_back(connection: sa.Connection, analyser: str, rigs: Iterable[str]) -> None:
    """Let others take rigs at once."""
    connection.execute(
        sa.update(fleet).where(fleet.c.owner == analyser, fleet.c.rig.in_(list(rigs))).values(owner=None)
    )


def leave(connection: sa.Connection, analyser: str) -> None:
    """Give everything back: the process ends."""
    connection.execute(sa.update(fleet).where(fleet.c.owner == analyser).values(owner=None))
    connection.execute(sa.delete(leases).where(leases.c.name == analyser))


def keep(
    connection: sa.Connection, rig: str, epoch: int, position: Position, opening: bytes, checkpoint: bytes
) -> None:
    """Begin a transaction of a rig's owner: lock the rig and write where it will then stand.

    Raises
    ------
    LostRigError
        If another has taken it; the transaction has to be given up.
    """
    begun, index = (None, None) if position.place is None else position.place
    values = {
        "begun": begun,
        "realisation": index,
        "stream": position.stream,
        "sequence": position.sequence,
        "blocks": position.blocks,
        "opening": opening,
        "checkpoint": checkpoint,
    }
    kept = sa.update(fleet).where(fleet.c.rig == rig, fleet.c.epoch == epoch).values(values)
    if not connection.execute(kept).rowcount:
        raise LostRigError(f"{rig}: is analysed elsewhere now")


def saved(connection: sa.Connection, rig: str) -> Saved:
    """Return what is kept of a rig.

    Raises
    ------
    RecordingError
        If its sums are of another version.
    """
    row = connection.execute(sa.select(fleet).where(fleet.c.rig == rig)).mappings().first()
    if row is None:
        return Saved(Position(), None, None, Kept())
    place = None if row["begun"] is None else (row["begun"], row["realisation"])
    position = Position(place, row["stream"], row["sequence"], row["blocks"])
    return Saved(position, row["opening"], row["checkpoint"], kept_sums.read(connection, fleet_sums, rig))


def beat(connection: sa.Connection, now: int, heard: Mapping[str, int | None]) -> None:
    """Write that runs are looked after, and when their rigs were last heard if that is known; wall clock, ns."""
    connection.execute(sa.update(runs).where(runs.c.id.in_(list(heard))).values(beat_at=now))
    known = [{"of": run, "at": at} for run, at in heard.items() if at is not None]
    if known:
        told = sa.update(runs).where(runs.c.id == sa.bindparam("of")).values(heard_at=sa.bindparam("at"))
        connection.execute(told, known)


def _be_seen(connection: sa.Connection, analyser: str, until: int, now: int) -> None:
    connection.execute(sa.delete(leases).where(leases.c.name.startswith(_ANALYSER), leases.c.until_at < now))
    seen = sa.update(leases).where(leases.c.name == analyser).values(until_at=until)
    if not connection.execute(seen).rowcount:
        connection.execute(sa.insert(leases).values(name=analyser, owner=analyser, until_at=until))


def _renew(connection: sa.Connection, analyser: str, until: int) -> None:
    connection.execute(sa.update(fleet).where(fleet.c.owner == analyser).values(until_at=until))


def _enter(connection: sa.Connection, rigs: Sequence[str]) -> None:
    """Make rows for rigs that have none."""
    known = set(connection.execute(sa.select(fleet.c.rig).where(fleet.c.rig.in_(rigs))).scalars())
    for rig in rigs:
        if rig not in known:
            try:
                with connection.begin_nested():
                    connection.execute(
                        sa.insert(fleet).values(rig=rig, epoch=0, until_at=0, stream="", sequence=0, blocks=0)
                    )
            except sa.exc.IntegrityError:  # another analyser was quicker
                continue
