"""The paper's figures 6 to 9 and 12 to 16, as PNG files."""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from creak.paper.studies import Result, response, three_masses
from creak.records import Complex, Real

_COLOURS = {"node signal": "0.35", "total": "tab:blue", "noise": "tab:green", "nonlinear": "tab:red"}


@dataclass(frozen=True)
class Figure:
    """A picture with its number in the paper.

    Parameters
    ----------
    number : int
    title : str
    caption : str
        What is seen, a sentence or two.
    png : bytes
    """

    number: int
    title: str
    caption: str
    png: bytes

    @property
    def name(self) -> str:
        """File name."""
        return f"figure-{self.number:02d}.png"


def draw(masses: Mapping[str, Result], beam: Mapping[str, Result]) -> list[Figure]:
    """Draw all figures, in the paper's order.

    Parameters
    ----------
    masses : mapping of str to Result
        Runs ``linear`` and ``cubic``.
    beam : mapping of str to Result
        Runs ``k=0``, ``k=1``, ``k=10``.
    """
    cubic = masses["cubic"]
    true = response(*three_masses(0.0))
    legend = ("estimate, with the spring", "true, without it")
    figures = [
        Figure(
            6,
            "Three masses: BLA from the inputs to the nodes",
            "The cubic spring shifts and scatters every entry of S: seen everywhere, located nowhere.",
            _matrix(cubic, cubic.S, true, legend, ("S", "m/N"), hidden=None),
        ),
        Figure(
            7,
            "Three masses: classical analysis",
            "Residuals from the inputs: the distortion stands above the noise at all three nodes.",
            _distortion(cubic, classical=True),
        ),
        Figure(
            8,
            "Three masses: BLA from node to node",
            "Row i holds what acts on node i: its input on the diagonal, the other nodes beside it. Entries of "
            "low order; only row 3 feels the spring. The imposed network has no edge between nodes 1 and 3.",
            _matrix(cubic, _network(cubic.G_u, cubic.G_y), _true_network(true), legend, ("G", "m/N or 1"), cubic),
        ),
        Figure(
            9,
            "Three masses: networked analysis",
            "Residuals from the neighbours: the distortion stands above the noise at node 3 alone.",
            _distortion(cubic, classical=False),
        ),
        Figure(
            12,
            "Beam: BLA from the inputs to the nodes, k = 1 against k = 0",
            "Suspension modes near 5 and 6 Hz, the first internal mode at 32.5 Hz.",
            _matrix(beam["k=1"], beam["k=1"].S, beam["k=0"].S, ("k = 1", "k = 0"), ("S", "m/A"), hidden=None),
        ),
        Figure(
            13,
            "Beam, k = 1: classical analysis",
            "The distortion stands above the noise at every node.",
            _distortion(beam["k=1"], classical=True),
        ),
    ]
    captions = (
        "No node's distortion is dominant: total and noise agree.",
        "Node 3 stands about 10 dB clear, mainly at the resonances at which it moves.",
        "The same place, and more of it.",
    )
    for number, k, caption in zip((14, 15, 16), (0, 1, 10), captions, strict=True):
        picture = _distortion(beam[f"k={k}"], classical=False)
        figures.append(Figure(number, f"Beam, k = {k}: networked analysis", caption, picture))
    return figures


def _network(G_u: Complex, G_y: Complex) -> Complex:
    """Input of each node on the diagonal, the other nodes beside it."""
    return G_y + G_u[:, :, None] * np.eye(G_u.shape[1])


def _true_network(S: Complex) -> Complex:
    """``G_u,i = 1/Z_ii`` and ``G_ij = -Z_ij/Z_ii`` (2), arranged as by :func:`_network`."""
    Z = np.linalg.inv(S)
    G_u = 1 / np.einsum("fii->fi", Z)
    off = Z * (1 - np.eye(Z.shape[1]))
    return _network(G_u, -off * G_u[:, :, None])


def _matrix(
    result: Result,
    estimate: Complex,
    reference: Complex,
    legend: tuple[str, str],
    symbol: tuple[str, str],
    hidden: Result | None,
) -> bytes:
    """Moduli of a matrix of responses, estimate as dots over a reference line."""
    frequency, n = result.estimate.spectra.frequency, result.rig.n
    figure, axes = _canvas(n, n)
    # Entries that the imposed network lacks are zero in the estimate.
    for i in range(n):
        for j in range(n):
            panel = axes[i][j]
            if hidden is not None and not estimate[:, i, j].any():
                panel.set_axis_off()
                continue
            panel.semilogx(
                frequency, _db(np.abs(reference[:, i, j]) ** 2), "-", color="0.2", lw=1, label=legend[1]
            )
            panel.semilogx(
                frequency, _db(np.abs(estimate[:, i, j]) ** 2), ".", color="tab:blue", ms=2.5, label=legend[0]
            )
            index = f"{i + 1}{j + 1}"
            panel.set_title(f"${symbol[0]}_{{{index}}}$", fontsize=9)
            _dress(panel, frequency, last=i == n - 1, first=j == 0, unit=f"dB re 1 {symbol[1]}")
    _name(figure, axes[0][0])
    return _png(figure)


def _distortion(result: Result, *, classical: bool) -> bytes:
    """Node signals, total, noise and nonlinear distortion, a panel a node."""
    spectra = result.estimate.spectra
    frequency = spectra.frequency
    parts = {
        "node signal": spectra.signal,
        "total": spectra.classical_total if classical else spectra.total,
        "noise": spectra.classical_noise if classical else spectra.noise,
        "nonlinear": spectra.classical_nonlinear if classical else spectra.nonlinear,
    }
    figure, axes = _canvas(1, result.rig.n)
    lowest = min(np.percentile(_db(part[part > 0]), 1) for part in (parts["noise"], parts["total"]))
    highest = _db(parts["node signal"]).max()
    for i, node in enumerate(result.rig.nodes):
        panel = axes[0][i]
        for label, power in parts.items():
            there = power[:, i] > 0
            panel.semilogx(
                frequency[there], _db(power[there, i]), ".", ms=3, color=_COLOURS[label], label=label, alpha=0.8
            )
        panel.set_title(f"node {node.name}", fontsize=9)
        panel.set_ylim(lowest - 10, highest + 5)
        _dress(panel, frequency, last=True, first=i == 0, unit=f"dB re 1 {node.output}²")
    _name(figure, axes[0][0])
    return _png(figure)


def _canvas(rows: int, columns: int) -> tuple[Any, Any]:
    """Figure and its panels; without a display, and without the global state of pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas

    figure = Canvas(figsize=(10.0, 1.2 + (2.2 * rows if rows > 1 else 3.0)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=rows == 1)


def _dress(panel: Any, frequency: Real, *, last: bool, first: bool, unit: str) -> None:
    from matplotlib.ticker import FixedLocator, NullFormatter, StrMethodFormatter

    panel.set_xlim(frequency[0], frequency[-1])
    if frequency[-1] / frequency[0] < 100:  # one decade and a bit: powers of ten alone would be two labels
        panel.xaxis.set_major_locator(FixedLocator([1, 2, 5, 10, 20, 50, 100, 200, 500]))
    panel.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.grid(visible=True, which="both", alpha=0.2)
    panel.tick_params(labelsize=8, labelbottom=last)
    if last:
        panel.set_xlabel("frequency, Hz", fontsize=8)
    if first:
        panel.set_ylabel(unit, fontsize=8)


def _name(figure: Any, panel: Any) -> None:
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), fontsize=8, markerscale=3)


def _png(figure: Any) -> bytes:
    picture = BytesIO()
    figure.savefig(picture, format="png")
    return picture.getvalue()


def _db(power: Real) -> Real:
    return np.asarray(10 * np.log10(power), dtype=np.float64)
