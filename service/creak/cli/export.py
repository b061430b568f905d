"""The command ``creak export``: a recording for other programs."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from creak.cli.display import console
from creak.cli.progress import Tell, progress
from creak.cli.recordings import warn, whole_file
from creak.errors import InputError
from creak.notebook import Experiment, OpenedRecording, open_recording

_SUFFIXES = (".csv", ".mat", ".uff", ".unv")


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(export)


def export(
    files: Annotated[list[Path], typer.Argument(metavar="REC...", help="A recording, or the parts of one.")],
    *,
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write: .csv, .mat, .uff or .unv; see above.")
    ],
    levels: Annotated[bool, typer.Option("--levels", help="The trends of the levels instead (.csv).")] = False,
    first_realisation: Annotated[
        int | None, typer.Option(min=0, help="First realisation that counts, from 0.")
    ] = None,
    last_realisation: Annotated[int | None, typer.Option(min=0, help="Last realisation that counts.")] = None,
) -> None:
    """Write the samples of a recording for other programs, as `creak import` reads them.

    A MAT file holds all experiments, levels and alarms; CSV and UFF 58 hold one experiment a file, so several
    become NAME-0001.csv and so on.

    Example: `creak export three-mass.mcap --output three-mass.mat`
    """
    suffix = output.suffix.lower()
    if suffix not in _SUFFIXES:
        raise InputError(f"--output: {output}: should end in one of {', '.join(_SUFFIXES)}")
    if levels and suffix != ".csv":
        raise InputError(f"--output: {output}: levels are written as .csv")
    from creak.export import write_levels, write_mat

    recording = open_recording(*files)
    with ExitStack() as scope:
        if levels:
            path = scope.enter_context(whole_file(output))
            write_levels(path, recording.levels)
            written, what = [output], f"{len(recording.levels.times)} windows"
        else:
            tell = scope.enter_context(progress())
            found = _chosen(recording, first_realisation, last_realisation, tell)
            if suffix == ".mat":
                tell("writing", 0.5)
                write_mat(scope.enter_context(whole_file(output)), found, recording)
                written = [output]
            else:
                written = _one_a_file(output, found, recording, scope, tell)
            what = f"{len(found)} experiments of {len({e.realisation for e in found})} realisations"
    for line in recording.damage:
        warn(line)
    names = str(written[0]) if len(written) == 1 else f"{written[0]} to {written[-1].name}"
    console().print(f"{names}: {what}", highlight=False, soft_wrap=True)


def _chosen(recording: OpenedRecording, first: int | None, last: int | None, tell: Tell) -> list[Experiment]:
    """Experiments that can be read back: those of complete realisations that lack no transient period either."""
    found = []
    for experiment in recording.experiments(first, last):
        found.append(experiment)
        tell(f"reading realisation {experiment.realisation}", 0.0)  # how many there are is known at the end
    torn = {e.realisation for e in found if np.isnat(e.times).any()}
    if torn:
        warn(f"{len(torn)} realisations are left out: a transient period of them is missing")
    kept = [e for e in found if e.realisation not in torn]
    if not kept:
        raise InputError(f"{recording!r}: no realisation is complete among those that count")
    return kept


def _one_a_file(
    output: Path, experiments: list[Experiment], recording: OpenedRecording, scope: ExitStack, tell: Tell
) -> list[Path]:
    from creak.export import write_csv, write_uff

    write = write_csv if output.suffix.lower() == ".csv" else write_uff
    many = len(experiments) > 1
    written = []
    for number, experiment in enumerate(experiments, start=1):
        path = output.with_stem(f"{output.stem}-{number:04d}") if many else output
        write(scope.enter_context(whole_file(path)), experiment, recording)
        written.append(path)
        tell("writing", number / len(experiments))
    return written
