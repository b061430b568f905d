"""The command that runs the paper's two studies."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from creak.cli.display import ProgressBar, level_table
from creak.codec import node_json
from creak.errors import ConfigurationError


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command()(paper)


def paper(
    *,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Directory for page and figures; creak-paper if not given."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document; page and figures only with --output.")
    ] = False,
) -> None:
    """Run the paper's two studies: three masses and a flexible beam, with its figures and a table of levels.

    Example: `creak paper --output paper`
    """
    directory = output if output is not None or as_json else Path("creak-paper")
    if directory is not None:
        _make(directory)
    from creak.paper import figures, page, studies

    results = {
        "three-mass": studies.run_three_masses(ProgressBar),
        "beam": studies.run_beam(ProgressBar),
    }
    document = {
        study: {
            run: [node_json(level, result.alarms[level.name]) for level in result.estimate.nodes]
            for run, result in runs.items()
        }
        for study, runs in results.items()
    }
    if directory is not None:
        pictures = figures.draw(results["three-mass"], results["beam"])
        text = page.render(results, pictures)
        for picture in pictures:
            (directory / picture.name).write_bytes(picture.png)
        (directory / "index.html").write_text(text, encoding="utf-8")  # last: the page shows what is there
    if as_json:
        typer.echo(json.dumps(document, indent=1, allow_nan=False))
        return
    out = Console()
    for study, runs in document.items():
        for run, nodes in runs.items():
            out.print(level_table(nodes, f"{study}, {run}"))
    out.print(f"{directory}/index.html", highlight=False, soft_wrap=True)


def _make(directory: Path) -> None:
    """Make the directory, or say what is wrong with it, before anything is computed."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        problem = f"{directory}: {error.strerror}; should be a directory that can be written to"
        raise ConfigurationError("--output", "", problem) from None
