"""What commands show on a terminal: progress while they run, tables when they are done."""

from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from creak.digests import Outcome
from creak.records import AlarmState, Frame, Run, RunEnd

STATE_STYLES = {AlarmState.NORMAL.value: "green", AlarmState.RETURNED_UNACKNOWLEDGED.value: "yellow"}


def console() -> Console:
    """Console on standard error; it shows nothing that moves unless that is a terminal."""
    return Console(stderr=True)


class ProgressBar:
    """Sink that shows how many frames have passed.

    Parameters
    ----------
    label : str
    frames : int or None
        How many there will be, if that is known.
    """

    def __init__(self, label: str, frames: int | None) -> None:
        screen = console()
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("frames"),
            TimeRemainingColumn(),
            console=screen,
            disable=not screen.is_terminal,
            transient=True,
        )
        self._task = self._progress.add_task(label, total=frames)
        self._label = label

    def open(self, run: Run) -> None:
        """Show the bar."""
        self._progress.start()

    def take(self, record: Outcome) -> None:
        """Move on with every frame."""
        if isinstance(record, Frame):
            description = f"{self._label}, realisation {record.realisation + 1}"
            self._progress.update(self._task, advance=1, description=description)

    def tick(self, now: float) -> None:
        """Nothing is due."""

    def close(self, end: RunEnd) -> None:
        """Take the bar away."""
        self._progress.stop()


def level_table(nodes: list[dict[str, Any]], title: str) -> Table:
    """Table of node levels; where nothing is located, the noise is that of the classical analysis.

    Parameters
    ----------
    nodes : list of dict
        With the keys of ``replay --json``'s nodes.
    title : str
    """
    located = any(node["noise_db"] is not None for node in nodes)
    table = Table(title=title, title_justify="left")
    table.add_column("node")
    for heading in ("signal dB", "noise dB", "total/noise dB", "classical dB", "p"):
        table.add_column(heading, justify="right")
    table.add_column("alarm", no_wrap=True)
    for node in nodes:
        state = node["alarm"]
        table.add_row(
            node["name"],
            decibels(node["signal_db"]),
            decibels(node["noise_db" if located else "classical_noise_db"]),
            decibels(node["total_to_noise_db"]),
            decibels(node["classical_total_to_noise_db"]),
            probability(node["p_value"]),
            Text(state, style=STATE_STYLES.get(state, "bold red")),
        )
    return table


def detection_table(levels: list[dict[str, Any]]) -> Table:
    """Table of what the lines left out show; ``levels`` as in ``replay --json``'s ``detection``."""
    table = Table(title="mean level of a line", title_justify="left")
    table.add_column("node")
    for heading in ("excited dB", "odd dB", "even dB", "noise dB"):
        table.add_column(heading, justify="right")
    keys = ("excited_db", "odd_db", "even_db", "noise_db")
    for level in levels:
        table.add_row(level["name"], *(decibels(level[key]) for key in keys))
    return table


def element_line(element: dict[str, Any]) -> str:
    """Say between which points distortion acts.

    Parameters
    ----------
    element : dict
        With the keys of ``replay --json``'s elements.
    """
    ends = " and ".join("the ground" if end == "ground" else f"node {end}" for end in element["between"])
    sure = f"confidence {element['confidence']:.3g}" if element["separable"] else "not separable from others"
    return f"distortion acts between {ends}: share {element['share']:.3g}, {sure}"


def decibels(value: float | None) -> str:
    """A level with one digit; a dash where there is none."""
    return "–" if value is None else f"{value:.1f}"


def probability(value: float | None) -> str:
    """A p-value with two digits; a dash where there is none."""
    if value is None:
        return "–"
    return f"{value:.2g}" if value > 1e-99 else "< 1e-99"
