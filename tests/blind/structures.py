"""Structures of the blind cases: chains, trees and rings of masses, and a beam; their matrices and model files."""

import copy

import numpy as np

from blind.motion import Structure


def draw_lumped(rng):
    """Masses joined in a chain, a tree or a ring, some of them held; until its modes are fit to be measured.

    Returns
    -------
    dict
        kind, masses (list of kg), links (list of [a, b, stiffness, damping]).
    """
    shape = rng.choice(["chain", "tree", "ring"])
    n = int(rng.integers(3 if shape == "ring" else 2, 7))
    while True:
        masses = rng.uniform(0.5, 2.0, n).tolist()
        pairs = {
            "chain": [(i, i + 1) for i in range(n - 1)],
            "tree": [(int(rng.integers(0, i)), i) for i in range(1, n)],
            "ring": [(i, (i + 1) % n) for i in range(n)],
        }[shape]
        held = sorted(rng.choice(n, size=int(rng.integers(1, min(n, 3) + 1)), replace=False).tolist())
        ends = [(str(a + 1), str(b + 1)) for a, b in pairs] + [(str(i + 1), "ground") for i in held]
        ratio = rng.uniform(0.015, 0.04)
        links = []
        for a, b in ends:
            k = float(np.exp(rng.uniform(np.log(1e4), np.log(6e4))))
            links.append([a, b, k, float(ratio * 2 * k / (2 * np.pi * 18.0) * rng.uniform(0.6, 1.6))])
        spec = {"kind": "lumped", "shape": str(shape), "masses": masses, "links": links}
        poles = assemble(spec).poles()
        frequencies = np.abs(poles) / (2 * np.pi)
        if (-poles.real).min() > 0.8 and frequencies.min() > 3.0 and frequencies.max() < 80.0:
            return spec


def draw_beam(rng):
    """A steel beam on soft springs with three voice coils."""
    count = 12
    marks = sorted(rng.choice(np.arange(0, count + 1, 2), size=3, replace=False).tolist())
    length = float(rng.uniform(0.4, 0.6))
    return {
        "kind": "beam",
        "shape": "beam",
        "length": length,
        "width": 0.02,
        "thickness": float(rng.uniform(0.0018, 0.0025)),
        "youngs_modulus": 2.0e11,
        "density": 7800.0,
        "damping_ratio": float(rng.uniform(0.01, 0.02)),
        "elements": count,
        "stations": [
            {
                "position": length * mark / count,
                "moving_mass": float(rng.uniform(0.03, 0.06)),
                "suspension_stiffness": float(rng.uniform(150.0, 500.0)),
                "suspension_damping": float(rng.uniform(0.8, 1.5)),
            }
            for mark in marks
        ],
    }


def assemble(spec):
    """Matrices of a structure."""
    return _lumped(spec) if spec["kind"] == "lumped" else _beam(spec)


def _lumped(spec):
    n = len(spec["masses"])
    names = [str(i + 1) for i in range(n)]
    points = dict(zip(names, np.eye(n), strict=True)) | {"ground": np.zeros(n)}
    stiffness, damping = np.zeros((n, n)), np.zeros((n, n))
    for a, b, k, c in spec["links"]:
        row = points[a] - points[b]
        stiffness += k * np.outer(row, row)
        damping += c * np.outer(row, row)
    return Structure(np.diag(spec["masses"]), damping, stiffness, points, names)


def _beam(spec):
    """Hermite elements whose matrices come from quadrature of their shape functions; modes below 8 kHz.

    Points ``spec["hidden"]``, positions by name, are neither driven nor measured.
    """
    count = spec["elements"]
    a = spec["length"] / count
    area = spec["width"] * spec["thickness"]
    bending = spec["youngs_modulus"] * area * spec["thickness"] ** 2 / 12
    at, weight = np.polynomial.legendre.leggauss(6)
    t = (at + 1) / 2
    shape = np.array([1 - 3 * t**2 + 2 * t**3, a * (t - 2 * t**2 + t**3), 3 * t**2 - 2 * t**3, a * (t**3 - t**2)])
    bend = np.array([12 * t - 6, a * (6 * t - 4), 6 - 12 * t, a * (6 * t - 2)]) / a**2
    size = 2 * (count + 1)
    mass, stiffness = np.zeros((size, size)), np.zeros((size, size))
    for e in range(count):
        part = slice(2 * e, 2 * e + 4)
        mass[part, part] += spec["density"] * area * (shape * weight) @ shape.T * a / 2
        stiffness[part, part] += bending * (bend * weight) @ bend.T * a / 2
    names = [str(i + 1) for i in range(len(spec["stations"]))]
    points = {}
    for name, station in zip(names, spec["stations"], strict=True):
        row = np.zeros(size)
        row[2 * round(station["position"] / a)] = 1.0
        points[name] = row
        mass += station["moving_mass"] * np.outer(row, row)
    for name, position in spec.get("hidden", {}).items():
        e = min(int(position / a), count - 1)
        x = position / a - e
        row = np.zeros(size)
        row[2 * e : 2 * e + 4] = (
            1 - 3 * x**2 + 2 * x**3,
            a * (x - 2 * x**2 + x**3),
            3 * x**2 - 2 * x**3,
            a * (x**3 - x**2),
        )
        points[name] = row
    factor = np.linalg.cholesky(mass)
    inverse = np.linalg.inv(factor)
    squares, turn = np.linalg.eigh(inverse @ stiffness @ inverse.T)
    squares = np.where(squares < 1.0, 0.0, squares)  # rigid motions: 0 but for rounding
    modes = inverse.T @ turn
    weighted = mass @ modes
    damping = weighted @ np.diag(2 * spec["damping_ratio"] * np.sqrt(squares)) @ weighted.T
    for name, station in zip(names, spec["stations"], strict=True):
        stiffness += station["suspension_stiffness"] * np.outer(points[name], points[name])
        damping += station["suspension_damping"] * np.outer(points[name], points[name])
    squares, turn = np.linalg.eigh(inverse @ stiffness @ inverse.T)
    basis = (inverse.T @ turn)[:, squares < (2 * np.pi * 8000.0) ** 2]
    return Structure(
        basis.T @ mass @ basis,
        basis.T @ damping @ basis,
        basis.T @ stiffness @ basis,
        {name: row @ basis for name, row in points.items()},
        names,
    )


def perturbed(spec, rng, share):
    """The same structure with every mass, stiffness and damping off by up to a share."""
    spec = copy.deepcopy(spec)

    def off():
        return 1.0 + rng.uniform(-share, share)

    if spec["kind"] == "lumped":
        spec["masses"] = [m * off() for m in spec["masses"]]
        spec["links"] = [[a, b, k * off(), c * off()] for a, b, k, c in spec["links"]]
        return spec
    for key in ("youngs_modulus", "density", "damping_ratio"):
        spec[key] *= off()
    for station in spec["stations"]:
        for key in ("moving_mass", "suspension_stiffness", "suspension_damping"):
            station[key] *= off()
    return spec


def model_text(spec, effects=()):
    """Model file of a structure, with effects as (name, place, parameters)."""
    rows = [f'kind = "{spec["kind"]}"']
    if spec["kind"] == "lumped":
        for i, mass in enumerate(spec["masses"]):
            rows += ["[[masses]]", f'name = "{i + 1}"', f"mass = {mass!r}"]
        for a, b, k, c in spec["links"]:
            rows += ["[[links]]", f'between = ["{a}", "{b}"]', f"stiffness = {k!r}", f"damping = {c!r}"]
    else:
        keys = ("length", "width", "thickness", "youngs_modulus", "density", "damping_ratio", "elements")
        rows += [f"{key} = {spec[key]!r}" for key in keys]
        for i, station in enumerate(spec["stations"]):
            rows += [
                "[[stations]]",
                f'name = "{i + 1}"',
                *(f"{key} = {value!r}" for key, value in station.items()),
            ]
            rows += ["actuator = true", "sensor = true"]
    for effect, at, parameters in effects:
        places = ", ".join(f'"{name}"' for name in at)
        rows += ["[[effects]]", f'effect = "{effect}"', f"at = [{places}]"]
        rows += [f"{key} = {value!r}" for key, value in parameters.items()]
    return "\n".join(rows) + "\n"
