"""The sums that a monitor needs after a restart, a row a realisation: what is new is written, and nothing else.

The matrix about which the residuals of all blocks are taken, and the sums of the whole run, have rows of their
own. The sums of the run are written once in a window of realisations; what has come since is added again when they
are read, in the same order and so to the same bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import sqlalchemy as sa

from creak.codec.memory import packed, unpacked
from creak.judgement import Block
from creak.records import Complex
from creak.sinks.tables import metadata

_WHOLE, _ABOUT = -1, -2  # slots of the run's sums and of the common matrix; blocks have their numbers, from 1 on


def _table(name: str) -> sa.Table:
    return sa.Table(
        name,
        metadata,
        sa.Column("rig", sa.Text, primary_key=True),
        sa.Column("slot", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("number", sa.BigInteger, nullable=False),  # of the newest block in it
        sa.Column("payload", sa.LargeBinary, nullable=False),
    )


state_sums = _table("state_sums")
"""Of the rigs that a service measures itself; since version 6 of the store."""

fleet_sums = _table("fleet_sums")
"""Of the rigs that several processes share. Up to version 5 blocks lay in a ring, each with the common matrix."""


@dataclass(frozen=True, eq=False)
class Known:
    """What a table has of a rig; blocks are known by being the same object."""

    blocks: tuple[tuple[int, Block], ...] = ()
    newest: int = 0  # number of the newest block
    about: Complex | None = None
    whole: int | None = None  # number of the newest block in the run's sums
    anew: bool = False  # nothing that stands there is of use


NOTHING = Known(anew=True)


@dataclass(frozen=True, eq=False)
class Kept:
    """What was read.

    Parameters
    ----------
    blocks : tuple of Block
        Of the window, oldest first.
    whole : Block or None
        Sums of the run.
    known : Known
        Where it stands.
    """

    blocks: tuple[Block, ...] = ()
    whole: Block | None = None
    known: Known = NOTHING


@dataclass(frozen=True, eq=False)
class Changes:
    """What a table lacks.

    Parameters
    ----------
    rows : tuple of (int, int, bytes)
        Slot, number and payload.
    first : int
        Number of the oldest block that stays.
    before, after : Known
    """

    rows: tuple[tuple[int, int, bytes], ...]
    first: int
    before: Known
    after: Known


def changes(known: Known, window: int, blocks: Sequence[Block], whole: Block | None = None) -> Changes:
    """Pack what a table lacks.

    Parameters
    ----------
    known : Known
    window : int
        R.
    blocks : sequence of Block
        Of the window, oldest first.
    whole : Block or None
        Sums of the run, the last block included, if they are to be kept.
    """
    about = blocks[-1].sums.about if blocks else None
    if any(block.sums.about is not about for block in blocks):
        about = None  # each keeps its own
    moved = known.anew or about is None or about is not known.about
    there = {} if moved else {id(block): number for number, block in known.blocks}
    newest = known.newest
    numbered, rows = [], []
    for block in blocks:
        number = there.get(id(block))
        if number is None:
            number = newest = newest + 1
            rows.append((number, number, _without(block, about)))
        numbered.append((number, block))
    if moved and about is not None:
        rows.append((_ABOUT, newest, packed(about)))
    written = known.whole
    if whole is not None and (moved or written is None or newest - written >= window):
        rows.append((_WHOLE, newest, _without(whole, about)))
        written = newest
    first = numbered[0][0] if numbered else newest + 1
    return Changes(tuple(rows), first, known, Known(tuple(numbered), newest, about, written))


def write(connection: sa.Connection, table: sa.Table, rig: str, made: Changes) -> None:
    """Write what a table lacks, and remove what has left the window."""
    replaced = table.c.slot.in_([slot for slot, _, _ in made.rows])
    gone = sa.or_(table.c.slot.between(0, made.first - 1), replaced, sa.literal(made.before.anew))
    connection.execute(sa.delete(table).where(table.c.rig == rig, gone))
    if made.rows:
        rows = [{"rig": rig, "slot": slot, "number": n, "payload": payload} for slot, n, payload in made.rows]
        connection.execute(sa.insert(table), rows)


def forget_whole(connection: sa.Connection, table: sa.Table, rig: str) -> None:
    """Remove the sums of a run that is over."""
    connection.execute(sa.delete(table).where(table.c.rig == rig, table.c.slot == _WHOLE))


def read(connection: sa.Connection, table: sa.Table, rig: str) -> Kept:
    """Return what a table has of a rig.

    Raises
    ------
    RecordingError
        If it is none of this version's.
    """
    query = sa.select(table.c.slot, table.c.number, table.c.payload).where(table.c.rig == rig)
    rows = connection.execute(query.order_by(table.c.number, table.c.slot)).all()
    common = {row.slot: row for row in rows if row.slot < 0}
    about = unpacked(np.ndarray, common[_ABOUT].payload) if _ABOUT in common else None
    numbered = tuple((row.number, _about(row.payload, about)) for row in rows if row.slot >= 0)
    blocks = tuple(block for _, block in numbered)
    whole = None
    if _WHOLE in common:
        whole = _about(common[_WHOLE].payload, about)
        for number, block in numbered:
            if number > common[_WHOLE].number:
                whole = whole + block
    if not rows or about is None or any(block.sums.about is not about for block in blocks):
        return Kept(blocks, whole)
    newest = max(row.number for row in rows)
    known = Known(numbered, newest, about, common[_WHOLE].number if _WHOLE in common else None)
    return Kept(blocks, whole, known)


def _without(block: Block, about: Complex | None) -> bytes:
    """Pack a block without the matrix that all have in common."""
    common = about is not None and block.sums.about is about
    return packed(replace(block, sums=replace(block.sums, about=None)) if common else block)


def _about(payload: bytes, about: Complex | None) -> Block:
    block = unpacked(Block, payload)
    if about is None or block.sums.about is not None:
        return block
    return replace(block, sums=replace(block.sums, about=about))
