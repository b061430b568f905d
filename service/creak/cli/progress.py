"""Progress of a computation that tells how far it is: a bar for a person, lines for a program, or nothing."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from creak.cli.display import console
from creak.preparation import prepare

Tell = Callable[[str, float], None]
"""Called with what is being done and the fraction done, 0 to 1."""


@contextmanager
def progress(descriptor: int | None = None) -> Iterator[Tell]:
    """Give a function that shows progress.

    Parameters
    ----------
    descriptor : int, optional
        File descriptor on which a program wants it, a line a step: fraction, tab, what is being done. Who closes
        its other end, ends the computation at the next step. Without it a bar is drawn if a terminal is there.
    """
    if descriptor is not None:
        with os.fdopen(descriptor, "w", buffering=1) as lines:
            yield lambda what, done: _write(lines.write, what, done)
        return
    screen = console()
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        console=screen,
        disable=not screen.is_terminal,
        transient=True,
    )
    with bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda what, done: bar.update(task, description=what, completed=done)


def prepare_loops() -> None:
    """Have the inner loops compiled, and say so to a person who waits for it."""
    with console().status("compiling the inner loops, the first time only"):
        prepare()


def _write(write: Callable[[str], int], what: str, done: float) -> None:
    write(f"{done:.4f}\t{what}\n")
