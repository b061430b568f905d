"""From the table of a service file to a CAN source: a bus or logs."""

import time
import uuid
from pathlib import Path

from creak import __version__
from creak.config.can import CanSource
from creak.records import Excitation, Limits, Rig, Run
from creak.sources.can_log import CanLog, first_time
from creak.sources.can_mapping import map_signals
from creak.sources.canbus import CanBus
from creak.sources.dbc import Database


def can_run(
    source: CanSource,
    rig: Rig,
    *,
    window: int = Run.window,
    limits: Limits | None = None,
    run_id: str | None = None,
) -> Run:
    """Return the opening of a run that comes from CAN.

    Parameters
    ----------
    source : CanSource
    rig : Rig
    window : int
    limits : Limits, optional
    run_id : str, optional
        A new one by default.
    """
    return Run(
        id=run_id or str(uuid.uuid4()),
        rig=rig,
        steady_periods=source.steady_periods,
        start=first_time(source.logs[0]) if source.logs else time.time_ns(),
        excitation=Excitation("measured"),
        source="can",
        window=window,
        limits=limits or Limits(),
        software=__version__,
    )


def open_can(
    source: CanSource,
    rig: Rig,
    *,
    window: int = Run.window,
    limits: Limits | None = None,
    run_id: str | None = None,
    file: str | Path,
    key: str,
) -> CanBus | CanLog:
    """Open what a table of kind can describes.

    Parameters
    ----------
    source : CanSource
    rig : Rig
    window : int
    limits : Limits, optional
    run_id : str, optional
    file, key : str
        Where the table stands, for messages.

    Raises
    ------
    ConfigurationError, MeasurementError
        One line: a DBC, a signal, a counter, a rate, an interface or a log that will not do.
    """
    database = Database(source.dbc)
    run = can_run(source, rig, window=window, limits=limits, run_id=run_id)
    mapping = map_signals(database, source, run, str(file), key)
    if source.logs:
        return CanLog(run, mapping, source.logs, source.patience)
    return CanBus(run, mapping, source, str(file), key)
