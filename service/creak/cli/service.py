"""Commands that run the service: serve and demo."""

import contextlib
import ipaddress
import logging
import os
import signal
import socket
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from importlib.resources import as_file, files
from pathlib import Path
from types import FrameType
from typing import Annotated

import typer

from creak.analysis import Plan
from creak.api import listen_on
from creak.api.access import Access
from creak.api.process import ApiProcess, ApiSettings
from creak.cli.fleet import background_analysis
from creak.cli.live import LiveLevels
from creak.cli.progress import prepare_loops
from creak.cli.recordings import replay_line
from creak.cli.sources import make_folder, named_rigs, open_source, plan_of, simulated_rig
from creak.cli.supervision import Supervisor
from creak.codec import time_json
from creak.config.rig import load_rig
from creak.config.service import (
    ServiceSettings,
    load_service,
    parse_service,
)
from creak.config.stream import StreamSource
from creak.errors import InputError, ServiceError
from creak.jobs import JobRunner
from creak.monitor import Memory
from creak.records import Estimate, Rig, Run, RunEnd
from creak.sinks import keys
from creak.sinks.background import BackgroundStore
from creak.sinks.catalogue import CataloguedRecorder
from creak.sinks.inbox import Inbox
from creak.sinks.protocol import Sink
from creak.sinks.recorder import Recorder
from creak.sinks.restart import recorded_until, saved_memory
from creak.sinks.store import Store, StoreSink, open_store
from creak.sinks.upkeep import Upkeep
from creak.sources.protocol import Source
from creak.sources.simulated import SimulatedRig
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import Deliverer, DeliveryRules
from creak.webhooks.schedule import Schedule
from creak.worker import Worker

_log = logging.getLogger(__name__)

_STOP_SECONDS = 2.5

_DEMO_HEALTHY = 5  # realisations before the spring appears
_DEMO_QUICK = 10  # realisations that are played quickly, as the rig's past; then it goes on in real time
_DEMO_PACE = 36.0  # recorded seconds a second while it is quick: 72 s a realisation become 2 s


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    app.command()(demo)
    app.command()(serve)


def serve(
    config: Annotated[Path, typer.Argument(help="Service file (creak.toml).")],
    *,
    api_only: Annotated[bool, typer.Option(help="Show what others measure and analyse.")] = False,
) -> int:
    """Run the service: rigs, store, API, recordings.

    Example: `creak serve creak.toml`
    """
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(name)s: %(message)s")
    settings = load_service(config)
    rigs = named_rigs(settings, str(config))
    sources: list[Source] = []
    plans: list[Plan] = []
    if not api_only:
        for index, (table, rig) in enumerate(zip(settings.rigs, rigs, strict=True)):
            if isinstance(table.source, StreamSource):
                plans.append(plan_of(table, rig))
            else:
                sources.append(open_source(table, rig, str(config), f"rigs[{index}].source"))
    with closing(listen_on(settings.server.host, settings.server.port)) as listener:
        return _run(settings, str(config), rigs, sources, listener, [[] for _ in sources], plans)


def demo(
    *,
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port of the API; 8300 if not given.")] = None,
    output: Annotated[Path | None, typer.Option("--output", help="Directory; creak-demo if not given.")] = None,
) -> int:
    """Run the flexible-beam rig, live, until Ctrl-C: after some healthy realisations a spring appears at node 3.

    Example: `creak demo --port 8300 --output creak-demo`
    """
    logging.basicConfig(level=logging.ERROR, format="%(levelname)s %(name)s: %(message)s")
    with as_file(files("creak") / "examples" / "beam") as example:
        settings = _demo_settings(example, port, output)
        table = settings.rigs[0]
        rig = load_rig(table.rig)
        source = simulated_rig(
            table, rig, changes=[(_DEMO_HEALTHY, example / "model-cubic.toml")], past=_DEMO_QUICK
        )
    with closing(listen_on(settings.server.host, settings.server.port)) as listener:
        _empty_store(settings)
        host, number, *_ = listener.getsockname()
        address = f"http://{host}:{number}"
        display = LiveLevels(
            f"for {_DEMO_HEALTHY} realisations the beam is healthy; then a cubic spring appears at node 3",
            {
                "look": f"{address}/",
                "ask": f"curl {address}/api/v1/alarms",
                "recorded": f"{settings.data}{os.sep}",
                "end": "Ctrl-C",
            },
        )
        return _run(settings, "demo", [rig], [source], listener, [[display, _IntoThePresent(source)]])


def _demo_settings(example: Path, port: int | None, output: Path | None) -> ServiceSettings:
    tables = {
        "data": "creak-demo",
        "rigs": [
            {
                "rig": str((example / "rig.toml").absolute()),
                "model": str((example / "model.toml").absolute()),
                "window": 2,  # as in the paper: its six experiments are two realisations of three
                "source": {
                    "kind": "simulated",
                    "rms": 0.02,
                    "steady_periods": 3,
                    "seed": int(time.time()),
                    "pace": _DEMO_PACE,
                },
            }
        ],
    }
    settings = parse_service(tables, "demo", Path())
    given: dict[str, object] = {}
    if port is not None:
        given["server"] = settings.server.model_copy(update={"port": port})
    if output is not None:
        given["data"] = output
    return settings.model_copy(update=given)


class _IntoThePresent:
    """Sink that lets the demo go on in real time once its quick past has been played."""

    def __init__(self, source: SimulatedRig) -> None:
        self._source = source

    def open(self, run: Run) -> None:
        pass

    def take(self, record: object) -> None:
        if isinstance(record, Estimate) and record.realisation >= _DEMO_QUICK - 1:
            self._source.pace = 1.0

    def tick(self, now: float) -> None:
        pass

    def close(self, end: RunEnd) -> None:
        pass


def _empty_store(settings: ServiceSettings) -> None:
    """Every demo begins with no history: an alarm in its list is its own."""
    if not settings.store.url:
        for suffix in ("", "-wal", "-shm"):
            (settings.data / f"creak.db{suffix}").unlink(missing_ok=True)


def _run(
    settings: ServiceSettings,
    file: str,
    rigs: Sequence[Rig],
    sources: Sequence[Source],
    listener: socket.socket,
    displays: Sequence[Sequence[Sink]],
    plans: Sequence[Plan] = (),
) -> int:
    """Run workers and API until a signal; the exit code."""
    make_folder(settings.data)
    prepare_loops()
    signal.signal(signal.SIGTERM, _interrupt)
    store = open_store(settings.store_url, source=file, key="store.url")
    limits = settings.recording
    recorders = [
        Recorder(settings.data, max_bytes=limits.max_bytes, max_seconds=limits.max_seconds) for _ in sources
    ]
    inbox = Inbox(store)
    desks = [BackgroundStore(store, StoreSink(store), inbox=inbox) for _ in sources]
    supervisor = Supervisor()
    workers = [
        Worker(
            source,
            [desk, CataloguedRecorder(recorder, store, desk.do), *more, supervisor.watch(source.run.rig.name)],
            desk=desk,
            memory=_memory(store, source),
        )
        for source, desk, recorder, more in zip(sources, desks, recorders, displays, strict=True)
    ]
    hooks = settings.webhooks
    rules = DeliveryRules(
        timeout=hooks.timeout_seconds,
        per_minute=hooks.per_minute,
        schedule=Schedule(disable_after=hooks.disable_after_hours * 3600),
    )
    deliverer = Deliverer(store, AddressPolicy(hooks.allow), rules)
    upkeep = Upkeep(store, limits.budget_bytes)
    names = [rig.name for rig in rigs]
    models = {
        name: table.model for name, table in zip(names, settings.rigs, strict=True) if table.model is not None
    }
    access = _access(settings, listener, store)
    api = ApiProcess(ApiSettings(settings.store_url, names, access, models, settings.data), listener)
    jobs = settings.jobs
    runner = JobRunner(store, settings.data / "jobs", at_once=jobs.at_once, max_seconds=jobs.max_seconds)
    analysis = (
        background_analysis(settings.stream, store, plans, supervisor) if plans else contextlib.nullcontext()
    )
    try:
        deliverer.start()
        upkeep.start()
        for worker in workers:
            worker.start()
        runner.start()
        host, port, *_ = listener.getsockname()
        _log.info("listening on http://%s:%s", host, port)
        supervisor.ready()
        with contextlib.suppress(KeyboardInterrupt), analysis:
            api.run()
    finally:
        supervisor.stopping()
        api.end()
        deadline = time.monotonic() + _STOP_SECONDS
        for source in sources:
            source.close()
        for worker in workers:
            worker.stop(max(0.1, deadline - time.monotonic()))
        deliverer.stop(max(0.5, deadline - time.monotonic()))
        upkeep.stop()
        runner.stop(max(0.1, deadline - time.monotonic()))
        api.wait(max(0.1, deadline - time.monotonic()))
        store.close()
    for worker, recorder in zip(workers, recorders, strict=True):
        if worker.end is not None and recorder.paths:
            counts = worker.end.counts
            typer.echo(f"{counts.realisations} realisations, {counts.frames} frames recorded; to see them again:")
            typer.echo(replay_line(recorder.paths))
    errors = [worker.error for worker in workers if worker.error is not None]
    if errors:
        raise ServiceError(str(errors[0])) from errors[0]
    return 0


def _memory(store: Store, source: Source) -> Memory | None:
    """What the rig's monitor knew when it was last heard of; a run of the past begins with nothing.

    A simulated rig may have been ahead of the wall clock: its recorded time then goes on from where it was.
    """
    run = source.run
    if run.source == "recording":
        return None
    try:
        memory = saved_memory(store, run.rig.name)
    except InputError as error:
        _log.warning("%s: the monitor begins afresh: %s", run.rig.name, error)
        return None
    if memory is None:
        return None
    reached = max(memory.time, recorded_until(store, run.rig.name))
    if reached <= run.start:
        return memory
    if isinstance(source, SimulatedRig):
        source.run = replace(run, start=reached)
        return memory
    _log.warning(
        "%s: the monitor begins afresh: it knows of times up to %s, and this run begins at %s",
        run.rig.name,
        time_json(reached),
        time_json(run.start),
    )
    return None


def _access(settings: ServiceSettings, listener: socket.socket, store: Store) -> Access:
    """Beyond loopback requests need a key."""
    host = str(listener.getsockname()[0])
    needed = not ipaddress.ip_address(host.partition("%")[0]).is_loopback
    if needed:
        with store.read() as connection:
            if not keys.everyone(connection):
                _log.warning("%s is beyond loopback and there are no keys yet: make one with creak key add", host)
    return Access(keys=needed, allow=settings.webhooks.allow, per_second=settings.server.requests_per_second)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    """End on SIGTERM as on Ctrl-C, so that recordings are closed."""
    raise KeyboardInterrupt
