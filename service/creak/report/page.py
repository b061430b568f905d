"""A diagnosis as one page of HTML that a colleague can read: no script, and nothing is loaded from anywhere."""

import base64
from collections.abc import Iterable, Iterator
from html import escape
from importlib.resources import files

from creak.codec import time_json
from creak.gap.records import Cause, Diagnosis, NodeGap, Validation, Verdict
from creak.mechanics.vocabulary import VOCABULARY
from creak.records import Run
from creak.report import POLICY, figures, words


def write_page(diagnosis: Diagnosis, validation: Validation | None, run: Run, recording: str, model: str) -> str:
    """Write the page.

    Parameters
    ----------
    diagnosis : Diagnosis
    validation : Validation or None
        How far the correction holds in another recording, if that was asked.
    run : Run
        Of the recording.
    recording, model : str
        What the page calls them.

    Returns
    -------
    str
        HTML, complete.
    """
    style = (files("creak.report") / "page.css").read_text(encoding="utf-8")
    title = f"Gap between {recording} and {model}"
    body = [
        f"<h1>{escape(title)}</h1>",
        f"<p class=about>{escape(_about(diagnosis, run))}</p>",
        f"<div class='verdict {diagnosis.verdict.value}'><strong>Verdict: {words.verdict(diagnosis)}</strong>",
        *(_paragraph(sentence) for sentence in words.summary(diagnosis)),
        "</div>",
        *_gap(diagnosis),
        *_where(diagnosis),
        *_causes(diagnosis),
        *_validation(validation),
        *_limits(diagnosis),
        *_reading(),
    ]
    return (
        "<!doctype html>\n<html lang=en>\n<head>\n<meta charset=utf-8>\n"
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name=viewport content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def _about(diagnosis: Diagnosis, run: Run) -> str:
    kept = diagnosis.held_out_realisations
    aside = f"{kept} realisation{'' if kept == 1 else 's'} kept aside" if kept else "no realisation to keep aside"
    excitation = "" if run.excitation.rms is None else f", excited with {run.excitation.rms:g} rms an input"
    return f"Rig {run.rig.name}, recorded from {time_json(run.start)}{excitation}; {aside}."


def _gap(diagnosis: Diagnosis) -> Iterator[str]:
    yield "<h2>How large the gap is</h2>"
    picture = figures.nodes_picture(diagnosis.nodes)
    yield _picture(picture, "Gap at each node before and after, and the noise.")
    yield _node_table(diagnosis.nodes)
    if diagnosis.bands:
        yield _picture(
            figures.bands_picture(diagnosis.bands, diagnosis.nodes),
            "Where in frequency each node's gap lies, in per cent of the node's gap, and how it divides.",
        )


def _where(diagnosis: Diagnosis) -> Iterator[str]:
    if not diagnosis.where:
        return
    yield "<h2>Where it lies</h2>"
    yield _table(
        ["place", "share of the gap", "90 % of the force within", "power it leaves, noise = 1"],
        [
            [
                words.missing_place(force),
                words.percent(force.share),
                f"{force.band_hz[0]:.4g} to {force.band_hz[1]:.4g} Hz",
                f"{force.residual:.3g}",
            ]
            for force in diagnosis.where
        ],
    )
    for curve in diagnosis.curves:
        yield f"<h3>Missing force {escape(words.place(curve.at))}</h3>"
        law = " and what the diagnosed effects give for the same motion" if curve.fitted is not None else ""
        yield _picture(figures.curve_picture(curve), f"Measured force over displacement and velocity{law}.")


def _causes(diagnosis: Diagnosis) -> Iterator[str]:
    if diagnosis.verdict is Verdict.NO_GAP:
        return
    yield "<h2>What causes it</h2>"
    if diagnosis.causes:
        yield _cause_table(diagnosis.causes)
    else:
        yield _paragraph("No effect is named: none of those that were tried explains what was measured.")
    outside = _probability(diagnosis.unknown_probability)
    yield _paragraph(f"Probability that it is none of the effects that were tried: {outside}.")
    yield _picture(figures.waterfall_picture(diagnosis), "The gap, step by step.")
    if diagnosis.alternatives:
        yield "<h3>Alternatives that these data cannot tell apart</h3>"
        for index, cause in enumerate(diagnosis.causes):
            others = [other for other in diagnosis.alternatives if other.instead_of == index]
            if others:
                yield _paragraph(f"Instead of {words.effect_phrase(cause.effect, cause.at)}:")
                yield _cause_table(others)
    if diagnosis.linear_corrections:
        yield "<h3>Numbers of the model that had to move</h3>"
        yield _list(words.correction(moved) for moved in diagnosis.linear_corrections)


def _validation(validation: Validation | None) -> Iterator[str]:
    if validation is None:
        return
    yield "<h2>Does it hold in the other recording?</h2>"
    yield _paragraph(validation.conclusion)
    yield _picture(figures.nodes_picture(validation.nodes), "Gap in the other recording, which no fit has seen.")
    yield _node_table(validation.nodes)
    if validation.refitted:
        yield _table(
            ["parameter", "fitted to the other recording"],
            [[name, f"{value:.6g}"] for name, value in validation.refitted.items()],
        )


def _limits(diagnosis: Diagnosis) -> Iterator[str]:
    yield "<h2>What was not tested, and what is not claimed</h2>"
    untried = [effect for effect in VOCABULARY if effect not in diagnosis.tested]
    said = list(diagnosis.not_claimed)
    if diagnosis.tested and untried:
        said.append(f"Not tried: {', '.join(effect.replace('_', ' ') for effect in untried)}.")
    if diagnosis.tested:
        said.append(f"Tried: {', '.join(effect.replace('_', ' ') for effect in diagnosis.tested)}.")
    else:
        said.append("No effect was tried, since there was no gap to explain.")
    yield _list(said)


def _reading() -> Iterator[str]:
    yield "<h2>How to read this</h2>"
    yield _paragraph(
        "The gap is the power of measured minus simulated over that of measured, over all frequencies, in dB: at "
        "0 dB the model says nothing about the structure, at −20 dB a hundredth of the power is left. It is "
        "computed by simulating anew the realisations kept aside. Noise is what the same figure would be for a "
        "perfect model. The linear part of a gap is what follows the inputs linearly: wrong masses, stiffnesses "
        "and dampings, and what a nonlinear effect adds to them on average; the rest above noise is nonlinear "
        "distortion. The missing force is what the structure felt beyond what the model says; intervals hold "
        "the true value in 95 of 100 repetitions."
    )


def _node_table(nodes: Iterable[NodeGap]) -> str:
    return _table(
        ["node", "before", "after", "noise", "of the gap before"],
        [
            [
                node.name,
                *(f"{level:.1f} dB" for level in (node.before_db, node.after_db, node.noise_db)),
                words.split(node),
            ]
            for node in nodes
        ],
        text=(0, 4),
    )


def _cause_table(causes: Iterable[Cause]) -> str:
    return _table(
        ["effect", "parameters with 95 % intervals", "probability", "gap after"],
        [
            [
                words.effect_phrase(cause.effect, cause.at),
                "; ".join(words.parameters(cause)),
                _probability(cause.probability),
                _decibels(cause.gap_after_db),
            ]
            for cause in causes
        ],
        text=(0, 1),
    )


def _decibels(level: float) -> str:
    return f"{level:.1f} dB"


def _probability(value: float) -> str:
    if value < 0.001:
        return "below 0.001"
    return f"{value:.3f}" if value <= 0.999 else "above 0.999"


def _picture(svg: str, caption: str) -> str:
    # as an image and not in line: ids inside one picture then cannot meet those of another
    source = "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode()
    said = escape(caption, quote=True)
    return f'<figure><img alt="{said}" src="{source}"><figcaption>{said}</figcaption></figure>'


def _paragraph(text: str) -> str:
    return f"<p>{escape(text)}</p>"


def _list(items: Iterable[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def _table(headings: list[str], rows: list[list[str]], text: tuple[int, ...] = (0,)) -> str:
    def cells(tag: str, values: list[str]) -> str:
        return "".join(
            f"<{tag}{' class=text' if i in text else ''}>{escape(value)}</{tag}>" for i, value in enumerate(values)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table><thead><tr>{cells('th', headings)}</tr></thead><tbody>{body}</tbody></table>"
