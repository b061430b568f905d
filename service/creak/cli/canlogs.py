"""CAN logs for ``creak import --dbc``."""

import hashlib
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

from creak.cli.canlibraries import can_support
from creak.config.can import CanSource, SignalsTable, load_signals
from creak.errors import ConfigurationError, MeasurementError
from creak.records import Rig
from creak.sources.protocol import Source


def open_logs(
    files: Sequence[Path],
    dbc: Path,
    signals: Path | None,
    rig: Rig,
    steady_periods: int,
    say: Callable[[str], None],
) -> Source:
    """Open logs as a source; of a log that cannot be analysed it is said what it holds, before the error.

    Parameters
    ----------
    files : sequence of Path
    dbc : Path
    signals : Path or None
        File with the keys of ``[rigs.source.signals]``.
    rig : Rig
    steady_periods : int
    say : callable
        Takes a line for standard output.

    Raises
    ------
    InputError
        One line: a log, a DBC, a signal that will not do; a log without excitation.
    """
    support = can_support()
    table = SignalsTable() if signals is None else load_signals(signals)
    source = CanSource(kind="can", dbc=dbc, logs=list(files), steady_periods=steady_periods, signals=table)
    try:
        file, key = (dbc, "source") if signals is None else (signals, "")
        opened: Source = support.open_can(source, rig, run_id=_identity(source, rig), file=file, key=key)
    except ConfigurationError as error:
        if "cannot be analysed" in error.problem:
            from creak.sources.can_log import survey
            from creak.sources.dbc import Database

            for path in files:
                for line in survey(path, Database(dbc)):
                    say(f"{path.name}: {line}")
        raise
    return opened


def _identity(source: CanSource, rig: Rig) -> str:
    """Importing the same logs twice gives the same recording."""
    digest = hashlib.sha256(repr((rig, source.signals, source.steady_periods)).encode())
    for path in (source.dbc, *source.logs):
        try:
            with path.open("rb") as file:
                digest.update(hashlib.file_digest(file, "sha256").digest())
        except OSError as error:
            raise MeasurementError(f"{path}: cannot be read: {error.strerror}") from None
    return str(uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest()))
