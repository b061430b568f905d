"""A diagnosis as a record, made without computing one: every kind of entry is in it, and names that need care."""

import numpy as np

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
from creak.mechanics.structure import Lumped, PointMass

AWKWARD = "<b>3&$_$"  # a name that would break a page which does not escape it
MODEL = Lumped((PointMass("1", 1.0), PointMass(AWKWARD, 1.2)), ())


def nodes(after=-39.7):
    return (
        NodeGap("1", -12.1, after, -40.1, 0.2, 0.79, 0.01),
        NodeGap(AWKWARD, -7.5, after, -39.9, 0.21, 0.789, 0.001),
    )


def cause(effect, parameters, errors, after, **more):
    return Cause(effect, (AWKWARD, "ground"), parameters, errors, 0.987, after, **more)


def diagnosis(verdict=Verdict.EXPLAINED):
    cubic = cause("cubic_stiffness", {"coefficient": 1.0003e8}, {"coefficient": 2.1e5}, -31.0)
    friction = cause(
        "coulomb_friction",
        {"force": 2.0, "velocity": 0.01},
        {"force": 0.02, "velocity": float("nan")},
        -39.6,
        before={"force": 1.0, "velocity": 0.01},
    )
    other = cause(
        "clearance", {"stiffness": 4e5, "gap": 1e-4}, {"stiffness": 9e3, "gap": 2e-6}, -38.9, instead_of=0
    )
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    d, v = 2e-3 * np.sin(t), 0.2 * np.cos(t)
    noise = np.random.default_rng(1).normal(0, 0.02, t.size)
    law = 1e8 * d**3 + 2 * np.tanh(v / 0.01)
    bands = [
        BandShare(name, (low, low + 10.0), -30.0 + low / 4, 0.2, 0.7, 0.1, 0.01, 0.01, 0.01)
        for name in ("1", AWKWARD)
        for low in (0.0, 10.0, 20.0, 30.0)
    ]
    explained = verdict in {Verdict.EXPLAINED, Verdict.PARTLY_EXPLAINED}
    after = -39.6 if explained else -8.2
    return Diagnosis(
        verdict=verdict,
        gap=GapLevels(-8.2, after, -39.9, 0.9999 if explained else None),
        nodes=nodes(after),
        where=(MissingForce((AWKWARD, "ground"), 0.98, (28.1, 41.0), "ground", 1.02),),
        causes=(cubic, friction) if explained else (),
        alternatives=(other,) if explained else (),
        linear_corrections=(LinearCorrection("1-2", "stiffness", 35000.0, 36120.0, 45.0),) if explained else (),
        held_out_realisations=2,
        bands=tuple(bands),
        curves=(ForceCurve((AWKWARD, "ground"), d, v, law + noise, law if explained else None),),
        unknown_probability=0.012,
        corrected=MODEL,
        tested=("cubic_stiffness", "coulomb_friction", "clearance"),
        not_claimed=("The validation at another amplitude was not asked for.",),
    )


def validation(holds=True):
    return Validation(
        holds,
        GapLevels(-6.0, -38.0, -39.0, 0.999),
        nodes(-38.0),
        {f"cubic_stiffness at {AWKWARD}-ground: coefficient": 1.01e8},
        "The correction holds there too.",
    )
