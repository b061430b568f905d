"""Commands that make and read recordings: simulate, import, replay."""

import json
import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console

from creak.cli.display import ProgressBar, console, detection_table, element_line, level_table
from creak.codec import parse_time, summary_json
from creak.config.rig import load_rig
from creak.errors import ConfigurationError, InputError
from creak.quality import FLAWS
from creak.records import Estimate, Fault, FaultKind, Run, RunEnd, RunStatus, Scope
from creak.sinks.recorder import Recorder
from creak.sources.protocol import Source
from creak.worker import drive

Output = Annotated[Path, typer.Option("--output", "-o", help="Recording to write (.mcap).")]
RigFile = Annotated[Path, typer.Option("--rig", help="Rig file (rig.toml).")]


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    app.command()(simulate)
    app.command("import")(import_)
    app.command()(replay)


def simulate(
    *,
    model: Annotated[Path, typer.Option("--model", help="Model file (model.toml).")],
    rig: RigFile,
    output: Output,
    realisations: Annotated[int, typer.Option(help="Realisations, of as many experiments as inputs.")] = 10,
    rms: Annotated[float, typer.Option(help="RMS value of every input, in its unit.")] = 1.0,
    snr_db: Annotated[
        float | None, typer.Option("--snr-db", help="Signal-to-noise ratio of the responses; none if not given.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of excitation and noise.")] = 1,
    steady_periods: Annotated[int, typer.Option(help="Periods of an experiment after the transient ones.")] = 2,
    start: Annotated[str, typer.Option(help="Recorded time of the first sample, ISO 8601.")] = "1970-01-01",
) -> None:
    """Make a recording from a model.

    Example: `creak simulate --model model.toml --rig rig.toml --realisations 10 --rms 50 --snr-db 40
    --output three-mass.mcap`
    """
    from creak.config.model import load_model
    from creak.sources.simulated import SimulatedRig

    for option, number, least in (
        ("realisations", realisations, 1),
        ("seed", seed, 0),
        ("steady-periods", steady_periods, 1),
    ):
        if number < least:
            raise InputError(f"--{option}: {number} is not allowed: should be a whole number of at least {least}")
    if not (0 < rms < float("inf")):
        raise InputError(f"--rms: {rms} is not allowed: should be a number above 0")
    if snr_db is not None and not abs(snr_db) < 1000:
        raise InputError(f"--snr-db: {snr_db} is not allowed: should be a number of decibels")
    measured = load_rig(rig)
    believed = load_model(model)
    begin = _start(start)
    name = (
        f"simulated/{measured.name}/{believed!r}/{realisations}/{rms!r}/{snr_db!r}/{seed}/{steady_periods}/{begin}"
    )
    source = SimulatedRig(
        measured,
        believed,
        steady_periods=steady_periods,
        rms=rms,
        seed=seed,
        snr_db=snr_db,
        realisations=realisations,
        start=begin,
        run_id=_identity(name),
    )
    _record(source, output, realisations * measured.q * source.run.periods, "simulating")


def import_(
    *,
    files: Annotated[
        list[Path],
        typer.Argument(help="One .npz or .mat; or UFF 58 or CSV, one experiment a file; or CAN logs, with --dbc."),
    ],
    rig: RigFile,
    output: Output,
    start: Annotated[
        str | None, typer.Option(help="Recorded time of the first sample, ISO 8601; the epoch.")
    ] = None,
    dbc: Annotated[
        Path | None, typer.Option("--dbc", help="The files are CAN logs, described by this DBC.")
    ] = None,
    signals: Annotated[
        Path | None, typer.Option("--signals", help="TOML with the keys of [rigs.source.signals], beside --dbc.")
    ] = None,
    steady_periods: Annotated[
        int, typer.Option("--steady-periods", min=1, help="Of a CAN log's experiments, after the transient ones.")
    ] = 2,
    excitation: Annotated[
        Path | None, typer.Option(help="What the generator was to play (.npz, .mat); other inputs are refused.")
    ] = None,
) -> None:
    """Make a recording from measured data, or from CAN logs (BLF, ASC, TRC, candump, MF4).

    Example: `creak import measured.npz --rig rig.toml --output measured.mcap`
    """
    if dbc is not None:
        if start is not None:
            raise InputError("--start: is not allowed beside --dbc: a CAN log has times of its own")
        from creak.cli.canlogs import open_logs

        can_source = open_logs(files, dbc, signals, load_rig(rig), steady_periods, typer.echo)
        _record(can_source, output, None, "importing")
        return
    if signals is not None:
        raise InputError("--signals: is not allowed without --dbc")
    from creak.sources.measurement import Measurement, read_excitation, read_measurement
    from creak.sources.measurement_checks import check_excitation

    measured = load_rig(rig)
    begin = _start("1970-01-01" if start is None else start)
    u, y = read_measurement(files, measured)
    if excitation is not None:
        check_excitation(u, read_excitation(excitation), measured, str(files[0]), str(excitation))
    source = Measurement(u, y, measured, begin)
    _record(source, output, len(u) * source.run.periods, "importing")


def replay(
    files: Annotated[list[Path], typer.Argument(help="A recording, or the parts of one.")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    method: Annotated[
        Literal["plain", "lpm"],
        typer.Option(help="plain: drop transient periods; lpm: keep all, and estimate the transient."),
    ] = "plain",
) -> None:
    """Put a recording through the same pipeline as live data: the same numbers come out.

    Example: `creak replay three-mass.mcap --json`
    """
    from creak.sources.recording import Recording
    from creak.sources.settled import SettledSource

    recording = Recording(*files)
    newest = _Newest()
    source = SettledSource(recording) if method == "lpm" else recording
    monitor, end = drive(source, [newest, ProgressBar("replaying", None)])
    if end.status is RunStatus.INTERRUPTED:
        raise KeyboardInterrupt
    for line in recording.damage:
        warn(line)
    unavailable = (
        list(_too_few_windows(recording.run, newest)) if newest.estimate else ["no realisation is complete"]
    )
    rig = recording.run.rig
    document = summary_json(
        rig.name, monitor.counts, newest.estimate, monitor.alarms, recording.truncated, unavailable=unavailable
    )
    document["quality"] = newest.quality
    document["method"] = method
    if as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
        return
    out = Console()
    out.print(
        f"{document['rig']}: {document['frames']} frames of {document['realisations']} realisations, "
        f"{document['rejected_frames']} rejected" + (", file cut before its end" if document["truncated"] else ""),
        highlight=False,
    )
    out.print(level_table(document["nodes"], "whole run"))
    for element in document["elements"]:
        out.print(element_line(element), highlight=False, soft_wrap=True)
    if document["detection"]:
        out.print(detection_table(document["detection"]))
    for sentence in (*document["unavailable"], *document["remarks"]):
        out.print(sentence, highlight=False)
    for flaw in document["quality"]:
        out.print(
            f"{flaw['kind']}: {flaw['message']}{_more(flaw['realisations'])}", style="yellow", highlight=False
        )


def replay_line(paths: list[Path]) -> str:
    """The command that replays these parts, as one would type it."""
    return shlex.join(["creak", "replay", *(str(path) for path in paths)])


class _Newest:
    """Sink that keeps the newest estimate of the whole run and counts the windows that can be judged."""

    def __init__(self) -> None:
        self.estimate: Estimate | None = None
        self.windows = 0
        self.flaws: dict[FaultKind, list[Fault]] = {}

    def open(self, run: Run) -> None:
        pass

    def take(self, record: object) -> None:
        if isinstance(record, Fault) and record.kind in FLAWS:
            self.flaws.setdefault(record.kind, []).append(record)
        elif isinstance(record, Estimate):
            if record.scope is Scope.RUN:
                self.estimate = record
            elif record.nodes[0].p_value is not None:
                self.windows += 1

    @property
    def quality(self) -> list[dict[str, Any]]:
        """What is wrong with the data, a kind each: its first finding, and how many realisations have one."""
        return [
            {"kind": kind.value, "message": found[0].message, "realisations": len({f.realisation for f in found})}
            for kind, found in self.flaws.items()
        ]

    def tick(self, now: float) -> None:
        pass

    def close(self, end: RunEnd) -> None:
        pass


def _more(realisations: int) -> str:
    return f" (so in {realisations} realisations)" if realisations > 1 else ""


def _too_few_windows(run: Run, newest: _Newest) -> Iterator[str]:
    """Say so where no alarm could have stood however large the distortion."""
    limits = run.limits
    if 0 < newest.windows < limits.exceeding:
        yield (
            f"alarms need {limits.exceeding} of the last {limits.windows} windows above the limits; "
            f"the recording has {newest.windows}"
        )


def _record(source: Source, output: Path, frames: int | None, label: str) -> None:
    """Drive a source into a recording that appears under its name only when it is whole."""
    newest = _Newest()
    with whole_file(output) as unfinished:
        recorder = Recorder(unfinished)
        monitor, end = drive(source, [recorder, newest, ProgressBar(label, frames)])
        if end.status is RunStatus.INTERRUPTED:
            raise KeyboardInterrupt
    counts = monitor.counts
    for sentence in newest.estimate.unavailable if newest.estimate else ("no realisation is complete",):
        warn(sentence)
    for flaw in newest.quality:
        warn(f"{flaw['kind']}: {flaw['message']}{_more(flaw['realisations'])}")
    console().print(
        f"{output}: {counts.realisations} realisations, {counts.frames} frames that count, "
        f"{counts.rejected_frames} rejected",
        highlight=False,
        soft_wrap=True,
    )


@contextmanager
def whole_file(output: Path, option: str = "--output") -> Iterator[Path]:
    """A name beside the output to write to; takes its place if all goes well, and is gone if not."""
    if output.is_dir() or not output.parent.is_dir():
        problem = "is a directory" if output.is_dir() else f"there is no directory {output.parent}"
        raise ConfigurationError(option, "", f"{output}: {problem}; should be the name of a file")
    unfinished = output.with_name(f".{output.name}.{os.getpid()}.part")
    try:
        yield unfinished
        os.replace(unfinished, output)
    finally:
        unfinished.unlink(missing_ok=True)


def _start(text: str) -> int:
    try:
        return parse_time(text)
    except InputError as error:
        raise InputError(f"--start: {error}") from None


def _identity(name: str) -> str:
    import uuid

    return str(uuid.uuid5(uuid.NAMESPACE_OID, name))


def warn(line: str) -> None:
    """Say something that matters but does not end the command."""
    console().print(f"creak: {line}", style="yellow", highlight=False, soft_wrap=True)
