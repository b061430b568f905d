"""A diagnosis on a terminal: the verdict in words, then the figures as tables."""

import math

from rich.console import Console
from rich.table import Table

from creak.gap.records import Cause, Diagnosis, NodeGap, Validation
from creak.report import words


def show(found: Diagnosis, holding: Validation | None) -> None:
    """Print a diagnosis on standard output."""
    out = Console()
    out.print(f"verdict: {words.verdict(found)}", style="bold", highlight=False, soft_wrap=True)
    for sentence in words.summary(found):
        out.print(sentence, highlight=False, soft_wrap=True)
    out.print(_nodes(found.nodes, f"gap, dB of the response, on {_held_out(found)}"))
    if found.causes:
        out.print(_causes(found.causes, "causes, in the order in which they were added"))
    if found.alternatives:
        out.print(_causes(found.alternatives, "alternatives that these data cannot tell from a cause"))
    for moved in found.linear_corrections:
        out.print(f"moved: {words.correction(moved)}", highlight=False, soft_wrap=True)
    if holding is not None:
        out.print(f"validation: {holding.conclusion}", style="bold", highlight=False, soft_wrap=True)
        out.print(_nodes(holding.nodes, "gap in the other recording, dB of the response"))
    for sentence in found.not_claimed:
        out.print(f"not claimed: {sentence}", highlight=False, soft_wrap=True)


def _held_out(found: Diagnosis) -> str:
    count = found.held_out_realisations
    if count == 0:
        return "the realisations that the fit has seen"
    return "1 realisation kept aside" if count == 1 else f"{count} realisations kept aside"


def _nodes(nodes: tuple[NodeGap, ...], title: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("node")
    for heading in ("before", "after", "noise", "linear", "nonlinear", "noise share"):
        table.add_column(heading, justify="right")
    for node in nodes:
        levels = (node.before_db, node.after_db, node.noise_db)
        shares = (node.linear_share, node.nonlinear_share, node.noise_share)
        table.add_row(node.name, *(f"{level:.1f}" for level in levels), *(_percent(share) for share in shares))
    return table


def _causes(causes: tuple[Cause, ...], title: str) -> Table:
    table = Table(title=title, title_justify="left")
    table.add_column("effect")
    table.add_column("parameters, 95 % interval", overflow="fold")
    table.add_column("probability", justify="right")
    table.add_column("gap after dB", justify="right")
    for cause in causes:
        table.add_row(
            words.effect_phrase(cause.effect, cause.at),
            "\n".join(words.parameters(cause)),
            f"{cause.probability:.3f}",
            f"{cause.gap_after_db:.1f}",
        )
    return table


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %" if math.isfinite(share) else "–"
