"""The command that plays a rig's controller on a CAN interface."""

import json
import queue
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from creak.cli.canlibraries import can_support
from creak.cli.display import console
from creak.config.can import CanSource
from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.config.service import load_service
from creak.errors import ConfigurationError, InputError, RigError
from creak.records import Frame
from creak.sources.simulated import SimulatedRig

if TYPE_CHECKING:
    from creak.sources.can_controller import Controller, DisturbedWay
    from creak.sources.can_frames import CanFrames

_BUS_OFF_FRAME = 0x40
_Probability = Annotated[float, typer.Option(min=0, max=1)]


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(rig)


@dataclass(frozen=True)
class _Events:
    """What happens once, at recorded seconds after the begin."""

    silence_at: float | None
    silence_for: float
    restart_at: float | None
    bus_off_at: float | None
    bus_errors: float


def rig(
    config: Annotated[Path, typer.Argument(help="Service file with a rig of source kind can, and its model.")],
    *,
    name: Annotated[str | None, typer.Option("--rig", help="Which of its rigs; the first CAN rig.")] = None,
    realisations: Annotated[int | None, typer.Option(min=1, help="How many; without end if not given.")] = None,
    rms: Annotated[float, typer.Option(help="RMS value of every input, in its unit.")] = 1.0,
    snr_db: Annotated[float | None, typer.Option("--snr-db", help="Signal-to-noise ratio.")] = 40.0,
    seed: Annotated[int, typer.Option(min=0, help="Of excitation and noise.")] = 1,
    pace: Annotated[float, typer.Option(min=0.001, help="Recorded seconds a second; 1 is real time.")] = 1.0,
    first_counter: Annotated[int, typer.Option(min=0, help="Counter of the first sample: see it wrap.")] = 0,
    lost: _Probability = 0.0,
    doubled: _Probability = 0.0,
    delayed: _Probability = 0.0,
    reordered: _Probability = 0.0,
    corrupted: _Probability = 0.0,
    bus_errors: _Probability = 0.0,
    delay: Annotated[float, typer.Option(min=0, help="Seconds that a delayed frame is late.")] = 0.02,
    jitter: Annotated[float, typer.Option(min=0, help="Standard deviation of every frame's delay, s.")] = 0.0,
    drift_ppm: Annotated[float, typer.Option(min=-1000, max=1000, help="How much its clock is slow.")] = 0.0,
    silence_at: Annotated[float | None, typer.Option(help="Seconds after which nothing is sent ...")] = None,
    silence_for: Annotated[float, typer.Option(help="... for so many seconds.")] = 3.0,
    restart_at: Annotated[float | None, typer.Option(help="Seconds after which it begins again.")] = None,
    bus_off_at: Annotated[
        float | None, typer.Option(help="Seconds after which its interface goes bus-off.")
    ] = None,
    fault_seed: Annotated[int, typer.Option(min=0, help="Of what goes wrong.")] = 1,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
) -> None:
    """Play a rig's controller: simulate the rig and send its samples on the CAN interface of its source.

    Example: `creak rig creak.toml --rms 0.02 --lost 0.001`
    """
    can_support()
    from creak.sources.can_controller import Controller, Disturbances, DisturbedWay
    from creak.sources.can_mapping import map_signals
    from creak.sources.can_sources import can_run
    from creak.sources.canbus import cannot_open, open_bus
    from creak.sources.dbc import Database

    settings = load_service(config)
    chosen = [
        (index, table, load_rig(table.rig))
        for index, table in enumerate(settings.rigs)
        if isinstance(table.source, CanSource) and table.source.interface is not None
    ]
    chosen = [entry for entry in chosen if name is None or entry[2].name == name]
    if not chosen:
        raise ConfigurationError(
            str(config), "rigs", "has no rig on a CAN interface" + (f" called {name!r}" if name else "")
        )
    index, table, measured = chosen[0]
    source = table.source
    assert isinstance(source, CanSource)
    if table.model is None:
        raise ConfigurationError(str(config), f"rigs[{index}].model", "is missing; a rig that is played needs one")
    if not 0 < rms < float("inf"):
        raise InputError(f"--rms: {rms} is not allowed: should be a number above 0")
    run = can_run(source, measured)
    mapping = map_signals(Database(source.dbc), source, run, str(config), f"rigs[{index}].source")
    unit = mapping.counting.unit(run)
    if first_counter % unit:
        raise InputError(f"--first-counter: {first_counter} is not allowed: should be a multiple of {unit}")
    try:
        controller = Controller(run, mapping, first_counter)
    except ValueError as error:
        raise ConfigurationError(str(config), f"rigs[{index}].source.signals", str(error)) from None
    try:
        bus = open_bus(source)
    except Exception as error:  # noqa: BLE001 - each interface has errors of its own
        raise cannot_open(source, error, config, f"rigs[{index}].source") from None
    believed = load_model(table.model)

    def simulated() -> SimulatedRig:
        return SimulatedRig(
            measured,
            believed,
            steady_periods=source.steady_periods,
            rms=rms,
            seed=seed,
            snr_db=snr_db,
            realisations=realisations,
        )

    way = DisturbedWay(
        Disturbances(lost, doubled, delayed, reordered, corrupted, delay, jitter, drift_ppm), fault_seed
    )
    events = _Events(silence_at, silence_for, restart_at, bus_off_at, bus_errors)
    sender = _Sender(bus, source.fd, pace, events, fault_seed)
    with bus:
        _play(simulated, controller, way, sender, events)
    summary = {"frames": sender.sent, "error_frames": sender.errors, "periods": sender.periods, **way.injected}
    if as_json:
        typer.echo(json.dumps(summary))
    else:
        console().print(
            ", ".join(f"{value} {key.replace('_', ' ')}" for key, value in summary.items()), highlight=False
        )


def _play(
    simulated: Any, controller: "Controller", way: "DisturbedWay", sender: "_Sender", events: _Events
) -> None:
    """Send period after period; begin again once if that is asked for."""
    begun = 0
    for life in range(2 if events.restart_at is not None else 1):
        source: SimulatedRig = simulated()
        last = begun
        with closing(source):
            for count, frame in enumerate(_ahead(source)):
                at = Frame(frame.realisation, frame.experiment, frame.period, begun + frame.time, frame.u, frame.y)
                frames, _ = way.send(controller.frames(at, count))
                last = at.time + round(source.run.rig.period_ns)
                if life == 0 and events.restart_at is not None and last > events.restart_at * 1e9:
                    stop = round(events.restart_at * 1e9)
                    sender.send(frames[frames.times < stop])
                    begun = stop
                    break
                sender.send(frames)
                sender.periods += 1
            else:
                begun = last
    sender.send(way.rest())


def _ahead(source: SimulatedRig) -> Iterator[Frame]:
    """The frames of a simulation that runs ahead of what is sent, so that sending never waits for it."""
    ready: queue.Queue[Frame | Exception | None] = queue.Queue(2 * source.run.rig.q * source.run.periods)
    stopped = threading.Event()

    def put(item: Frame | Exception | None) -> None:
        while not stopped.is_set():
            try:
                ready.put(item, timeout=0.1)
                return
            except queue.Full:
                continue

    def simulate() -> None:
        try:
            for frame in source.frames():
                put(frame)
            put(None)
        except Exception as error:  # noqa: BLE001 - it is raised where the frames are taken
            put(error)

    thread = threading.Thread(target=simulate, name="simulation", daemon=True)
    thread.start()
    try:
        while (item := ready.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item
    finally:
        stopped.set()
        source.close()
        thread.join(5.0)


class _Sender:
    """Sends frames when they are due."""

    def __init__(self, bus: Any, fd: bool, pace: float, events: _Events, seed: int) -> None:
        import numpy as np

        self._bus = bus
        self._fd = fd
        self._pace = pace
        self._events = events
        self._rng = np.random.default_rng((seed, 1))
        self._origin: float | None = None
        self._bus_off = events.bus_off_at
        self.sent = self.errors = self.periods = 0

    def send(self, frames: "CanFrames") -> None:
        """Send frames in their order, each at its recorded time, played at the pace."""
        import can

        from creak.sources.can_frames import EXTENDED

        if self._origin is None:
            self._origin = time.monotonic()
        what = self._events
        for row in range(len(frames)):
            at = int(frames.times[row]) * 1e-9
            wait = self._origin + at / self._pace - time.monotonic()
            if wait > 0.0005:
                time.sleep(wait)
            if self._bus_off is not None and at >= self._bus_off:
                self._bus_off = None
                self._error(_BUS_OFF_FRAME)
            if what.bus_errors and self._rng.random() < what.bus_errors:
                self._error(0x08)
            if what.silence_at is not None and what.silence_at <= at < what.silence_at + what.silence_for:
                continue
            length, identifier = int(frames.lengths[row]), int(frames.identifiers[row])
            message = can.Message(
                arbitration_id=identifier & ~EXTENDED,
                is_extended_id=bool(identifier & EXTENDED),
                data=frames.data[row, :length].tobytes(),
                is_fd=self._fd and length > 8,
                bitrate_switch=self._fd and length > 8,
            )
            try:
                self._bus.send(message, timeout=1.0)
            except (can.CanError, OSError) as error:
                raise RigError(f"frame {self.sent} could not be sent: {' '.join(str(error).split())}") from None
            self.sent += 1

    def _error(self, kind: int) -> None:
        import can

        self._bus.send(can.Message(arbitration_id=kind, is_error_frame=True, is_extended_id=False, data=bytes(8)))
        self.errors += 1
