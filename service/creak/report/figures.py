"""Pictures of a diagnosis as SVG, drawn without a display and the same for the same diagnosis."""

import io
import math
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from creak.gap.records import BandShare, Cause, Diagnosis, ForceCurve, NodeGap
from creak.report import words

# Okabe and Ito's colours, which those who do not tell red from green can tell apart
BEFORE, AFTER, NOISE, MEASURED = "#d55e00", "#0072b2", "#767676", "#c9a66b"
LINEAR, NONLINEAR = "#56b4e9", "#cc79a7"

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",  # text stays text: it can be searched, and looks like the page around it
    "svg.hashsalt": "creak",
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Helvetica", "Arial", "sans-serif"],
    "font.size": 10,
    "text.parse_math": False,  # a node may be called "$3$"
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "axes.axisbelow": True,
}
_MOST_NODES = 6  # panels of bands: the nodes with the largest gap


def nodes_picture(nodes: Sequence[NodeGap], before: str = "model as it is", after: str = "corrected model") -> str:
    """Gap before and after at each node, against the noise floor."""
    with mpl.rc_context(_STYLE):
        figure, axes = _figure(6.4, 1.1 + 0.42 * len(nodes))
        rows = range(len(nodes))
        for row, node in zip(rows, nodes, strict=True):
            axes.plot([node.after_db, node.before_db], [row, row], color="#bbbbbb", linewidth=2, zorder=1)
        noise = [node.noise_db for node in nodes]
        axes.scatter([node.before_db for node in nodes], rows, color=BEFORE, s=55, label=before, zorder=3)
        axes.scatter([node.after_db for node in nodes], rows, color=AFTER, s=55, label=after, zorder=3)
        axes.scatter(noise, rows, color=NOISE, marker="|", s=260, linewidths=2, label="noise", zorder=2)
        axes.set_yticks(rows, [f"node {node.name}" for node in nodes])
        axes.set_ylim(len(nodes) - 0.5, -0.5)
        axes.set_xlabel("gap, dB of the node's response")
        _legend_above(axes)
        return _svg(figure)


def waterfall_picture(diagnosis: Diagnosis) -> str:
    """Gap of the model as it is, after each effect that was added, and of noise alone."""
    gap = diagnosis.gap
    steps = [("model as it is", gap.before_db, BEFORE)]
    steps += [(f"+ {_short(cause)}", cause.gap_after_db, AFTER) for cause in diagnosis.causes]
    if diagnosis.linear_corrections or not diagnosis.causes:
        steps.append(("corrected model", gap.after_db, AFTER))
    floor = min([gap.noise_db, *(level for _, level, _ in steps)]) - 3
    with mpl.rc_context(_STYLE):
        figure, axes = _figure(6.4, 1.1 + 0.42 * len(steps))
        rows = range(len(steps))
        lengths = [level - floor for _, level, _ in steps]
        axes.barh(rows, lengths, left=floor, color=[color for *_, color in steps], height=0.6)
        for row, (_, level, _) in zip(rows, steps, strict=True):
            axes.annotate(f"{level:.1f} dB", (level, row), xytext=(5, 0), textcoords="offset points", va="center")
        axes.axvline(gap.noise_db, color=NOISE, linestyle="--", label=f"noise, {gap.noise_db:.1f} dB")
        axes.set_yticks(rows, [label for label, *_ in steps])
        axes.set_ylim(len(steps) - 0.5, -0.5)
        axes.set_xlim(floor, max(level for _, level, _ in steps) + 0.14 * (gap.before_db - floor + 1))
        axes.set_xlabel("gap, dB of the response, mean over the nodes")
        _legend_above(axes)
        return _svg(figure)


def bands_picture(bands: Sequence[BandShare], nodes: Sequence[NodeGap]) -> str:
    """Where in frequency each node's gap lies, and how it divides there."""
    largest = sorted(nodes, key=lambda node: -node.before_db)[:_MOST_NODES]
    names = [node.name for node in nodes if node in largest]
    height = math.ceil(len(names) / 2)
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 0.8 + 2.4 * height), layout="constrained")
        panels = figure.subplots(height, min(2, len(names)), squeeze=False)
        for panel, name in zip(panels.flat, names, strict=False):
            _stack(panel, sorted((band for band in bands if band.node == name), key=lambda band: band.band_hz))
            panel.set_title(f"node {name}", loc="left", fontsize=10)
            panel.set_ylabel("% of the gap")
            panel.set_xlabel("band, Hz")
        for panel in panels.flat[len(names) :]:
            panel.set_visible(False)
        handles = panels.flat[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper center", ncols=3, frameon=False)
        return _svg(figure)


def _stack(panel: Any, bands: Sequence[BandShare]) -> None:
    """One bar a band, as high as what the band adds to the node's gap."""
    powers = np.array([10 ** (band.gap_db / 10) for band in bands])
    percent = 100 * powers / (powers.sum() or 1.0)
    rows = np.arange(len(bands))
    base = np.zeros(len(bands))
    for label, color, shares in (
        ("linear part", LINEAR, [band.linear_share for band in bands]),
        ("nonlinear distortion", NONLINEAR, [band.nonlinear_share for band in bands]),
        ("noise", NOISE, [band.noise_share for band in bands]),
    ):
        heights = percent * np.maximum(shares, 0.0)
        panel.bar(rows, heights, 0.8, base, color=color, label=label)
        base += heights
    labels = ["–".join(f"{edge:.{0 if edge >= 100 else 1}f}" for edge in band.band_hz) for band in bands]
    panel.set_xticks(rows, labels, fontsize=7, rotation=30, rotation_mode="anchor", ha="right")
    panel.grid(visible=False, axis="x")


def curve_picture(curve: ForceCurve) -> str:
    """Missing force over displacement and over velocity as measured, and the fitted law for the same motion."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 3.6), layout="constrained")
        panels = figure.subplots(1, 2, sharey=True)
        for panel, motion, label in zip(
            panels, (curve.displacement, curve.velocity), ("displacement, m", "velocity, m/s"), strict=True
        ):
            panel.scatter(motion, curve.force, s=26, color=MEASURED, alpha=0.6, linewidths=0, label="measured")
            if curve.fitted is not None:
                panel.scatter(motion, curve.fitted, s=4, color=AFTER, linewidths=0, label="fitted law")
            panel.set_xlabel(label)
            panel.ticklabel_format(scilimits=(-2, 3), useMathText=False)
        panels[0].set_ylabel("missing force, N")
        handles = panels[0].get_legend_handles_labels()
        figure.legend(*handles, loc="outside upper left", ncols=2, frameon=False, markerscale=1.5)
        return _svg(figure)


def _figure(width: float, height: float) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots()


def _legend_above(axes: Any) -> None:
    axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False, borderaxespad=0.2)


def _short(cause: Cause) -> str:
    return f"{cause.effect.replace('_', ' ')} {words.where(cause.at)}"


def _svg(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue().decode()
