"""The command ``creak diagnose``: where a recording departs from a model, why, and how far that can be closed."""

import json
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from creak.cli.progress import Tell, progress
from creak.cli.recordings import warn, whole_file
from creak.errors import ConfigurationError, InputError, MeasurementError, RecordingError
from creak.gap.periodic import PeriodicData, gather
from creak.gap.records import Diagnosis
from creak.records import Fault, Frame, Rig
from creak.sources.recording import Recording

_READING = 0.15  # share of the work that reading a recording is taken for


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(diagnose)


def diagnose(
    files: Annotated[list[Path], typer.Argument(metavar="REC...", help="A recording, or the parts of one.")],
    *,
    model: Annotated[Path, typer.Option("--model", help="Model file (model.toml): what is believed.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document.")] = False,
    report: Annotated[
        Path | None, typer.Option("--report", help="Page to write (.html): words, figures, pictures; one file.")
    ] = None,
    save_model: Annotated[
        Path | None, typer.Option("--save-model", help="Corrected model to write (.toml).")
    ] = None,
    validate: Annotated[
        Path | None, typer.Option("--validate", help="Recording at another amplitude: does the correction hold?")
    ] = None,
    first_realisation: Annotated[
        int | None, typer.Option(min=0, help="First realisation that counts, from 0.")
    ] = None,
    last_realisation: Annotated[int | None, typer.Option(min=0, help="Last realisation that counts.")] = None,
    progress_fd: Annotated[int | None, typer.Option(hidden=True)] = None,
) -> None:
    """Find where a recording departs from a model, which effect causes it, and how far the gap shrinks.

    Example: `creak diagnose three-mass.mcap --model model-linear.toml --report gap.html`
    """
    from creak.codec.diagnosis_json import diagnosis_json
    from creak.config.model import load_model
    from creak.gap.diagnose import diagnose as find
    from creak.gap.diagnose import validate as hold

    believed = load_model(model)
    recording = Recording(*files)
    other = None if validate is None else _other(validate, recording)
    rig = recording.run.rig
    with ExitStack() as outputs:
        page = None if report is None else outputs.enter_context(whole_file(report, "--report"))
        saved = None if save_model is None else outputs.enter_context(whole_file(save_model, "--save-model"))
        with progress(progress_fd) as tell:
            data = _gathered(recording, first_realisation, last_realisation, tell)
            try:
                found = find(rig, believed, data, lambda what, done: tell(what, _READING + (1 - _READING) * done))
            except ConfigurationError as error:
                raise _of_the_model(error, model, recording) from None
            holding = None
            if other is not None:
                tell("reading the other recording", 1.0)
                holding = hold(rig, found, _gathered(other, None, None, lambda what, done: None))
        if page is not None:
            from creak.report.page import write_page

            page.write_text(write_page(found, holding, recording.run, _title(files), str(model)), encoding="utf-8")
        if saved is not None:
            saved.write_text(_saved(found), encoding="utf-8")
    for line in recording.damage:
        warn(line)
    if as_json:
        typer.echo(json.dumps(diagnosis_json(found, holding), indent=1, allow_nan=False))
    else:
        from creak.cli.diagnosis import show

        show(found, holding)


def _gathered(recording: Recording, first: int | None, last: int | None, tell: Tell) -> PeriodicData:
    """Read the complete realisations that count."""
    if first is not None and last is not None and first > last:
        raise InputError(
            f"--last-realisation: {last} is not allowed: should be at least --first-realisation ({first})"
        )
    try:
        return gather(recording.run, _chosen(recording, first, last, tell))
    except MeasurementError as error:
        chosen = "" if first is None and last is None else f" of the realisations {first or 0} to {_end(last)}"
        raise RecordingError(f"{recording.paths[0]}: {error}{chosen}") from None


def _chosen(recording: Recording, first: int | None, last: int | None, tell: Tell) -> Iterator[Frame | Fault]:
    begun = -1
    for item in recording.frames():
        if item.realisation is not None:
            if (first is not None and item.realisation < first) or (last is not None and item.realisation > last):
                continue
            if item.realisation > begun:
                begun = item.realisation
                tell(f"reading realisation {begun}", 0.0)
        yield item


def _end(last: int | None) -> str:
    return "the end" if last is None else str(last)


def _other(path: Path, recording: Recording) -> Recording:
    """Open the recording that is to confirm the diagnosis: of the same rig, if at another amplitude."""
    other = Recording(path)
    if _measuring(other.run.rig) != _measuring(recording.run.rig):
        raise RecordingError(
            f"--validate: {path}: is of another rig ({other.run.rig.name!r}) than {recording.paths[0]} "
            f"({recording.run.rig.name!r}): nodes, sampling and hold should be the same"
        )
    return other


def _measuring(rig: Rig) -> tuple[object, ...]:
    return rig.nodes, rig.sample_rate, rig.period_samples, rig.hold


def _of_the_model(error: ConfigurationError, path: Path, recording: Recording) -> ConfigurationError:
    """Name the files of which an error speaks: the model's, and the recording that carries the rig."""
    if error.source.startswith("rig "):
        return ConfigurationError(f"{recording.paths[0]}", error.key, f"{error.problem} ({path})")
    if error.source == "model":
        return ConfigurationError(str(path), error.key, error.problem)
    return error


def _title(files: list[Path]) -> str:
    return ", ".join(path.name for path in files)


def _saved(found: Diagnosis) -> str:
    from creak.config.model_writer import model_toml

    return model_toml(found.corrected)
