"""What may be wrong in a blind case: effect, place and strength drawn at random, and the motion under it."""

import copy
from itertools import pairwise

import numpy as np

from blind import electronics
from blind.motion import OUTSIDE, Structure, steady

LINEAR = ("stiffness", "damping", "mass")
NONLINEAR = (
    "cubic_stiffness",
    "quadratic_stiffness",
    "clearance",
    "one_sided_stop",
    "coulomb_friction",
    "quadratic_damping",
    "hysteresis",
)
ACTUATOR = ("actuator_gain", "actuator_delay", "actuator_saturation", "actuator_dead_zone", "actuator_hysteresis")
SENSOR = ("sensor_gain", "sensor_delay", "sensor_clipping", "sensor_quantisation")
VOCABULARY = (*LINEAR, *NONLINEAR, "resonator", *ACTUATOR, *SENSOR)

NAMES = {
    "cubic_stiffness": ("coefficient",),
    "quadratic_stiffness": ("coefficient",),
    "clearance": ("stiffness", "gap"),
    "one_sided_stop": ("stiffness", "gap"),
    "coulomb_friction": ("force", "velocity"),
    "quadratic_damping": ("coefficient",),
    "hysteresis": ("stiffness", "yield_displacement"),
}

HARMLESS_BESIDE_ERRORS = frozenset({*LINEAR, "actuator_gain", "sensor_gain"})
"""Effects that no data tell from a linear part that is off everywhere: they come with an exact one."""


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def rms(samples):
    return float(np.sqrt(np.mean(np.square(samples))))


def draw_place(rng, spec, nodes, effect):
    """A node and the ground, two nodes that are neighbours, or one node."""
    if effect == "resonator" or effect.startswith(("actuator", "sensor")):
        return (str(rng.choice(nodes)),)
    pairs = [(a, b) for a, b, *_ in spec.get("links", ()) if b != "ground"]
    pairs = pairs or list(pairwise(nodes))
    if rng.random() < 0.6:
        return (str(rng.choice(nodes)), "ground")
    return pairs[int(rng.integers(len(pairs)))]


def draw_strength(rng, effect, at, structure, u, fs):
    """Parameters of an effect, so that its force is 5 to 80 % of the inputs' on the undisturbed motion."""
    drive = rms(u) * structure.force_constant
    target = log_uniform(rng, 0.05, 0.8) * drive
    if effect in ACTUATOR + SENSOR:
        return _electronic(rng, effect, structure, u, fs, at)
    row = structure.row(at)
    d, v, a = (_seen(structure, row, u, fs, order) for order in range(3))
    held = 1.0 / float(row @ np.linalg.solve(structure.stiffness, row))
    size, speed, top = rms(d), rms(v), float(np.abs(d).max())
    match effect:
        case "stiffness":
            return {"coefficient": target / size}
        case "damping":
            return {"coefficient": target / speed}
        case "mass":
            return {"coefficient": target / rms(a)}
        case "resonator":
            poles = np.sort(np.abs(structure.poles())) / (2 * np.pi)
            inside = poles[poles < fs / 10]
            return {
                "mass": float(rng.uniform(0.03, 0.2)) / float(row @ np.linalg.solve(structure.mass, row)),
                "frequency_hz": float(rng.uniform(inside[0], inside[-1])),
                "damping_ratio": float(rng.uniform(0.01, 0.05)),
            }
        case "cubic_stiffness":
            return {"coefficient": target / rms(d**3)}
        case "quadratic_stiffness":
            return {"coefficient": min(target / rms(d**2), 0.25 * held / top)}
        case "clearance":
            gap = float(rng.uniform(0.2, 1.4)) * size
            return {"stiffness": min(target / rms(np.maximum(np.abs(d) - gap, 0)), 4 * held), "gap": gap}
        case "one_sided_stop":
            gap = float(rng.uniform(-0.5, 1.4)) * size
            return {"stiffness": min(target / rms(np.maximum(d - gap, 0)), 4 * held), "gap": gap}
        case "coulomb_friction":
            return {"force": target, "velocity": log_uniform(rng, 0.05, 0.7) * speed}
        case "quadratic_damping":
            return {"coefficient": target / rms(v**2)}
        case "hysteresis":
            bound = log_uniform(rng, 0.25, 1.5) * size
            return {"stiffness": target / rms(np.minimum(np.abs(d), bound)), "yield_displacement": bound}
        case "tanh_spring":
            bound = float(rng.uniform(0.3, 0.9)) * size
            return {"stiffness": target / rms(bound * np.tanh(d / bound)), "scale": bound}
        case "magnetic_detent":
            pitch = float(rng.uniform(1.0, 3.0)) * size
            return {"force": min(1.4 * target, 0.7 * held * pitch / (2 * np.pi)), "pitch": pitch}
        case "nonlinear_inertia":
            return {"coefficient": target / rms(d**2 * a + d * v**2)}
        case "velocity_stiffness":
            return {"stiffness": target / rms(d * np.abs(v) / speed), "velocity": speed}
    raise KeyError(effect)


def _seen(structure, row, u, fs, order):
    """Relative motion along a row, linear."""
    seen = copy.copy(structure)
    seen.rows = lambda: row[None]
    return seen.linear(u, fs, order)[:, 0]


def _electronic(rng, effect, structure, u, fs, at):
    node = structure.nodes.index(at[0])
    drive, seen = rms(u[:, node]), rms(structure.linear(u, fs, 0)[:, node])
    sign = float(rng.choice([-1.0, 1.0]))
    match effect.split("_", 1)[1]:
        case "gain":
            return {"gain": 1.0 + sign * log_uniform(rng, 0.02, 0.2)}
        case "delay":
            return {"delay": log_uniform(rng, 0.1, 3.0) / fs}
        case "saturation":
            return {"limit": float(rng.uniform(0.8, 2.0)) * drive}
        case "dead_zone":
            return {"width": log_uniform(rng, 0.03, 0.5) * drive}
        case "hysteresis":
            return {"share": float(rng.uniform(0.1, 0.5)), "yield_input": float(rng.uniform(0.3, 1.5)) * drive}
        case "clipping":
            return {"limit": float(rng.uniform(0.8, 2.0)) * seen}
        case "quantisation":
            return {"step": log_uniform(rng, 0.02, 0.5) * seen}
    raise KeyError(effect)


def with_linear_effect(structure, effect, at, values):
    """A structure with a spring, damper, mass or resonator more."""
    row = structure.row(at)
    mass, damping, stiffness = structure.mass.copy(), structure.damping.copy(), structure.stiffness.copy()
    points = structure.points
    match effect:
        case "stiffness":
            stiffness += values["coefficient"] * np.outer(row, row)
        case "damping":
            damping += values["coefficient"] * np.outer(row, row)
        case "mass":
            mass += values["coefficient"] * np.outer(row, row)
        case "resonator":
            mass, damping, stiffness = (np.pad(matrix, (0, 1)) for matrix in (mass, damping, stiffness))
            points = {name: np.append(point, 0.0) for name, point in points.items()}
            across = np.append(row, -1.0)
            w = 2 * np.pi * values["frequency_hz"]
            mass[-1, -1] = values["mass"]
            stiffness += values["mass"] * w**2 * np.outer(across, across)
            damping += 2 * values["damping_ratio"] * values["mass"] * w * np.outer(across, across)
    return Structure(mass, damping, stiffness, points, structure.nodes, structure.force_constant)


def responses(structure, effect, at, values, u, fs, order, held):
    """Steady responses with an effect (None for none), without noise."""
    if effect in (*LINEAR, "resonator"):
        structure = with_linear_effect(structure, effect, at, values)
    if effect in ACTUATOR:
        u = u.copy()
        node = structure.nodes.index(at[0])
        for experiment in u:
            experiment[node] = electronics.actuated(effect, values, experiment[node], fs)
    elements = []
    if effect in (*NONLINEAR, *OUTSIDE):
        constants = [*values.values(), 0.0][:2]
        elements = [(effect, at, constants)]
    y = steady(structure, elements, u, fs, order, held) if elements else structure.linear(u, fs, order, held)
    if effect in SENSOR:
        node = structure.nodes.index(at[0])
        for experiment in y:
            experiment[node] = electronics.sensed(effect, values, experiment[node], fs)
    return y
