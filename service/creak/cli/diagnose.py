"""The command ``creak diagnose``: where a recording departs from a model, why, and how far that can be closed."""

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Annotated

import typer

from creak.cli.diagnosis import show
from creak.cli.progress import progress
from creak.cli.recordings import warn, whole_file
from creak.cli.reference import gathered, moved, with_response
from creak.cli.reference import healthy as as_model
from creak.cluster import connected
from creak.codec.diagnosis_json import diagnosis_json
from creak.config.model import load_model
from creak.config.model_writer import model_toml
from creak.errors import ConfigurationError, InputError, RecordingError
from creak.gap.diagnose import diagnose as find
from creak.gap.diagnose import validate as hold
from creak.gap.view import check_stable
from creak.mechanics.steady import Each
from creak.mechanics.structure import MeasuredResponse
from creak.mechanics.system import assemble
from creak.records import Rig
from creak.sources.recording import Recording

_READING = 0.15  # share of the work that reading a recording is taken for


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(diagnose)


def diagnose(
    files: Annotated[list[Path], typer.Argument(metavar="REC...", help="A recording, or the parts of one.")],
    *,
    model: Annotated[
        Path | None, typer.Option("--model", help="Model file (model.toml): what is believed.")
    ] = None,
    healthy: Annotated[
        list[Path] | None,
        typer.Option("--healthy", help="In place of a model: a healthy recording; once for every part."),
    ] = None,
    first_healthy: Annotated[int | None, typer.Option(help="First realisation of it that counts, from 0.")] = None,
    last_healthy: Annotated[int | None, typer.Option(help="Last realisation of it that counts.")] = None,
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
    first_realisation: Annotated[int | None, typer.Option(help="First realisation that counts, from 0.")] = None,
    last_realisation: Annotated[int | None, typer.Option(help="Last realisation that counts.")] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Dask scheduler whose workers try the candidates, for instance tcp://10.0.0.1:8786."),
    ] = None,
    progress_fd: Annotated[int | None, typer.Option(hidden=True)] = None,
) -> None:
    """Find where a recording departs from a model, which effect causes it, and how far the gap shrinks.

    Example: `creak diagnose three-mass.mcap --model model-linear.toml --report gap.html`
    """
    if (model is None) == (not healthy):
        raise InputError("--model: give a model file, or a healthy recording with --healthy, and not both")
    source = model or (healthy or [Path()])[0]
    believed = load_model(model) if model else None
    recording = Recording(*files)
    other = None if validate is None else _other(validate, recording)
    rig = recording.run.rig
    with ExitStack() as scope:
        scope.enter_context(_naming(source, recording))
        if believed is not None and not isinstance(believed, MeasuredResponse):
            check_stable(assemble(believed, rig))  # before minutes are spent on reading
        page = None if report is None else scope.enter_context(whole_file(report, "--report"))
        saved = None if save_model is None else scope.enter_context(whole_file(save_model, "--save-model"))
        each: Each = map
        if scheduler is not None:
            cluster = scope.enter_context(connected(scheduler))
            each = cluster.map
            if not cluster.threads:
                warn(f"the scheduler at {scheduler} has no workers yet; waiting for one")
        tell = scope.enter_context(progress(progress_fd))
        if believed is None:
            believed = as_model(healthy or [], first_healthy, last_healthy, tell)
        else:
            believed = with_response(believed, source, tell)
        check_stable(assemble(believed, rig))
        data = gathered(recording, first_realisation, last_realisation, tell)
        found = find(rig, believed, data, lambda what, done: tell(what, _READING + (1 - _READING) * done), each)
        holding = None
        if other is not None:
            tell("the other recording", 1.0)
            holding = hold(rig, believed, found, gathered(other, None, None, _silent))
        if page is not None:
            from creak.report.page import write_page

            name = ", ".join(path.name for path in files)
            page.write_text(write_page(found, holding, recording.run, name, source.name), encoding="utf-8")
        if saved is not None and save_model is not None:
            saved.write_text(model_toml(moved(found.corrected, source, save_model.parent)), encoding="utf-8")
    for line in recording.losses:
        warn(line)
    if as_json:
        typer.echo(json.dumps(diagnosis_json(found, holding), indent=1, allow_nan=False))
    else:
        show(found, holding)


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


@contextmanager
def _naming(model: Path, recording: Recording) -> Iterator[None]:
    """Name the files of which an error speaks: the model's, and the recording that carries the rig."""
    try:
        yield
    except ConfigurationError as error:
        if error.source.startswith("rig "):
            raise ConfigurationError(str(recording.paths[0]), error.key, f"{error.problem} ({model})") from None
        if error.source == "model":
            raise ConfigurationError(str(model), error.key, error.problem) from None
        raise


def _silent(_what: str, _done: float) -> None:
    """Tell nobody."""
