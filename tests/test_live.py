"""The picture of a running rig: bars, limit, history, alarms and where to look, on terminals of every width."""

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from creak.cli import live
from creak.cli.live import LiveLevels, bar, scale, sparkline
from creak.records import AlarmChange, Fault, FaultKind
from recorded import END, START, records, run

RATIOS = st.floats(-50, 80, allow_nan=False)


def cells(text):
    """Eighths of cells that a bar fills."""
    return sum(8 if c == "█" else "▏▎▍▌▋▊▉".index(c) + 1 if c in "▏▎▍▌▋▊▉" else 0 for c in text.plain)


@given(ratio=RATIOS, limit=st.floats(0.5, 20), width=st.integers(4, 60))
def test_a_bar_is_as_long_as_its_ratio_and_never_longer_than_its_place(ratio, limit, width):
    drawn = bar(ratio, limit, width)
    assert drawn.cell_len == width
    assert cells(drawn) == pytest.approx(min(max(ratio, 0), 30) / 30 * width * 8, abs=0.5)
    assert ("red" in str(drawn.spans) + str(drawn.style)) == (ratio >= limit)


@given(ratios=st.lists(RATIOS | st.none(), max_size=20))
def test_a_history_has_a_step_each(ratios):
    line = sparkline(ratios, 3.0)
    assert line.cell_len == len(ratios)
    steps = [("▁▂▃▄▅▆▇█".index(c), r) for c, r in zip(line.plain, ratios, strict=True) if r is not None]
    assert [step for step, _ in sorted(steps)] == [step for step, _ in sorted(steps, key=lambda pair: pair[1])]


def test_the_limit_is_marked_where_its_bar_would_end():
    assert scale(3.0, 30).plain.index("3") == bar(None, 3.0, 30).plain.index("┊") == cells(bar(3.0, 3.5, 30)) // 8


@pytest.mark.parametrize("width", [60, 80, 100, 140])
def test_all_there_is_to_see_is_in_the_picture(width, monkeypatch):
    """Kills figures that are cut, an alarm that scrolls away under faults, a picture wider than its terminal."""
    screen = Console(file=io.StringIO(), width=width, force_terminal=False)
    monkeypatch.setattr(live, "console", lambda: screen)
    display = LiveLevels("a spring appears", {"look": "http://127.0.0.1:8300/", "end": "Ctrl-C"})
    display.open(run())
    screen.print(display.picture())  # before anything has come
    window = None
    for record in records():
        display.take(record)
        window = record if hasattr(record, "nodes") and record.scope == "window" else window
        display.tick(0.0)
    display.take(Fault(FaultKind.LOST, START, "a frame never came"))
    screen.print(display.picture())
    text = screen.file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert "levels follow with the first complete realisations" in text
    for said in ("realisation 6", "a spring appears", "http://127.0.0.1:8300/", "never came"):
        assert said in text
    (change,) = (record for record in records() if isinstance(record, AlarmChange))
    assert f"node {change.node}: raised at 9.5 dB" in text
    if width >= 80:
        assert "unacknowledged" in text
        for node in window.nodes:
            assert f" {node.name} " in text
            for value in (node.noise_db, node.total_to_noise_db, node.classical_total_to_noise_db):
                assert ("–" if value is None else f"{value:.1f}") in text
    display.close(END)
