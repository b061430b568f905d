"""What operators ask for, between the API that writes it down and the worker whose monitor does it.

While a worker measures a rig, its monitor alone changes the rig's alarms: the API writes an action, the worker
carries it out and writes the answer. Without a worker the API does the same with the alarm's row in one step
(:func:`carry_out`), and leaves the action for a later worker to learn of.
"""

import time
import uuid
from collections.abc import Collection
from dataclasses import dataclass, replace

import sqlalchemy as sa

from creak import alarms
from creak.alarm_records import Action, ActionKind, AlarmRules, Conflict
from creak.sinks import baselines, tables
from creak.sinks.alarm_rows import change_of, put_alarm
from creak.sinks.operator_tables import actions

PENDING, DONE, STALE, NOT_ALLOWED = "pending", "done", "stale", "not_allowed"

_WAITING = (  # asked ten times a second, so it is put together once
    sa.select(actions)
    .where(
        actions.c.rig.in_(sa.bindparam("rigs", expanding=True)),
        ~actions.c.folded,
        actions.c.seq > sa.bindparam("after"),
    )
    .order_by(actions.c.seq)
    .limit(100)
)

_KEPT = 1_000_000_000 * 86_400 * 400  # ns; the journal has the rest


@dataclass(frozen=True)
class Asked:
    """An action as it was asked for.

    Parameters
    ----------
    seq : int
        Its place in the order of all actions.
    action : Action
    told : bool
        True if it is done and told already; the monitor has only to learn of it.
    """

    seq: int
    action: Action
    told: bool


def ask(connection: sa.Connection, rig: str, action: Action, status: str = PENDING) -> str:
    """Write down what an operator asks of a rig; return the id under which the answer is found."""
    identifier, now = uuid.uuid4().hex, time.time_ns()
    connection.execute(sa.delete(actions).where(actions.c.rig == rig, actions.c.asked_at < now - _KEPT))
    connection.execute(
        sa.insert(actions).values(
            id=identifier,
            rig=rig,
            alarm=action.alarm,
            kind=action.kind.value,
            by=action.by,
            comment=action.comment,
            until=action.until,
            version=action.version,
            asked_at=now,
            status=status,
            reason="",
            folded=False,
            node=action.node,
        )
    )
    return identifier


def outcome(connection: sa.Connection, identifier: str) -> tuple[str, str]:
    """Return the status of an action, and why it was refused."""
    query = sa.select(actions.c.status, actions.c.reason).where(actions.c.id == identifier)
    status, reason = connection.execute(query).one()
    return status, reason


def waiting(connection: sa.Connection, rig: str, after: int) -> list[Asked]:
    """Return the actions that the monitor of a rig does not know, in order."""
    return _asked(connection, [rig], after).get(rig, [])


def waiting_for(connection: sa.Connection, rigs: Collection[str]) -> dict[str, list[Asked]]:
    """Return the actions that the monitors of several rigs do not know, in order, by rig."""
    return _asked(connection, rigs, 0)


def _asked(connection: sa.Connection, rigs: Collection[str], after: int) -> dict[str, list[Asked]]:
    found: dict[str, list[Asked]] = {}
    for row in connection.execute(_WAITING, {"rigs": list(rigs), "after": after}).mappings():
        action = Action(
            alarm=row["alarm"],
            kind=ActionKind(row["kind"]),
            by=row["by"],
            comment=row["comment"],
            until=row["until"],
            version=row["version"],
            node=row["node"] or "",
        )
        found.setdefault(row["rig"], []).append(Asked(row["seq"], action, row["status"] == DONE))
    return found


def answer(connection: sa.Connection, asked: Asked, conflict: Conflict | None) -> None:
    """Write that the monitor has carried an action out, or why not; after the changes that it made."""
    values: dict[str, object] = {"folded": True}
    if not asked.told:
        values |= {"status": DONE} if conflict is None else {"status": conflict.kind, "reason": conflict.reason}
    connection.execute(sa.update(actions).where(actions.c.seq == asked.seq).values(values))


def carry_out_of_node(
    connection: sa.Connection, run: sa.RowMapping, action: Action, rules: AlarmRules, now: int
) -> Conflict | None:
    """Do what an operator asks with the alarm of a node that no worker looks after.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Of a durable transaction.
    run : sqlalchemy.RowMapping
        The current run of the rig.
    action : Action
        With its `node`.
    rules : AlarmRules
    now : int
        Recorded time, ns.

    Returns
    -------
    Conflict or None
        Why it was not done.
    """
    rig = run["rig"]
    connection.execute(sa.select(tables.rigs).where(tables.rigs.c.name == rig).with_for_update())  # one at a time
    if action.kind is ActionKind.RELEARN and not _has_baseline(connection, rig, action.node):
        return _no_baseline(action.node)
    table = tables.alarms
    query = sa.select(table).where(
        table.c.run == run["id"], table.c.node == action.node, table.c.class_ == "process"
    )
    row = connection.execute(query.order_by(table.c.seq.desc()).limit(1)).mappings().first()
    change = None if row is None else change_of(row)
    alarm = alarms.Alarm(rig, action.node) if change is None else alarms.of_change(change)
    result = alarms.act(alarm, action, now if change is None else max(now, change.time), rules, run["id"])
    if isinstance(result, Conflict):
        return result
    for made in result[1]:
        put_alarm(connection, run["id"], made)
    if result[1]:
        ask(connection, rig, replace(action, alarm=result[0].id), DONE)
    return None


def carry_out(connection: sa.Connection, action: Action, rules: AlarmRules, now: int) -> Conflict | None:
    """Do what an operator asks with an alarm that no worker looks after.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Of a durable transaction.
    action : Action
    rules : AlarmRules
    now : int
        Recorded time, ns.

    Returns
    -------
    Conflict or None
        Why it was not done.
    """
    table = tables.alarms
    row = connection.execute(sa.select(table).where(table.c.id == action.alarm)).mappings().one()
    change = change_of(row)
    newest = sa.select(table.c.id).where(
        table.c.rig == change.rig,
        table.c.node == change.node,
        table.c.class_ == change.class_,
        table.c.seq > row["seq"],
    )
    same = (
        connection.execute(newest).first() is None
        if change.class_ == "process"
        else True  # of class quality, several conditions of a node have alarms of their own
    )
    if action.kind is ActionKind.RELEARN:
        if change.class_ != "process":
            return Conflict("not_allowed", "an alarm about data has no baseline")
        if not _has_baseline(connection, change.rig, change.node):
            return _no_baseline(change.node)
    if not same and (not change.acknowledged or action.kind is ActionKind.RELEARN):
        return Conflict("stale", "the occurrence has ended and a newer one has taken its place")
    result = alarms.act(alarms.of_change(change), action, max(now, change.time), rules, row["run"])
    if isinstance(result, Conflict):
        return result
    for made in result[1]:
        put_alarm(connection, row["run"], made)
    ask(connection, change.rig, action, DONE)
    return None


def _has_baseline(connection: sa.Connection, rig: str, node: str) -> bool:
    return any(known.node == node for known in baselines.saved(connection, rig))


def _no_baseline(node: str) -> Conflict:
    return Conflict("not_allowed", f"node {node!r} has no baseline that could be replaced")
