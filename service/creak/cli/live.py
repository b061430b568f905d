"""A rig as it runs, on a terminal: how far it is, levels as bars, alarms as they come."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, Final

from rich import box
from rich.console import Group
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar as Bar
from rich.table import Table
from rich.text import Text

from creak.cli.display import STATE_STYLES, console, decibels, probability
from creak.codec import alarm_line, time_json
from creak.digests import Outcome
from creak.records import (
    AlarmChange,
    AlarmState,
    Estimate,
    Fault,
    Frame,
    FrameStatus,
    NodeLevel,
    Run,
    RunEnd,
    Scope,
)

_DRAW_SECONDS = 0.2
_FULL_DB: Final = 30.0  # of a bar
_NEWS = 6
_HISTORY = 16
_SIGNAL_COLUMNS, _HISTORY_COLUMNS = 90, 108  # of the terminal, from which on there is room for them
_EIGHTHS = " ▏▎▍▌▋▊▉█"
_STEPS = "▁▂▃▄▅▆▇█"
_EVENT_STYLES = {"raised": "bold red", "cleared": "green", "acknowledged": "yellow"}


class LiveLevels:
    """Sink that shows one rig as it runs; nothing where there is no terminal.

    Parameters
    ----------
    story : str
        What there is to see.
    where : mapping of str to str
        Where to look further, each with a word that names it.
    """

    def __init__(self, story: str, where: Mapping[str, str]) -> None:
        self._story = story
        self._where = where
        screen = console()
        self._live = Live(console=screen, auto_refresh=False) if screen.is_terminal else None
        self._run: Run | None = None
        self._frames = dict.fromkeys(FrameStatus, 0)
        self._newest: Frame | None = None
        self._window: Estimate | None = None
        self._history: dict[str, deque[float | None]] = {}
        self._states: dict[str, AlarmState] = {}
        self._news: deque[Text] = deque(maxlen=_NEWS)
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
                for level in record.nodes:
                    past = self._history.setdefault(level.name, deque(maxlen=_HISTORY))
                    past.append(level.total_to_noise_db)
            case AlarmChange():
                if record.class_ == "process":
                    self._states[record.node] = record.state
                self._tell(record.time, alarm_line(record), _EVENT_STYLES.get(record.event, ""))
            case Fault():
                self._tell(record.time, record.message, "yellow")

    def tick(self, now: float) -> None:
        """Draw a few times a second."""
        if self._live is not None and now - self._drawn > _DRAW_SECONDS:
            self._live.update(self.picture(), refresh=True)
            self._drawn = now

    def close(self, end: RunEnd) -> None:
        """Leave the last picture standing."""
        if self._live is not None:
            self._live.update(self.picture(), refresh=True)
            self._live.stop()

    def picture(self) -> Group:
        """All that is known now."""
        assert self._run is not None
        rows: list[Any] = [self._head(self._run)]
        if self._window is None:
            rows.append(Text(" levels follow with the first complete realisations", style="dim"))
        else:
            rows.append(self._levels(self._window, self._run.limits.total_to_noise_db))
        rows += [Text(" ").append_text(line) for line in self._news]
        places = Table.grid(padding=(0, 1))
        for word, place in self._where.items():
            places.add_row(Text(f" {word}", style="dim"), Text(place))
        return Group(*rows, Text(), places)

    def _head(self, run: Run) -> Panel:
        frame, frames = self._newest, self._frames
        done = 0
        rows = Table.grid(padding=(0, 2), expand=True)
        rows.add_column(ratio=1)
        rows.add_column(width=24)
        if frame is None:
            rows.add_row(Text("waiting for the first frame"), "")
        else:
            done = frame.experiment * run.periods + frame.period + 1
            place = (
                f"realisation {frame.realisation + 1}, experiment {frame.experiment + 1} of {run.rig.q}, "
                f"period {frame.period + 1} of {run.periods}"
            )
            rows.add_row(Text(place), Bar(total=run.rig.q * run.periods, completed=done, width=24))
        counted = ", ".join(f"{count} {status.value}" for status, count in frames.items())
        rows.add_row(Text(f"frames: {counted}", style="dim"), "")
        return Panel(
            Group(rows, Text(self._story, style="italic")), title=f"creak · {run.rig.name}", title_align="left"
        )

    def _levels(self, window: Estimate, limit: float) -> Table:
        room = console().width
        signals, past = room >= _SIGNAL_COLUMNS, room >= _HISTORY_COLUMNS
        width = max(8, min(30, room - 68 - 8 * signals - (_HISTORY + 2) * past))
        table = Table(
            title=f" levels of the last {window.realisations} realisations, dB",
            title_justify="left",
            box=box.SIMPLE_HEAD,
            pad_edge=False,
            collapse_padding=True,
        )
        table.add_column(" node", no_wrap=True, min_width=5, max_width=16)
        for heading in (*(["signal"] if signals else []), "noise", "total/noise"):
            table.add_column(heading, justify="right", no_wrap=True)
        table.add_column(scale(limit, width), no_wrap=True, width=width)
        if past:
            table.add_column("lately", no_wrap=True, width=_HISTORY)
        table.add_column("classical", justify="right", style="dim", no_wrap=True)
        table.add_column("p", justify="right", no_wrap=True)
        table.add_column("alarm", no_wrap=True)
        for level in window.nodes:
            state = self._states.get(level.name, AlarmState.NORMAL).value
            table.add_row(
                f" {level.name}",
                *([decibels(level.signal_db)] if signals else []),
                decibels(_noise(level)),
                decibels(level.total_to_noise_db),
                bar(level.total_to_noise_db, limit, width),
                *([sparkline(self._history[level.name], limit)] if past else []),
                decibels(level.classical_total_to_noise_db),
                probability(level.p_value),
                Text(state.replace("_", " "), style=STATE_STYLES.get(state, "bold red")),
            )
        return table

    def _tell(self, time: int, line: str, style: str) -> None:
        clock = time_json(time)[11:19]
        self._news.append(Text(f"{clock} ", style="dim").append(line, style=style))


def bar(ratio: float | None, limit: float, width: int) -> Text:
    """A bar of `width` cells from 0 to 30 dB, green up to the limit and red beyond; the limit is marked."""
    share = 0.0 if ratio is None else min(max(ratio, 0.0) / _FULL_DB, 1.0)
    eighths = round(share * width * 8)
    whole, rest = divmod(eighths, 8)
    cells = "█" * whole + (_EIGHTHS[rest] if rest else "")
    drawn = Text(cells.ljust(width), style="green" if ratio is None or ratio < limit else "red")
    mark = _cell(limit, width)
    if mark >= len(cells):
        drawn = Text.assemble(drawn[:mark], ("┊", "dim"), drawn[mark + 1 :])
    return drawn


def scale(limit: float, width: int) -> Text:
    """Heading of the bars: where 0, the limit and the end lie."""
    text = "0" + " " * (width - 1)
    for value, word in ((limit, f"{limit:g}"), (_FULL_DB, f"{_FULL_DB:g}")):
        at = min(_cell(value, width), width - len(word))
        if text[max(at - 1, 0)] == " ":  # else there is no room
            text = text[:at] + word + text[at + len(word) :]
    return Text(text, style="dim")


def sparkline(ratios: Iterable[float | None], limit: float) -> Text:
    """The last ratios, a step each from 0 to 30 dB; a dot where there was none."""
    line = Text()
    for ratio in ratios:
        if ratio is None:
            line.append("·", style="dim")
            continue
        share = min(max(ratio, 0.0) / _FULL_DB, 1.0)
        line.append(_STEPS[round(share * (len(_STEPS) - 1))], style="green" if ratio < limit else "red")
    return line


def _cell(ratio: float, width: int) -> int:
    return min(int(max(ratio, 0.0) / _FULL_DB * width), width - 1)


def _noise(level: NodeLevel) -> float | None:
    return level.classical_noise_db if level.noise_db is None else level.noise_db
