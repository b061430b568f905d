"""From the tables of an older version to those of this one, step by step, in one transaction."""

from collections.abc import Callable, Mapping

import sqlalchemy as sa

from creak.sinks import fleet, kept_sums, operator_tables, tables


def _to_2(connection: sa.Connection) -> None:
    """Add operators' actions, webhooks, keys, saved states and jobs; alarms keep facts without a column."""
    tables.metadata.create_all(connection, tables=[*operator_tables.ADDED, tables.jobs])
    kind = tables.alarms.c.more.type.compile(connection.dialect)
    for table, column in (("alarms", "more"), ("runs", "rules")):
        connection.exec_driver_sql(f"ALTER TABLE {table} ADD COLUMN {column} {kind}")


def _to_3(connection: sa.Connection) -> None:
    """Estimates keep what detection lines and remarks say."""
    kind = tables.estimates.c.more.type.compile(connection.dialect)
    connection.exec_driver_sql(f"ALTER TABLE estimates ADD COLUMN more {kind}")


def _to_4(connection: sa.Connection) -> None:
    """Actions may be asked of a node, and what they begin is no alarm yet."""
    kind = tables.alarms.c.never_raised.type.compile(connection.dialect)
    connection.exec_driver_sql(f"ALTER TABLE alarms ADD COLUMN never_raised {kind}")
    if all(column["name"] != "node" for column in sa.inspect(connection).get_columns("actions")):
        connection.exec_driver_sql("ALTER TABLE actions ADD COLUMN node TEXT")


def _to_5(connection: sa.Connection) -> None:
    """Add the rigs that several processes share."""
    tables.metadata.create_all(connection, tables=[fleet.fleet, kept_sums.fleet_sums])


def _to_6(connection: sa.Connection) -> None:
    """Sums of realisations in rows of their own; a state with the sums in it is read as it is."""
    tables.metadata.create_all(connection, tables=[kept_sums.state_sums])


STEPS: Mapping[int, Callable[[sa.Connection], None]] = {2: _to_2, 3: _to_3, 4: _to_4, 5: _to_5, 6: _to_6}
"""Version to the step that reaches it from the one before."""


def create(connection: sa.Connection) -> None:
    """Make all tables in an empty database."""
    tables.metadata.create_all(connection)
    connection.execute(sa.insert(tables.schema).values(version=tables.SCHEMA_VERSION))
    connection.execute(sa.insert(tables.counters).values(name="events", value=0))


def migrate(connection: sa.Connection, version: int) -> None:
    """Bring the tables of a version to the newest; nothing is changed if a step fails."""
    for step in range(version + 1, tables.SCHEMA_VERSION + 1):
        STEPS[step](connection)
    connection.execute(sa.update(tables.schema).values(version=tables.SCHEMA_VERSION))
