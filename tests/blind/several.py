"""Blind cases with two or three effects at once, each well above the noise, drawn as the others are."""

from itertools import combinations, pairwise
from statistics import median

import numpy as np

from blind import effects, structures
from blind.cases import Case, multisines, rig_text
from blind.motion import NotPeriodicError, steady

CLEAR_DB = 10.0
"""Least gap above noise that every effect makes beside the others."""

ALIKE_DB = 0.5
"""Difference of two gaps below which the waterfall may have either first."""

KINDS = (*effects.NONLINEAR, "actuator_saturation", "actuator_dead_zone", "sensor_clipping", "sensor_delay")


def draw(seed, index, count):
    """Draw a case with so many effects; a quarter have two of different kinds at one place.

    Returns
    -------
    Case
        Its truth has ``effects``: a list of name, place and parameters; and ``left_db``: the gap that some of
        them leave, by their indices.
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
    snr_db = float(rng.uniform(35.0, 50.0))
    clear = CLEAR_DB - snr_db - 10 * np.log10(periods)
    few = u[-len(structure.nodes) :]  # the realisation that a diagnosis keeps aside, by which it states its gaps
    seen = responses(structure, there, few, fs)

    def left(some):
        """Gap that some of the effects leave, dB."""
        try:
            y = responses(structure, [there[i] for i in some], few, fs)
        except NotPeriodicError:  # nothing that a waterfall could pass through
            return np.inf
        return float(10 * np.log10(np.mean(np.sum((seen - y) ** 2, axis=(0, 2)) / np.sum(seen**2, axis=(0, 2)))))

    left_db = {}
    for fewer in range(count - 1, 0, -1):
        for some in combinations(range(count), fewer):
            left_db[_key(some)] = left(some)
            if fewer == count - 1 and not clear < left_db[_key(some)] < np.inf:
                return None
    whole = responses(structure, there, u, fs)
    sigma = np.sqrt(np.mean(whole**2, axis=(0, 2))) * 10 ** (-snr_db / 20)
    repeated = np.tile(whole, periods + 1)
    repeated = repeated + sigma[:, None] * rng.standard_normal(repeated.shape)
    truth = {
        "effects": [{"effect": name, "at": list(at), "parameters": values} for name, at, values in there],
        "left_db": left_db,
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
    """Whether all effects were found at their places, how many were invented, and whether the waterfall is right.

    Returns
    -------
    dict
        found, of, all, invented, falling (the gap shrinks with every cause) and ordered (every cause is, of those
        that were left, the one that leaves least).
    """
    wanted = [(item["effect"], frozenset(item["at"])) for item in truth["effects"]]
    causes = answer["causes"] if answer else []
    named = [(cause["effect"], frozenset(cause["at"])) for cause in causes]
    gaps = [cause["gap_after_db"] for cause in causes]
    whole = set(wanted) == set(named)
    return {
        "found": sum(item in named for item in wanted),
        "of": len(wanted),
        "all": set(wanted) <= set(named),
        "invented": sum(item not in wanted for item in named),
        "falling": all(a > b for a, b in pairwise(gaps)),
        "ordered": whole and _ordered(truth["left_db"], [wanted.index(item) for item in named]),
    }


def _ordered(left_db, order):
    """Whether every effect is, of those that were left, the one that leaves least, or nearly so."""
    for k in range(1, len(order)):
        choices = {i: left_db[_key((*order[: k - 1], i))] for i in order[k - 1 :]}
        if choices[order[k - 1]] > min(choices.values()) + ALIKE_DB:
            return False
    return True


def _key(some):
    """Indices of effects as the name of a set."""
    return "-".join(str(i) for i in sorted(some))


def summary(trials):
    """Counts over many trials: of whom it holds, of how many; and processor times.

    Parameters
    ----------
    trials : list of dict
        As `trial.run` returns them.
    """
    marks = [score(trial["truth"], trial["answer"]) for trial in trials]
    seconds = [trial["cpu_seconds"] for trial in trials]
    found = [mark for mark in marks if mark["all"] and not mark["invented"]]
    return {
        "cases with all effects found": (sum(mark["all"] for mark in marks), len(marks)),
        "effects found": (sum(mark["found"] for mark in marks), sum(mark["of"] for mark in marks)),
        "cases with an invented effect": (sum(mark["invented"] > 0 for mark in marks), len(marks)),
        "waterfall in the right order, of those found whole": (
            sum(mark["ordered"] and mark["falling"] for mark in found),
            len(found),
        ),
        "median s": median(seconds),
        "most s": max(seconds),
    }
