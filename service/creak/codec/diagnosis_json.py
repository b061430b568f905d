"""A diagnosis as the JSON of ``creak diagnose --json`` and the API; the first keys are the public contract."""

from collections.abc import Mapping
from typing import Any

from creak.codec.json_face import number_json
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
        "unknown_probability": number_json(diagnosis.unknown_probability),
        "bands": [_band(band) for band in diagnosis.bands],
        "curves": [_curve(curve) for curve in diagnosis.curves],
        "tested": list(diagnosis.tested),
        "not_claimed": list(diagnosis.not_claimed),
        "validation": None if validation is None else _validation(validation),
    }


def _levels(gap: GapLevels) -> Json:
    return {
        "before_db": number_json(gap.before_db),
        "after_db": number_json(gap.after_db),
        "noise_db": number_json(gap.noise_db),
        "closed": number_json(gap.closed),
    }


def _node(node: NodeGap) -> Json:
    return {
        "name": node.name,
        "before_db": number_json(node.before_db),
        "after_db": number_json(node.after_db),
        "noise_db": number_json(node.noise_db),
        "linear_share": number_json(node.linear_share),
        "nonlinear_share": number_json(node.nonlinear_share),
        "noise_share": number_json(node.noise_share),
    }


def _where(place: MissingForce) -> Json:
    return {
        "at": list(place.at),
        "share": number_json(place.share),
        "band_hz": [number_json(edge) for edge in place.band_hz],
        "pattern": place.pattern,
        "residual": number_json(place.residual),
        "position": number_json(place.position),
        "position_standard_error": number_json(place.position_error),
    }


def _cause(cause: Cause) -> Json:
    return {
        "effect": cause.effect,
        "at": list(cause.at),
        "parameters": _numbers(cause.parameters),
        "standard_errors": _numbers(cause.standard_errors),
        "probability": number_json(cause.probability),
        "gap_after_db": number_json(cause.gap_after_db),
        "before": None if cause.before is None else _numbers(cause.before),
    }


def _correction(correction: LinearCorrection) -> Json:
    return {
        "element": correction.element,
        "parameter": correction.parameter,
        "from": number_json(correction.before),
        "to": number_json(correction.after),
        "standard_error": number_json(correction.standard_error),
    }


def _band(band: BandShare) -> Json:
    return {
        "node": band.node,
        "band_hz": [number_json(edge) for edge in band.band_hz],
        "gap_db": number_json(band.gap_db),
        "linear_share": number_json(band.linear_share),
        "nonlinear_share": number_json(band.nonlinear_share),
        "noise_share": number_json(band.noise_share),
        "linear_error": number_json(band.linear_error),
        "nonlinear_error": number_json(band.nonlinear_error),
        "noise_error": number_json(band.noise_error),
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
    return {name: number_json(value) for name, value in values.items()}


def _samples(values: Real) -> list[float | None]:
    return [number_json(value) for value in values.tolist()]
