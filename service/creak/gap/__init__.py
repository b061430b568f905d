"""The sim-to-real gap: where a recording departs from a model, which effect causes it, how far it shrinks."""

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
    Verdict,
)

__all__ = [
    "BandShare",
    "Cause",
    "Diagnosis",
    "ForceCurve",
    "GapLevels",
    "LinearCorrection",
    "MissingForce",
    "NodeGap",
    "Validation",
    "Verdict",
]
