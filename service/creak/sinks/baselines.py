"""Baselines as a rig's monitor last saved them: at the end of every complete realisation."""

import sqlalchemy as sa

from creak.baseline import Baseline
from creak.codec.memory import baselines_of
from creak.errors import RecordingError
from creak.sinks.operator_tables import states


def saved(connection: sa.Connection, rig: str) -> tuple[Baseline, ...]:
    """Return the baselines of a rig, by node and excitation; none if its monitor could not take them up either."""
    return as_of(connection, rig)[0]


def as_of(connection: sa.Connection, rig: str) -> tuple[tuple[Baseline, ...], int | None]:
    """Return the baselines of a rig, and the recorded time of which they are, ns; None if none were saved."""
    row = connection.execute(sa.select(states.c.payload, states.c.time).where(states.c.rig == rig)).first()
    if row is None:
        return (), None
    try:
        found = baselines_of(row.payload)
    except RecordingError:  # of another version: the monitor begins afresh, and says so
        return (), None
    return tuple(sorted(found, key=lambda each: (each.node, each.state_rms))), row.time
