"""The command ``creak model``: a healthy recording as the model; and such models read."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from creak.cli.progress import Tell, progress
from creak.cli.recordings import warn, whole_file
from creak.config.model_writer import model_toml
from creak.errors import InputError, MeasurementError, RecordingError
from creak.gap.periodic import PeriodicData, gather
from creak.gap.reference import measure
from creak.mechanics.structure import MeasuredResponse
from creak.mechanics.system import Model
from creak.records import Fault, Frame
from creak.sources.recording import Recording


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(model)


def model(
    recording: Annotated[Path, typer.Argument(metavar="REC", help="A recording, or the folder of its parts.")],
    *,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write (.toml).")],
    first_realisation: Annotated[int | None, typer.Option(help="First realisation that counts, from 0.")] = None,
    last_realisation: Annotated[int | None, typer.Option(help="Last realisation that counts.")] = None,
    linear: Annotated[
        bool, typer.Option("--linear", help="Count the recording's own distortion as a gap too: find its cause.")
    ] = False,
) -> None:
    """Take a healthy recording as the model, so that `diagnose` says what has changed since.

    Example: `creak model healthy.mcap --output healthy.toml`, then
    `creak diagnose today.mcap --model healthy.toml`
    """
    read = Recording(recording)
    with progress(None) as tell:
        data = gathered(read, first_realisation, last_realisation, tell)
        _measured(read, data)  # so that what cannot be a model is refused here
    chosen = None
    if first_realisation is not None or last_realisation is not None:
        chosen = int(data.realisation.min()), int(data.realisation.max())
    believed = MeasuredResponse(_beside(recording, output.parent), realisations=chosen, linear=linear)
    with whole_file(output, "--output") as file:
        file.write_text(model_toml(believed), encoding="utf-8")
    for line in read.losses:
        warn(line)


def with_response(believed: Model, source: Path, tell: Tell) -> Model:
    """Model with the response that its recording holds, read if it is of kind ``frf``.

    Parameters
    ----------
    believed : Model
    source : Path
        The model's file, beside which the recording is looked up.
    tell : callable

    Raises
    ------
    RecordingError
        If the recording cannot be read or holds no response matrix.
    """
    if not isinstance(believed, MeasuredResponse):
        return believed
    path = source.parent / believed.recording
    if not path.exists():
        raise RecordingError(f"{source}: recording: {believed.recording!r} is not there")
    first, last = believed.realisations or (None, None)
    return healthy([path], first, last, tell, believed)


def healthy(
    files: list[Path], first: int | None, last: int | None, tell: Tell, believed: MeasuredResponse | None = None
) -> MeasuredResponse:
    """Healthy recording as a model that names it from its own folder.

    Parameters
    ----------
    files : list of Path
        A recording, or the parts of one.
    first, last : int or None
        Realisations that count.
    tell : callable
    believed : MeasuredResponse, optional
        Model that names it, with effects that were added since.
    """
    recording = Recording(*files)
    data = gathered(recording, first, last, tell)
    if believed is None:
        chosen = int(data.realisation.min()), int(data.realisation.max())
        believed = MeasuredResponse(files[0].name if len(files) == 1 else ".", realisations=chosen)
    return replace(believed, response=_measured(recording, data).response)


def moved(believed: Model, source: Path, folder: Path) -> Model:
    """Model as it is to be written into another folder, its recording named from there."""
    if not isinstance(believed, MeasuredResponse):
        return believed
    return replace(believed, recording=_beside(source.parent / believed.recording, folder))


def gathered(recording: Recording, first: int | None, last: int | None, tell: Tell) -> PeriodicData:
    """Read the complete realisations that count.

    Raises
    ------
    InputError
        If the realisations are no range.
    RecordingError
        If none is complete.
    """
    for option, number in (("--first-realisation", first), ("--last-realisation", last)):
        if number is not None and number < 0:
            raise InputError(f"{option}: {number} is not allowed: should be 0 or more")
    if first is not None and last is not None and first > last:
        raise InputError(
            f"--last-realisation: {last} is not allowed: should be at least --first-realisation ({first})"
        )
    try:
        return gather(recording.run, _chosen(recording, first, last, tell))
    except MeasurementError as error:
        end = "the end" if last is None else str(last)
        chosen = "" if first is None and last is None else f" of the realisations {first or 0} to {end}"
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


def _measured(recording: Recording, data: PeriodicData) -> MeasuredResponse:
    try:
        return MeasuredResponse(str(recording.paths[0]), response=measure(recording.run.rig, data))
    except MeasurementError as error:
        raise RecordingError(f"{recording.paths[0]}: {error}") from None


def _beside(path: Path, folder: Path) -> str:
    """Path as seen from a folder."""
    return os.path.relpath(path.absolute(), folder.absolute())
