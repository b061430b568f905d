"""Alarms of class quality about the service itself, which no rig's monitor knows."""

import uuid
from dataclasses import replace

import sqlalchemy as sa

from creak.alarm_records import AlarmRules
from creak.alarms import Alarm, demand, of_change
from creak.sinks import tables
from creak.sinks.alarm_rows import change_of, put_alarm

SERVICE = "creak"
"""Rig of alarms that are about no rig."""

_RUN = ""  # of no run
_NAMESPACE = uuid.UUID("6f1d2c0e-8f0b-5a3e-9a57-6372656b0003")


def raise_alarm(
    connection: sa.Connection,
    rig: str,
    node: str,
    condition: str,
    now: int,
    *,
    reason: str,
    guidance: str,
) -> str:
    """Raise an alarm; return its id.

    Parameters
    ----------
    connection : sqlalchemy.Connection
        Of the durable transaction that it belongs to.
    rig, node : str
        What it is about.
    condition : str
        What stands.
    now : int
        Time, ns since the Unix epoch.
    reason, guidance : str
        What happened, and what to do.
    """
    identifier = str(uuid.uuid5(_NAMESPACE, f"{rig}/{node}/{condition}/{now}"))
    _, changes = demand(Alarm(rig, node, "quality"), "warning", now, AlarmRules(), _RUN, condition)
    for change in changes:
        put_alarm(connection, _RUN, replace(change, id=identifier, comment=reason, guidance=guidance))
    return identifier


def clear_standing(connection: sa.Connection, rig: str, node: str, condition: str, now: int) -> None:
    """Tell that a condition is over, whichever of the service's alarms tell of it."""
    alarms = tables.alarms
    query = sa.select(alarms).where(
        alarms.c.rig == rig, alarms.c.node == node, alarms.c.run == _RUN, alarms.c.active
    )
    for row in connection.execute(query).mappings().all():
        if (standing := change_of(row)).condition == condition:
            clear_alarm(connection, standing.id, max(now, standing.time))


def clear_alarm(connection: sa.Connection, identifier: str, now: int) -> None:
    """Tell that what an alarm is about is over."""
    alarms = tables.alarms
    row = connection.execute(sa.select(alarms).where(alarms.c.id == identifier)).mappings().first()
    if row is None:
        return
    standing = change_of(row)
    _, changes = demand(of_change(standing), None, now, AlarmRules(), _RUN)
    for change in changes:
        put_alarm(connection, _RUN, replace(change, guidance=standing.guidance))
