"""Command that runs the project's measurements: bench."""

import ast
import runpy
import sys
from pathlib import Path
from typing import Annotated

import typer

import creak
from creak.errors import InputError

PREFIX = "bench_"


def add_to(app: typer.Typer) -> None:
    """Register the command."""
    app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})(bench)


def bench(
    context: typer.Context,
    name: Annotated[str | None, typer.Argument(help="Which one; all are listed if not given.")] = None,
) -> None:
    """Measure: tables of figures, each a ratio or a rate; options after the name are the benchmark's own.

    Example: `creak bench estimator --json`
    """
    folder = _folder()
    known = {path.stem.removeprefix(PREFIX): path for path in sorted(folder.glob(f"{PREFIX}*.py"))}
    if name is None:
        for key, path in known.items():
            typer.echo(f"{key:14} {_title(path)}")
        return
    if name not in known:
        raise InputError(f"{name!r} is no benchmark; there are {', '.join(known)}")
    sys.argv = [f"creak bench {name}", *context.args]
    sys.path.insert(0, str(folder))
    runpy.run_path(str(known[name]), run_name="__main__")


def _folder() -> Path:
    """Where the benchmarks lie: beside the tests, in a clone of the repository."""
    for root in (Path.cwd(), Path(creak.__file__).parents[2]):
        if (root / "tests" / "bench").is_dir():
            return root / "tests" / "bench"
    raise InputError("the benchmarks lie in the repository, in tests/bench; run this in a clone of it")


def _title(path: Path) -> str:
    """First line of a benchmark's docstring."""
    return (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n")[0]
