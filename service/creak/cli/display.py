"""What commands show on a terminal: progress while they run, tables when they are done."""

from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from creak.codec import alarm_line, node_json
from creak.digests import Outcome
from creak.records import AlarmChange, AlarmState, Estimate, Fault, Frame, FrameStatus, Run, RunEnd, Scope

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


class LiveLevels:
    """Sink that shows one rig as it runs: realisation, frames, levels and alarm of every node.

    Parameters
    ----------
    lines : tuple of str
        What stands above the table.
    """

    def __init__(self, lines: tuple[str, ...]) -> None:
        self._lines = lines
        screen = console()
        self._live = Live(console=screen, auto_refresh=False) if screen.is_terminal else None
        self._run: Run | None = None
        self._frames = dict.fromkeys(FrameStatus, 0)
        self._newest: Frame | None = None
        self._window: Estimate | None = None
        self._states: dict[str, AlarmState] = {}
        self._news: list[str] = []
        self._drawn = float("-inf")

    def open(self, run: Run) -> None:
        """Begin to draw."""
        self._run = run
        if self._live is not None:
            self._live.start()

    def take(self, record: Outcome) -> None:
        """Keep what is shown."""
        match record:
            case Frame():
                self._frames[record.status] += 1
                self._newest = record
            case Estimate(scope=Scope.WINDOW):
                self._window = record
            case AlarmChange():
                if record.class_ == "process":
                    self._states[record.node] = record.state
                self._news.append(alarm_line(record))
            case Fault():
                self._news.append(record.message)

    def tick(self, now: float) -> None:
        """Draw a few times a second."""
        if self._live is not None and now - self._drawn > 0.2:
            self._live.update(self._draw(), refresh=True)
            self._drawn = now

    def close(self, end: RunEnd) -> None:
        """Leave the last picture standing."""
        if self._live is not None:
            self._live.update(self._draw(), refresh=True)
            self._live.stop()

    def _draw(self) -> Group:
        assert self._run is not None
        rows: list[Any] = [Text(line) for line in self._lines]
        if self._newest is not None:
            frame, run, frames = self._newest, self._run, self._frames
            rows.append(
                Text(
                    f"realisation {frame.realisation + 1}, experiment {frame.experiment + 1} of {run.rig.q}, "
                    f"period {frame.period + 1} of {run.periods}; "
                    f"frames: {frames[FrameStatus.ACCEPTED]} accepted, "
                    f"{frames[FrameStatus.TRANSIENT]} transient, {frames[FrameStatus.REJECTED]} rejected"
                )
            )
        if self._window is not None:
            nodes = [
                node_json(level, self._states.get(level.name, AlarmState.NORMAL)) for level in self._window.nodes
            ]
            rows.append(level_table(nodes, f"last {self._window.realisations} realisations"))
        rows += [Text(line, style="bold") for line in self._news[-5:]]
        return Group(*rows)


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
            _decibel(node["signal_db"]),
            _decibel(node["noise_db" if located else "classical_noise_db"]),
            _decibel(node["total_to_noise_db"]),
            _decibel(node["classical_total_to_noise_db"]),
            _probability(node["p_value"]),
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
        table.add_row(level["name"], *(_decibel(level[key]) for key in keys))
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


def _decibel(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _probability(value: float | None) -> str:
    if value is None:
        return "–"
    return f"{value:.2g}" if value > 1e-99 else "< 1e-99"
