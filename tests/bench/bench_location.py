"""How often is a nonlinear element found where it is? Random structures, one or two elements, any place.

Run with ``python tests/bench/bench_location.py [cases] [--json]``; 300 cases take about a minute.
"""

import json
import sys
from collections import Counter
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np

from creak.errors import SimulationError
from creak.mechanics.effects import Clearance, CoulombFriction, CubicStiffness
from creak.mechanics.newmark import Stepper
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.network import estimate
from creak.records import Node, Rig, Scope
from creak.statistics import Sums

REALISATIONS, STEADY, TRANSIENT = 6, 2, 2
RMS = 50.0
LEAST_CLEARANCE_DB = 6.0
SAMPLES, RATE = 2048, 1024.0


@dataclass(frozen=True)
class Case:
    """A structure with its elements, and what was found there."""

    shape: str
    nodes: int
    effects: tuple[str, ...]
    true: frozenset
    clearances_db: tuple[float, ...]
    found: tuple

    @property
    def exact(self):
        """The elements, all of them and no others."""
        return {e.between for e in self.found} == self.true

    @property
    def ambiguous(self):
        """True if the elements hang together, so that other elements could make the same forces."""
        ends = [end for pair in self.true for end in pair]
        return len(ends) != len(set(ends))

    @property
    def right(self):
        """Exact; or the right vertices, said not to be separable."""
        if self.exact:
            return True
        if not self.ambiguous or any(e.separable for e in self.found):
            return False
        vertices = {end for e in self.found for end in e.between}
        return len(self.found) == len(self.true) and vertices == {end for pair in self.true for end in pair}


def structure(rng):
    """A chain, a tree or a ring of 3 to 8 masses."""
    shape = ("chain", "tree", "ring")[rng.integers(3)]
    n = int(rng.integers(3, 9))
    names = [str(i + 1) for i in range(n)]
    if shape == "tree":
        links = [(names[int(rng.integers(i))], names[i]) for i in range(1, n)]
    else:
        links = [(names[i], names[i + 1]) for i in range(n - 1)]
        if shape == "ring":
            links.append((names[0], names[-1]))
    masses = tuple(PointMass(name, float(rng.uniform(0.6, 1.5))) for name in names)
    drawn = tuple(Link(pair, float(rng.uniform(2e4, 8e4)), float(rng.uniform(8, 20))) for pair in links)
    # Dampers to the ground let the transients die out within the periods that are dropped.
    drawn += tuple(Link((name, "ground"), float(10 ** rng.uniform(3, 4.5)), 12.0) for name in names)
    return shape, names, masses, drawn


def element(rng, between, motion, speed):
    """A cubic spring, friction or a clearance, of a size that the motion there feels."""
    kind = rng.integers(3)
    if kind == 0:
        return CubicStiffness(between, float(10 ** rng.uniform(3.5, 4.5)) / motion**2)
    if kind == 1:
        return CoulombFriction(between, float(RMS * 10 ** rng.uniform(-1, -0.3)), 0.1 * speed)
    return Clearance(between, float(10 ** rng.uniform(4, 4.7)), float(rng.uniform(0.5, 1.5)) * motion)


def steady(model, rig, seed, count):
    """Inputs and noise-free steady responses of realisations: two arrays (M, q, channel, N)."""
    stepper = Stepper(assemble(model, rig), rig.sample_rate, 1, "band-limited")
    u = np.stack([realisation(rig, RMS, seed, m) for m in range(count)])
    y = [[list(stepper.experiment(e, TRANSIENT + 1))[-1] for e in inputs] for inputs in u]
    return u, np.array(y)


def measured(rig, u, y, sigma, rng):
    """Sums of P noisy periods of every experiment."""
    lines = list(rig.lines)
    U = np.fft.rfft(u)[..., lines] / rig.period_samples
    blocks = []
    for m in range(len(u)):
        noisy = y[m][:, None] + sigma[:, None] * rng.standard_normal((rig.q, STEADY, *y.shape[2:]))
        Y = np.fft.rfft(noisy)[..., lines] / rig.period_samples
        spectra = np.concatenate((np.broadcast_to(U[m][:, None], (*Y.shape[:2], *U.shape[2:])), Y), axis=2)
        blocks.append(Sums.of(np.ascontiguousarray(spectra.transpose(0, 1, 3, 2)), rig.q))
    return reduce(add, blocks)


def draw(seed):
    """One case; None if its elements do not stand clear of the noise, or the simulation fails."""
    rng = np.random.default_rng((4, seed))
    shape, names, masses, links = structure(rng)
    frequencies = np.arange(1, SAMPLES // 2) * RATE / SAMPLES
    lines = np.flatnonzero((frequencies >= 5) & (frequencies <= 80)) + 1
    rig = Rig("random", RATE, SAMPLES, TRANSIENT, tuple(lines.tolist()), tuple(Node(x, "m", "N") for x in names))
    _, y = steady(Lumped(masses, links), rig, seed, 1)
    x = dict(zip(names, y[0, 0], strict=True)) | {"ground": np.zeros(SAMPLES)}
    count = int(rng.integers(1, 3))
    places = [link.between for link in links]
    chosen = [places[i] for i in rng.choice(len(places), count, replace=False)]
    effects = tuple(
        element(rng, pair, float(np.std(d)), float(np.std(np.gradient(d) * RATE)))
        for pair in chosen
        for d in [x[pair[0]] - x[pair[1]]]
    )
    try:
        u, y = steady(Lumped(masses, links, effects), rig, seed, REALISATIONS)
    except SimulationError:
        return None
    sigma = y[0].std(axis=(0, 2)) * 10 ** (-rng.uniform(30, 60) / 20)
    sums = measured(rig, u, y, sigma, rng)
    got = estimate(rig, sums, Scope.RUN, 0, REALISATIONS - 1)
    levels = {level.name: level.total_to_noise_db or -99.0 for level in got.nodes}
    clear = tuple(min(levels[end] for end in pair if end != "ground") for pair in chosen)
    if min(clear) < LEAST_CLEARANCE_DB:
        return None
    return Case(shape, len(names), tuple(e.effect for e in effects), frozenset(chosen), clear, got.elements)


def study(count):
    """As many cases as asked for."""
    cases, seed = [], 0
    while len(cases) < count:
        case = draw(seed)
        seed += 1
        if case is not None:
            cases.append((seed - 1, case))
    return cases


def main():
    """Print the table."""
    numbers = [a for a in sys.argv[1:] if a.isdigit()]
    cases = study(int(numbers[0]) if numbers else 300)
    groups = Counter()
    hits = Counter()
    exact = Counter()
    sure = Counter()
    for seed, case in cases:
        for group in (
            "all",
            case.shape,
            f"{len(case.true)} element(s)",
            "closed triangle" if case.ambiguous else "open",
        ):
            groups[group] += 1
            hits[group] += case.right
            exact[group] += case.exact
            sure[group] += all(e.separable for e in case.found)
        if "--wrong" in sys.argv and not case.exact:
            print(seed, case)
    table = {
        g: {
            "cases": groups[g],
            "right": hits[g] / groups[g],
            "exact": exact[g] / groups[g],
            "separable": sure[g] / groups[g],
        }
        for g in groups
    }
    if "--json" in sys.argv:
        print(json.dumps(table, indent=1))
        return
    for group, row in table.items():
        shares = ", ".join(f"{key} {row[key]:.1%}" for key in ("right", "exact", "separable"))
        print(f"{group:16s} {row['cases']:4d} cases: {shares}")


if __name__ == "__main__":
    main()
