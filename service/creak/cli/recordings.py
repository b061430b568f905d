"""Commands that make and read recordings: simulate, import, replay."""

import json
import os
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import partial
from operator import add
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console

from creak.cli.display import ProgressBar, console, detection_table, element_line, level_table
from creak.cli.progress import prepare_loops, progress
from creak.cluster import Cluster, Here, connected
from creak.codec import parse_time
from creak.config.rig import load_rig
from creak.errors import ConfigurationError, InputError
from creak.records import RunStatus
from creak.replay import Newest, in_order, replayed, summary
from creak.sinks.recorder import Recorder
from creak.sources.protocol import Source
from creak.sources.recording import recordings
from creak.worker import drive

Output = Annotated[Path, typer.Option("--output", "-o", help="Recording to write (.mcap).")]
_MOST = 10**6  # realisations or periods of one command: more is a slip of the keyboard
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

    check_numbers(rms, seed, {"realisations": realisations, "steady-periods": steady_periods})
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
    files: Annotated[
        list[Path], typer.Argument(help="Recordings of one rig, in one file each or in parts, in any order.")
    ],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    method: Annotated[
        Literal["plain", "lpm"],
        typer.Option(help="plain: drop transient periods; lpm: keep all, and estimate the transient."),
    ] = "plain",
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Dask scheduler whose workers replay a recording each, for instance tcp://10.0.0.1:8786."
        ),
    ] = None,
) -> None:
    """Put a recording through the same pipeline as live data: the same numbers come out.

    Several recordings of one rig give the levels over all of them, and the alarms at the end of the last one.

    Example: `creak replay three-mass.mcap --json`
    """
    ordered = in_order(recordings(*files))
    parts = [tuple(path.resolve() for path in recording.paths) for recording in ordered]
    if scheduler is None:
        prepare_loops()
    if scheduler is None and len(parts) == 1:
        whole = replayed(parts[0], method, [ProgressBar("replaying", None)])
    else:
        done = 0
        with nullcontext(Here()) if scheduler is None else connected(scheduler) as place, progress() as tell:
            if isinstance(place, Cluster) and not place.threads:
                warn(f"the scheduler at {scheduler} has no workers yet; waiting for one")

            def next_one() -> None:
                nonlocal done
                done += 1
                tell(f"replaying, {done} of {len(parts)} recordings", done / len(parts))

            task = partial(replayed, method=method, ahead=scheduler is None)
            whole = place.reduce(task, parts, add, next_one)
    for told in whole.recordings:
        for line in told.damage:
            warn(line)
    document = summary(whole, method)
    if as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
        return
    _show(document)


def _show(document: dict[str, Any]) -> None:
    out = Console()
    recorded = document["recordings"]
    among = f" in {len(recorded)} recordings" if len(recorded) > 1 else ""
    out.print(
        f"{document['rig']}: {document['frames']} frames of {document['realisations']} realisations{among}, "
        f"{document['rejected_frames']} rejected" + (", file cut before its end" if document["truncated"] else ""),
        highlight=False,
    )
    out.print(level_table(document["nodes"], "all recordings" if among else "whole run"))
    for told in recorded if among else ():
        raised = [f"node {node} {state}" for node, state in told["alarms"].items() if state != "normal"]
        if raised:
            out.print(f"at the end of {', '.join(told['files'])}: {', '.join(raised)}", highlight=False)
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


def _more(realisations: int) -> str:
    return f" (so in {realisations} realisations)" if realisations > 1 else ""


def _record(source: Source, output: Path, frames: int | None, label: str) -> None:
    """Drive a source into a recording that appears under its name only when it is whole."""
    newest = Newest()
    with whole_file(output) as unfinished:
        recorder = Recorder(unfinished)
        prepare_loops()
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
        unfinished.touch()
        unfinished.unlink()
    except OSError as error:
        raise ConfigurationError(option, "", f"{output}: cannot be written: {error.strerror}") from None
    try:
        yield unfinished
        os.replace(unfinished, output)
    finally:
        unfinished.unlink(missing_ok=True)


def check_numbers(rms: float, seed: int, counts: Mapping[str, int]) -> None:
    """Refuse what no excitation can be made of; counts by the name of their option."""
    for option, count in counts.items():
        if not 1 <= count <= _MOST:
            raise InputError(f"--{option}: {count} is not allowed: should be a whole number from 1 to {_MOST}")
    if not 0 <= seed < 2**63:
        raise InputError(f"--seed: {seed} is not allowed: should be a whole number from 0 to 2^63 - 1")
    if not 0 < rms < float("inf"):
        raise InputError(f"--rms: {rms} is not allowed: should be a number above 0")


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
