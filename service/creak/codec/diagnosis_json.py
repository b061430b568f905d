"""A diagnosis as the JSON of ``creak diagnose --json`` and the API; the first keys are the public contract."""

import math
from collections.abc import Mapping
from typing import Any

from creak.gap.records import (
    BandShare,
    Cause,
    Diagnosis,
    ForceCurve,
    GapLevels,
    LinearCorrection,
    MissingForce,
    NodeGap,
    Validation,
)
from creak.records import Real

Json = dict[str, Any]


def diagnosis_json(diagnosis: Diagnosis, validation: Validation | None = None) -> Json:
    """Show a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis
    validation : Validation, optional
        How far the corrected model holds in another recording.

    Returns
    -------
    dict
        Every number in it is finite or null.
    """
    return {
        "verdict": diagnosis.verdict.value,
        "gap": _levels(diagnosis.gap),
        "nodes": [_node(node) for node in diagnosis.nodes],
        "where": [_where(place) for place in diagnosis.where],
        "causes": [_cause(cause) for cause in diagnosis.causes],
        "alternatives": [
            {**_cause(alternative), "instead_of": alternative.instead_of} for alternative in diagnosis.alternatives
        ],
        "linear_corrections": [_correction(correction) for correction in diagnosis.linear_corrections],
        "held_out_realisations": diagnosis.held_out_realisations,
        "unknown_probability": _number(diagnosis.unknown_probability),
        "bands": [_band(band) for band in diagnosis.bands],
        "curves": [_curve(curve) for curve in diagnosis.curves],
        "tested": list(diagnosis.tested),
        "not_claimed": list(diagnosis.not_claimed),
        "validation": None if validation is None else _validation(validation),
    }


def _levels(gap: GapLevels) -> Json:
    return {
        "before_db": _number(gap.before_db),
        "after_db": _number(gap.after_db),
        "noise_db": _number(gap.noise_db),
        "closed": _number(gap.closed),
    }


def _node(node: NodeGap) -> Json:
    return {
        "name": node.name,
        "before_db": _number(node.before_db),
        "after_db": _number(node.after_db),
        "noise_db": _number(node.noise_db),
        "linear_share": _number(node.linear_share),
        "nonlinear_share": _number(node.nonlinear_share),
        "noise_share": _number(node.noise_share),
    }


def _where(place: MissingForce) -> Json:
    return {
        "at": list(place.at),
        "share": _number(place.share),
        "band_hz": [_number(edge) for edge in place.band_hz],
        "pattern": place.pattern,
        "residual": _number(place.residual),
        "position": _number(place.position),
        "position_standard_error": _number(place.position_error),
    }


def _cause(cause: Cause) -> Json:
    return {
        "effect": cause.effect,
        "at": list(cause.at),
        "parameters": _numbers(cause.parameters),
        "standard_errors": _numbers(cause.standard_errors),
        "probability": _number(cause.probability),
        "gap_after_db": _number(cause.gap_after_db),
        "before": None if cause.before is None else _numbers(cause.before),
    }


def _correction(correction: LinearCorrection) -> Json:
    return {
        "element": correction.element,
        "parameter": correction.parameter,
        "from": _number(correction.before),
        "to": _number(correction.after),
        "standard_error": _number(correction.standard_error),
    }


def _band(band: BandShare) -> Json:
    return {
        "node": band.node,
        "band_hz": [_number(edge) for edge in band.band_hz],
        "gap_db": _number(band.gap_db),
        "linear_share": _number(band.linear_share),
        "nonlinear_share": _number(band.nonlinear_share),
        "noise_share": _number(band.noise_share),
        "linear_error": _number(band.linear_error),
        "nonlinear_error": _number(band.nonlinear_error),
        "noise_error": _number(band.noise_error),
    }


def _curve(curve: ForceCurve) -> Json:
    return {
        "at": list(curve.at),
        "displacement": _samples(curve.displacement),
        "velocity": _samples(curve.velocity),
        "force": _samples(curve.force),
        "fitted": None if curve.fitted is None else _samples(curve.fitted),
    }


def _validation(validation: Validation) -> Json:
    return {
        "holds": validation.holds,
        "conclusion": validation.conclusion,
        "gap": _levels(validation.gap),
        "nodes": [_node(node) for node in validation.nodes],
        "refitted": _numbers(validation.refitted),
    }


def _numbers(values: Mapping[str, float]) -> Json:
    return {name: _number(value) for name, value in values.items()}


def _samples(values: Real) -> list[float | None]:
    return [_number(value) for value in values.tolist()]


def _number(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
