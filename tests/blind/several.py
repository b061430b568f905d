"""Blind cases with two or three effects at once, each well above the noise, drawn as the others are."""

from itertools import pairwise

import numpy as np

from blind import effects, structures
from blind.cases import Case, multisines, rig_text
from blind.motion import NotPeriodicError, steady

CLEAR_DB = 10.0
"""Least gap above noise that every effect makes beside the others."""

KINDS = (*effects.NONLINEAR, "actuator_saturation", "actuator_dead_zone", "sensor_clipping", "sensor_delay")


def draw(seed, index, count):
    """Draw a case with so many effects; a quarter have two of different kinds at one place.

    Returns
    -------
    Case
        Its truth has ``effects``: a list of name, place and parameters.
    """
    rng = np.random.default_rng((seed, index, count))
    while True:
        try:
            case = _attempt(rng, count)
        except NotPeriodicError:
            continue
        if case is not None:
            return case


def _attempt(rng, count):
    spec = structures.draw_lumped(rng)
    structure = structures.assemble(spec)
    if len(structure.nodes) < 3:
        return None
    fs, size, periods = 1280.0, 2048, 2
    band = tuple(
        float(f)
        for f in np.round(np.array([0.6, 1.15]) * np.sort(np.abs(structure.poles()))[[0, -1]] / (2 * np.pi), 2)
    )
    u = multisines(rng, len(structure.nodes), 5, fs, size, band, 20.0)
    there = []
    for i in range(count):
        kind = str(rng.choice([k for k in KINDS if k not in {name for name, _, _ in there}]))
        at = effects.draw_place(rng, spec, structure.nodes, kind)
        if i == 1 and rng.random() < 0.25 and len(there[0][1]) == 2:
            kind = str(rng.choice([k for k in effects.NONLINEAR if k != there[0][0]]))
            at = there[0][1]
        there.append((kind, at, effects.draw_strength(rng, kind, at, structure, u, fs)))
    whole = responses(structure, there, u, fs)
    power = np.mean(whole**2, axis=(0, 2))
    snr_db = float(rng.uniform(35.0, 50.0))
    sigma = np.sqrt(power) * 10 ** (-snr_db / 20)
    noise = np.mean(sigma**2 / periods / power)
    for i in range(count):
        without = responses(structure, [*there[:i], *there[i + 1 :]], u, fs)
        missing = np.mean(np.mean((whole - without) ** 2, axis=(0, 2)) / power)
        if 10 * np.log10(missing / noise + 1e-30) < CLEAR_DB:
            return None
    repeated = np.tile(whole, periods + 1)
    repeated = repeated + sigma[:, None] * rng.standard_normal(repeated.shape)
    truth = {
        "effects": [{"effect": name, "at": list(at), "parameters": values} for name, at, values in there],
        "structure": spec["shape"],
        "nodes": len(structure.nodes),
        "snr_db": snr_db,
    }
    rig = rig_text(structure.nodes, fs, size, band, "band-limited", "m")
    return Case(rig, structures.model_text(spec), np.tile(u, periods + 1), repeated, truth)


def responses(structure, there, u, fs):
    """Steady responses with effects (name, place, parameters), without noise."""
    u = u.copy()
    elements, sensed = [], []
    for name, at, values in there:
        if name in effects.ACTUATOR:
            node = structure.nodes.index(at[0])
            for experiment in u:
                experiment[node] = effects.electronics.actuated(name, values, experiment[node], fs)
        elif name in effects.SENSOR:
            sensed.append((name, structure.nodes.index(at[0]), values))
        else:
            elements.append((name, at, [*values.values(), 0.0][:2]))
    y = steady(structure, elements, u, fs, 0) if elements else structure.linear(u, fs, 0)
    for name, node, values in sensed:
        for experiment in y:
            experiment[node] = effects.electronics.sensed(name, values, experiment[node], fs)
    return y


def score(truth, answer):
    """Whether all effects were found at their places, how many were invented, and whether the waterfall falls.

    Returns
    -------
    dict
    """
    wanted = {(item["effect"], frozenset(item["at"])) for item in truth["effects"]}
    causes = answer["causes"] if answer else []
    named = [(cause["effect"], frozenset(cause["at"])) for cause in causes]
    gaps = [cause["gap_after_db"] for cause in causes]
    return {
        "found": sum(item in named for item in wanted),
        "of": len(wanted),
        "all": wanted <= set(named),
        "invented": sum(item not in wanted for item in named),
        "falling": all(a > b for a, b in pairwise(gaps)),
    }
