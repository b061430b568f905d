"""Blind cases whose effect acts where nothing is measured: anywhere along a beam, or at a mass without sensor."""

import numpy as np

from blind import effects, structures
from blind.cases import Case, multisines, rig_text
from blind.motion import NotPeriodicError, Structure

KINDS = ("stiffness", "cubic_stiffness", "one_sided_stop", "clearance", "coulomb_friction", "tanh_spring")
"""What acts there; the last one is a law that the vocabulary lacks."""

CLEAR = 0.02  # of the length, between the effect and the nearest sensor at least


def draw(seed, index):
    """Draw case `index` of a set: two beams for every chain, tree or ring."""
    rng = np.random.default_rng((seed, index))
    for _ in range(20):
        try:
            return _attempt(rng, KINDS[index % len(KINDS)], beam=index // len(KINDS) % 3 < 2)
        except NotPeriodicError:
            continue
    raise RuntimeError(f"no periodic motion found for case {index} of set {seed}")


def _beam(rng):
    """A beam with three or five sensors, and a point somewhere between them."""
    count = 48
    spec = structures.draw_beam(rng)
    number = int(rng.choice([3, 5]))
    marks = sorted(rng.choice(np.arange(0, count + 1, 4), size=number, replace=False).tolist())
    template = spec["stations"][0]
    spec["elements"] = count
    spec["stations"] = [
        template | {"position": min(spec["length"] * mark / count, spec["length"])} for mark in marks
    ]
    while True:
        position = float(rng.uniform(0, spec["length"]))
        if min(abs(position - s["position"]) for s in spec["stations"]) > CLEAR * spec["length"]:
            break
    spec["hidden"] = {"h": position}
    return spec, structures.assemble(spec), ("h", "ground"), position


def _lumped(rng):
    """Masses of which one has neither actuator nor sensor; the effect acts there."""
    while True:
        spec = structures.draw_lumped(rng)
        if len(spec["masses"]) > 2:
            break
    whole = structures.assemble(spec)
    hidden = str(rng.choice(whole.nodes))
    seen = [name for name in whole.nodes if name != hidden]
    points = {name: row for name, row in whole.points.items() if name != "ground"}
    structure = Structure(whole.mass, whole.damping, whole.stiffness, points, seen)
    near = [b if a == hidden else a for a, b, *_ in spec["links"] if hidden in (a, b)]
    other = "ground" if rng.random() < 0.6 else str(rng.choice([name for name in near if name != "ground"]))
    return spec, structure, (hidden, other), None


def _attempt(rng, effect, beam):
    spec, structure, at, position = _beam(rng) if beam else _lumped(rng)
    fs, size, periods, realisations = 1000.0, 2048, 3, 4
    frequencies = np.abs(structure.poles()) / (2 * np.pi)
    band = (0.6 * frequencies.min(), 150.0 if beam else 1.15 * frequencies.max())
    band = tuple(float(f) for f in np.round(band, 2))
    u = multisines(rng, len(structure.nodes), realisations, fs, size, band, 1.0 if beam else 20.0)
    values = effects.draw_strength(rng, effect, at, structure, u, fs)
    y = effects.responses(structure, effect, at, values, u, fs, 0, held=False)
    plain = effects.responses(structure, None, (), {}, u, fs, 0, held=False)
    snr_db = float(rng.uniform(40.0, 55.0))
    sigma = np.sqrt(np.mean(y**2, axis=(0, 2))) * 10 ** (-snr_db / 20)
    repeated = np.tile(y, periods + 1)
    repeated = repeated + sigma[:, None] * rng.standard_normal(repeated.shape)
    gap = np.mean(np.mean((y - plain) ** 2, axis=(0, 2)) / (sigma**2 / periods))
    truth = {
        "effect": effect,
        "at": list(at),
        "position": position,
        "length": spec.get("length"),
        "parameters": values,
        "structure": spec["shape"],
        "nodes": len(structure.nodes),
        "snr_db": snr_db,
        "gap_to_noise_db": float(10 * np.log10(gap)),
    }
    rig = rig_text(structure.nodes, fs, size, band, "band-limited", "m")
    return Case(rig, structures.model_text(spec), np.tile(u, periods + 1), repeated, truth)


def judge(result):
    """What of an answer is right: position (error in lengths and in standard errors), place, effect, verdict."""
    truth, answer = result["truth"], result["answer"]
    outside = truth["effect"] == KINDS[-1]
    judged = {"structure": "beam" if truth["length"] else "chain", "outside": outside, "located": False}
    where = answer["where"][0] if answer and answer["where"] else None
    if where is None:
        return judged
    if truth["length"]:
        judged["located"] = where["position"] is not None
        if judged["located"]:
            error = where["position"] - truth["position"]
            judged["error"] = abs(error) / truth["length"]
            judged["deviations"] = error / where["position_standard_error"]
    else:
        judged["located"] = set(where["at"]) == set(truth["at"])
    named = [cause["effect"] for cause in answer["causes"]]
    alike = [cause["effect"] for cause in answer["alternatives"]]
    judged["effect"] = answer["verdict"] != "explained" if outside else truth["effect"] in named[:1] + alike
    return judged


def summary(results):
    """Figures of many trials."""
    every = [judge(result) for result in results]
    beams = [item for item in every if item["structure"] == "beam"]
    found = [item for item in beams if "error" in item]
    errors = np.array([item["error"] for item in found])
    deviations = np.array([item["deviations"] for item in found])
    lumped = [item for item in every if item["structure"] != "beam"]
    named = [item for item in every if not item["outside"]]
    outside = [item for item in every if item["outside"]]
    return {
        "beam, position found": (len(found), len(beams)),
        "beam, error below 2 % of the length": (int(np.sum(errors < 0.02)), len(beams)),
        "beam, truth within the 95 % interval": (int(np.sum(np.abs(deviations) < 1.96)), len(found)),
        "mass without sensor, place right": (sum(item["located"] for item in lumped), len(lumped)),
        "effect right": (sum(item.get("effect", False) for item in named), len(named)),
        "outside law not named": (sum(item.get("effect", True) for item in outside), len(outside)),
        "median error, % of the length": float(100 * np.median(errors)) if len(errors) else None,
    }
