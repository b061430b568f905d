"""Rigs and their sources, as the service file describes them."""

import time
import uuid
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from creak.analysis import Plan
from creak.cli.canlibraries import can_support
from creak.config.can import CanSource
from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.config.service import RecordingSource, RigTable, ServiceSettings, SimulatedSource
from creak.errors import ConfigurationError, RecordingError, StorageError
from creak.records import Rig
from creak.sources.protocol import Source
from creak.sources.recording import Recording
from creak.sources.simulated import SimulatedRig


def named_rigs(settings: ServiceSettings, file: str) -> list[Rig]:
    """Load the rigs of a service file, which have unique names."""
    for index, table in enumerate(settings.rigs):
        _require(table.rig, file, f"rigs[{index}].rig")
    rigs = [load_rig(table.rig) for table in settings.rigs]
    names = [rig.name for rig in rigs]
    for index, name in enumerate(names):
        if names.index(name) != index:
            raise ConfigurationError(file, f"rigs[{index}].rig", f"{name!r} stands twice; rigs have unique names")
    return rigs


def plan_of(table: RigTable, rig: Rig) -> Plan:
    """Return how a rig is judged that is measured elsewhere."""
    rules = table.alarms.rules(), table.baseline.rules(table.window)
    return Plan(rig, table.window, table.limits.limits(), *rules)


def make_folder(path: Path) -> None:
    """Make the directory for recordings and the embedded store."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{path}: cannot be made: {error.strerror}") from None


def open_source(table: RigTable, rig: Rig, file: str, key: str) -> Source:
    """Open the source of one rig, its run with the rules of the service file; file and key say where it stands."""
    if table.model is not None:
        _require(table.model, file, key.replace(".source", ".model"))
        load_model(table.model)  # what is wrong with it is said now, not at the first diagnosis
    source = _opened(table, rig, file, key)
    source.run = replace(source.run, alarms=table.alarms.rules(), baseline=table.baseline.rules(table.window))
    return source


def _opened(table: RigTable, rig: Rig, file: str, key: str) -> Source:
    if isinstance(table.source, SimulatedSource):
        return simulated_rig(table, rig)
    if isinstance(table.source, CanSource):
        limits = table.limits.limits()
        live: Source = can_support().open_can(
            table.source, rig, window=table.window, limits=limits, file=file, key=key
        )
        return live
    if isinstance(table.source, RecordingSource):
        for index, path in enumerate(table.source.files):
            _require(path, file, f"{key}.files[{index}]")
        recording = Recording(*table.source.files)
        if replace(recording.run.rig, grid=rig.grid) != rig:
            raise RecordingError(
                f"{recording.paths[0]}: is a recording of another rig ({recording.run.rig.name!r}) "
                f"than {table.rig} describes ({rig.name!r})"
            )
        recording.run = replace(
            recording.run,
            id=str(uuid.uuid4()),
            window=table.window,
            limits=table.limits.limits(),
            source="recording",
        )
        return recording
    raise AssertionError(table.source)  # other kinds do not pass the settings


def _require(path: Path, file: str, key: str) -> None:
    """Name the place in the service file that names a file which is not there."""
    if not path.exists():
        raise ConfigurationError(file, key, f"{str(path)!r} is not there")


def simulated_rig(
    table: RigTable, rig: Rig, *, changes: Sequence[tuple[int, Path]] = (), past: int = 0
) -> SimulatedRig:
    """Make a simulated rig; ``past`` realisations of it lie before the present moment."""
    settings = table.source
    assert isinstance(settings, SimulatedSource)
    assert table.model is not None
    periods = rig.transient_periods + settings.steady_periods
    return SimulatedRig(
        rig,
        load_model(table.model),
        steady_periods=settings.steady_periods,
        rms=settings.rms,
        seed=settings.seed,
        snr_db=settings.snr_db,
        realisations=settings.realisations,
        start=time.time_ns() - round(past * rig.q * periods * rig.period_ns),
        pace=settings.pace,
        changes=[(index, load_model(path)) for index, path in changes],
        run_id=str(uuid.uuid4()),
        window=table.window,
        limits=table.limits.limits(),
    )
