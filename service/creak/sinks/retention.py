"""How long history is kept, and how much of the disk recordings may take."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import sqlalchemy as sa

from creak.sinks import tables
from creak.sinks.database import Store

_log = logging.getLogger(__name__)

SECOND = 1_000_000_000
DAY = 86_400 * SECOND


@dataclass(frozen=True)
class Thinning:
    """Beyond an age only one row of every interval is kept; times are recorded ones, ns.

    Parameters
    ----------
    age : int
        Counted from the newest row of the rig.
    interval : int
        0 keeps none.
    """

    age: int
    interval: int


THINNINGS = (
    Thinning(7 * DAY, 3600 * SECOND),
    Thinning(90 * DAY, DAY),
    Thinning(3650 * DAY, 0),
)
"""A week as it was, a quarter hour by hour, ten years day by day."""


def thin_history(connection: sa.Connection, rules: Sequence[Thinning] = THINNINGS) -> int:
    """Thin the history of all rigs; return how many rows of levels were removed.

    Of an interval the newest row of a node is kept as it was measured: a mean of dB would be nobody's level. What
    the API shows as current is never touched, nor are alarms and their journal.
    """
    levels, estimates, removed = tables.levels, tables.estimates, 0
    newest = sa.select(levels.c.rig, sa.func.max(levels.c.time)).group_by(levels.c.rig)
    for rig, last in connection.execute(newest).all():
        for rule in rules:
            old = (levels.c.rig == rig, levels.c.time < last - rule.age)
            gone = sa.delete(levels).where(*old)
            if rule.interval:
                interval = sa.literal_column(str(rule.interval), sa.BigInteger)
                bucket = levels.c.time - levels.c.time % interval
                kept = (
                    sa.select(sa.func.max(levels.c.id)).where(*old).group_by(levels.c.scope, levels.c.name, bucket)
                )
                gone = gone.where(levels.c.id.not_in(kept))
            removed += connection.execute(gone).rowcount
    if removed:
        used = sa.select(levels.c.estimate).where(levels.c.estimate == estimates.c.id)
        shown = sa.select(tables.spectra.c.estimate).where(tables.spectra.c.estimate == estimates.c.id)
        connection.execute(sa.delete(estimates).where(~sa.exists(used), ~sa.exists(shown)))
    return removed


def keep_budget(store: Store, budget: int) -> list[Path]:
    """Remove the oldest complete recordings until all together take no more bytes than allowed.

    Returns
    -------
    list of Path
        Files that were removed. A recording that is being written is never removed, nor is the newest one.
    """
    recordings = tables.recordings
    with store.read() as connection:
        query = sa.select(recordings).order_by(recordings.c.seq)
        rows = list(connection.execute(query).mappings())
    sizes = {row["id"]: _size(Path(row["path"])) for row in rows}
    total, removed = sum(sizes.values()), []
    for row in rows[:-1]:
        if total <= budget:
            break
        if row["status"] == "writing":
            continue
        path = Path(row["path"])
        path.unlink(missing_ok=True)
        with store.write() as connection:
            connection.execute(sa.delete(recordings).where(recordings.c.id == row["id"]))
        total -= sizes[row["id"]]
        removed.append(path)
        _log.info("%s was removed: recordings take more than %d bytes", path, budget)
    return removed


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
