"""Commands of a fleet: worker at each rig, analyse anywhere."""

import logging
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from creak.analyser import Analyser
from creak.analysis import Plan
from creak.broker import Broker, StreamLimits
from creak.cli.fleet_metrics import AnalyserCollector, WorkerCollector, served
from creak.cli.progress import prepare_loops
from creak.cli.sources import make_folder, named_rigs, open_source, plan_of
from creak.cli.supervision import Supervisor
from creak.config.service import load_service
from creak.config.stream import StreamSource, StreamTable
from creak.digests import Gatherer
from creak.errors import ConfigurationError, ServiceError
from creak.sinks.database import Store, open_store
from creak.sinks.recorder import Recorder
from creak.sinks.stream import StreamSink
from creak.sources.retold import retold
from creak.worker import Worker

_STOP_SECONDS = 4.0
_LOOK_SECONDS = 0.2


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    app.command()(worker)
    app.command()(analyse)


def worker(config: Annotated[Path, typer.Argument(help="Service file (creak.toml).")]) -> int:
    """Measure the rigs at this machine: cut periods, record, and send sums to the fleet's analysers.

    Example: `creak worker creak.toml`
    """
    _begin_log()
    settings = load_service(config)
    for index, table in enumerate(settings.rigs):
        if isinstance(table.source, StreamSource):
            key = f"rigs[{index}].source.kind"
            raise ConfigurationError(
                str(config), key, "'stream' is what analyse reads; a worker measures: simulated, can or recording"
            )
    sources = [
        open_source(table, rig, str(config), f"rigs[{index}].source")
        for index, (table, rig) in enumerate(zip(settings.rigs, named_rigs(settings, str(config)), strict=True))
    ]
    make_folder(settings.data)
    prepare_loops()
    stream, parts = settings.stream, settings.recording
    whole_frames = stream.send == "frames"
    broker = _broker(stream)
    supervisor = Supervisor()
    workers, told = [], []
    for source in sources:
        recorder = Recorder(settings.data, max_bytes=parts.max_bytes, max_seconds=parts.max_seconds)
        sink = StreamSink(broker, stream.name, settings.data, retold, whole_frames=whole_frames, live=source.live)
        gatherer = Gatherer(source.run, whole_frames=whole_frames)
        watch = supervisor.watch(source.run.rig.name)
        workers.append(Worker(source, [recorder, sink, watch], gatherer=gatherer))
        told.append((gatherer, sink))
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        with served(stream.metrics_port, WorkerCollector(told, broker)), suppress(KeyboardInterrupt):
            for each in workers:
                each.start()
            supervisor.ready()
            while any(each.running for each in workers):
                time.sleep(_LOOK_SECONDS)
    finally:
        supervisor.stopping()
        deadline = time.monotonic() + _STOP_SECONDS
        for each in workers:
            each.stop(max(0.1, deadline - time.monotonic()))
        broker.close()
    errors = [each.error for each in workers if each.error is not None]
    if errors:
        raise ServiceError(str(errors[0])) from errors[0]
    return 0


def analyse(config: Annotated[Path, typer.Argument(help="Service file (creak.toml).")]) -> int:
    """Analyse what the fleet's workers send: one of any number of processes that share the rigs.

    Example: `creak analyse creak.toml`
    """
    _begin_log()
    settings = load_service(config)
    rigs = named_rigs(settings, str(config))
    for index, table in enumerate(settings.rigs):
        if not isinstance(table.source, StreamSource):
            key = f"rigs[{index}].source.kind"
            raise ConfigurationError(
                str(config), key, f"{table.source.kind!r} is what a worker measures; an analyser takes 'stream'"
            )
    plans = [plan_of(table, rig) for table, rig in zip(settings.rigs, rigs, strict=True)]
    store = open_store(settings.store_url, source=str(config), key="store.url")
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        broker = _broker(settings.stream)
        supervisor = Supervisor()
        supervisor.begin("analyser")
        supervisor.ready()
        analyser = _analyser(settings.stream, store, broker, plans)
        told = AnalyserCollector(analyser, broker)
        with served(settings.stream.metrics_port, told), suppress(KeyboardInterrupt):
            analyser.run(lambda now: supervisor.tick("analyser", now))
        supervisor.stopping()
        broker.close()
    finally:
        store.close()
    return 0


@contextmanager
def background_analysis(
    stream: StreamTable, store: Store, plans: Sequence[Plan], supervisor: Supervisor
) -> Iterator[None]:
    """Analyse rigs beside the caller, for as long as the context lasts."""
    broker = _broker(stream)
    analyser = _analyser(stream, store, broker, plans)
    supervisor.begin("analyser")
    watched = (lambda now: supervisor.tick("analyser", now),)
    thread = threading.Thread(target=analyser.run, args=watched, name="analyser", daemon=True)
    thread.start()
    try:
        yield
    finally:
        analyser.stop()
        thread.join(_STOP_SECONDS)
        broker.close()


def _broker(stream: StreamTable) -> Broker:
    if stream.credentials is not None and not stream.credentials.is_file():
        problem = f"{str(stream.credentials)!r} is no file"
        raise ConfigurationError("configuration", "stream.credentials", problem)
    limits = StreamLimits(stream.keep_seconds, stream.keep_bytes)
    return Broker(stream.url, stream.name, limits, stream.credentials)


def _analyser(stream: StreamTable, store: Store, broker: Broker, plans: Sequence[Plan]) -> Analyser:
    return Analyser(store, broker, stream.name, plans, lease=stream.lease_seconds, patience=stream.repair_seconds)


def _begin_log() -> None:
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    """End on SIGTERM as on Ctrl-C, so that recordings are closed and rigs given back."""
    raise KeyboardInterrupt
