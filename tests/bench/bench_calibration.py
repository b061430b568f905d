"""Are the p-values what they say? Linear structures recorded thousands of times, and how often each test alarms.

Responses are exact, ``Y = S(omega) U``, of the three masses, a beam and a five-mass tree, with white sensor noise
of an exact DFT. Process noise (white forces at every input) and coloured sensor noise are stationary records in
time, cut into the periods of an experiment, so that they leak from period to period as on a rig. P = 2 to 6, M = 2
to 20, 10 to 60 dB signal-to-noise ratio, dense and sparse networks, as many nodes as inputs and (classical
analysis) more nodes than inputs.

Run with ``python tests/bench/bench_calibration.py [recordings] [--json] [--figure FILE.png]``; 2400 recordings of
white noise and 600 of each other kind take about two minutes.
"""

import json
import sys
from collections import defaultdict
from dataclasses import dataclass, replace
from functools import reduce
from operator import add

import numpy as np
import scipy.stats

from creak.mechanics.beam import Beam, Station
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.network import estimate
from creak.records import Node, Rig, Scope
from creak.significance import octaves, pooled_p_value
from creak.statistics import Sums

KINDS = ("white sensor noise", "coloured sensor noise", "process noise")
LEVELS = (0.05, 0.01, 0.001)
LINES = 24
SAMPLES = 512
LONG = 16  # periods of the record out of which an experiment's P are cut
COVERAGE = 0.9999  # of the binomial bounds: about one false alarm of the benchmark itself in 500 runs of its table


def three_masses():
    """Model, edges, and length of a period in seconds."""
    masses = tuple(PointMass(str(i + 1), m) for i, m in enumerate((1.0, 0.8, 1.2)))
    ends = ("ground", "1", "2", "3", "ground")
    links = tuple(
        Link((ends[i], ends[i + 1]) if ends[i] != "ground" else (ends[i + 1], "ground"), k, 8.0)
        for i, k in enumerate((2e4, 3.5e4, 5e4, 8e4))
    )
    return Lumped(masses, links), (("1", "2"), ("2", "3")), 1.6384


def five_mass_tree():
    masses = tuple(PointMass(str(i + 1), 1.0 + 0.1 * i) for i in range(5))
    edges = (("1", "2"), ("1", "3"), ("3", "4"), ("3", "5"))
    links = (Link(("1", "ground"), 3e4, 8.0), *(Link(edge, 4e4 + 5e3 * i, 8.0) for i, edge in enumerate(edges)))
    return Lumped(masses, links), edges, 4.0


def beam():
    stations = tuple(
        Station(str(i + 1), 0.25 * i, 0.0123, 63.0, 0.22, actuator=True, sensor=True, force_constant=5.0)
        for i in range(3)
    )
    return Beam(0.5, 0.02, 0.002, 2e11, 7850.0, 0.02, 16, stations), None, 4.0


@dataclass(frozen=True)
class Structure:
    """A linear structure on a rig: its response matrix at every line, and at every frequency of a long record."""

    name: str
    rig: Rig
    S: np.ndarray
    S_long: np.ndarray


def structures():
    """Every structure, dense and with its own edges, and with an input less than nodes."""
    found = []
    for name, build in (("three masses", three_masses), ("beam", beam), ("tree", five_mass_tree)):
        model, edges, period = build()
        nodes = tuple(Node(str(i + 1), "m", "N") for i in range(5 if name == "tree" else 3))
        lines = tuple(np.linspace(6, 0.4 * SAMPLES, LINES).astype(int).tolist())
        dense = Rig(name, SAMPLES / period, SAMPLES, 1, lines, nodes)
        system = assemble(model, dense)
        S = system.response(dense.frequencies)
        S_long = system.response(np.arange(LONG * SAMPLES // 2 + 1) / (LONG * period))
        found.append(Structure(f"{name}, dense", dense, S, S_long))
        if edges is not None:
            found.append(Structure(f"{name}, sparse", replace(dense, network=edges), S, S_long))
        tall = replace(dense, nodes=(*nodes[:-1], Node(nodes[-1].name, "m")))
        found.append(Structure(f"{name}, one input less", tall, S[..., :-1], S_long))
    return found


def gauss(rng, *shape):
    """Complex noise of unit power."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def running(rng, structure, periods, kind):
    """Noise of one experiment whose periods follow one another: a stationary record in time, cut into periods."""
    rig, S = structure.rig, structure.S_long
    white = np.fft.rfft(rng.standard_normal((LONG * SAMPLES, S.shape[2])), axis=0)
    if kind == "process noise":
        long = np.einsum("fij,fj->fi", S, white)
    else:
        turn = np.exp(-2j * np.pi * np.arange(len(white)) / (LONG * SAMPLES))
        long = white / (1 - 0.995 * turn)[:, None]  # a corner at 0.4 lines: most of its power lies below the band
    record = np.fft.irfft(long, axis=0)[: periods * SAMPLES]
    return np.fft.rfft(record.reshape(periods, SAMPLES, -1), axis=1)[:, list(rig.lines)]


def recording(rng, structure, M, P, snr_db, kind="white sensor noise", distortion=None):
    """Sums of M realisations; ``distortion``: (node, power over noise of the networked residual there)."""
    rig, S = structure.rig, structure.S
    q, n, F = rig.q, rig.n, len(rig.lines)
    rotation = np.exp(-2j * np.pi * np.outer(np.arange(q), np.arange(q)) / q)
    phase = np.exp(2j * np.pi * rng.random((M, 1, 1, F, q)))
    U = np.broadcast_to(phase * rotation[None, :, None, None, :], (M, q, P, F, q))
    Y = np.einsum("fij,mcpfj->mcpfi", S, U)
    sigma = np.sqrt(np.mean(np.abs(Y) ** 2, axis=(0, 1, 2, 3))) * 10 ** (-snr_db / 20)
    if distortion is not None:
        node, ratio = distortion
        Z = np.linalg.inv(S)
        force = np.sqrt(ratio * (np.abs(Z[:, node]) ** 2 * sigma**2).sum(axis=1))
        Y = Y + np.einsum("fi,f,mcf->mcfi", S[..., node], force, gauss(rng, M, q, F))[:, :, None]
    if kind == "white sensor noise":
        noise = sigma * gauss(rng, M, q, P, F, n)
    else:
        records = [running(rng, structure, P, kind) for _ in range(M * q)]
        noise = np.array(records).reshape(M, q, P, F, n)
        noise *= sigma / np.sqrt(np.mean(np.abs(noise) ** 2, axis=(0, 1, 2, 3)))
    spectra = np.concatenate((U, Y + noise), axis=-1)
    return reduce(add, (Sums.of(block, q) for block in spectra))


def tests_of(structure, sums):
    """p-values by kind of test: arrays; ``discovery`` holds the least q-value, significant below Q by chance Q."""
    got = estimate(structure.rig, sums, Scope.RUN, 0, 0)
    classical = got.spectra.classical_p_value
    found = {"classical line": classical.ravel(), "classical node": pooled_p_value(classical)}
    if structure.rig.square:
        p = got.spectra.p_value
        bands = octaves(got.spectra.frequency)
        found |= {
            "line": p.ravel(),
            "band": np.concatenate([pooled_p_value(p[band]) for band in bands]),
            "node": np.array([node.p_value for node in got.nodes]),
            "discovery": np.array([got.spectra.q_value.min()]),
        }
    return found


@dataclass
class Count:
    """Alarms among tests; recordings are what is independent, since the tests of one share S and noise."""

    tests: int = 0
    alarms: float = 0.0
    squares: float = 0.0
    recordings: int = 0

    def take(self, alarms, tests):
        self.tests += tests
        self.alarms += alarms
        self.squares += alarms**2
        self.recordings += 1

    def rate(self):
        return self.alarms / self.tests

    def effect(self, level):
        """How many tests count as one, since those of one recording go together (cluster sampling); at least 1."""
        expected = level * self.tests / self.recordings
        spread = self.squares / self.recordings - (self.alarms / self.recordings) ** 2
        return max(1.0, spread / (expected * (1 - level)))


def study(recordings, kind="white sensor noise", seed=0):
    """Count alarms over recordings of every structure in turn: ``{(test, level): Count}``, and by structure."""
    rng = np.random.default_rng((12, seed))
    places = structures()
    counts = defaultdict(Count)
    for index in range(recordings):
        structure = places[index % len(places)]
        M, P = int(rng.integers(2, 21)), int(rng.integers(2, 7))
        if kind != "white sensor noise":
            M = min(M, 6)
        sums = recording(rng, structure, M, P, rng.uniform(10, 60), kind)
        for test, p in tests_of(structure, sums).items():
            for level in LEVELS:
                counts[test, level].take(int((p < level).sum()), p.size)
    return counts


def table(counts, effects):
    """Rows with test, level, rate, its binomial bounds for as many tests as are independent, and where it lies."""
    rows = []
    for (test, level), count in counts.items():
        independent = max(1, round(count.tests / effects[test, level]))
        low, high = (bound / independent for bound in scipy.stats.binom.interval(COVERAGE, independent, level))
        rate = count.rate()
        where = "above" if rate > high else "below" if rate < low else "inside"
        row = {"test": test, "level": level, "tests": count.tests, "rate": rate, "low": low, "high": high}
        rows.append({**row, "where": where})
    return rows


def rates(recordings):
    """Tables for every kind of noise: ``{kind: rows}``; what goes together is taken from white sensor noise."""
    effects, tables = {}, {}
    for kind in KINDS:
        counts = study(recordings if not effects else recordings // 4, kind)
        effects = effects or {key: count.effect(key[1]) for key, count in counts.items()}
        tables[kind] = table(counts, effects)
    return tables


def power(ratios_db, recordings=60, M=4, P=2, seed=0):
    """p-values of node 3 and its lines, by distortion-to-noise ratio; the share of false discoveries."""
    rng = np.random.default_rng((13, seed))
    structure = structures()[0]
    found = {}
    for ratio in ratios_db:
        nodes, lines, false = [], [], []
        for _ in range(recordings):
            sums = recording(rng, structure, M, P, 40.0, distortion=(2, 10 ** (ratio / 10)))
            got = estimate(structure.rig, sums, Scope.RUN, 0, 0)
            nodes.append([node.p_value for node in got.nodes])
            lines.append(got.spectra.p_value)
            called = got.spectra.q_value <= 0.05
            false.append(called[:, :2].sum() / max(1, called.sum()))
        found[float(ratio)] = {
            "node": np.array(nodes)[:, 2],
            "line": np.array(lines)[:, :, 2].ravel(),
            "false discoveries": float(np.mean(false)),
        }
    return found


def draw(found, path):
    """Picture: detection probability against distortion-to-noise ratio, and operating curves of one line."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    ratios = sorted(found)
    for level in LEVELS:
        for test, style in (("line", "--"), ("node", "-")):
            rate = [(found[r][test] < level).mean() for r in ratios]
            left.plot(ratios, rate, style, label=f"{test}, false alarms {level:g}")
    left.set(xlabel="distortion-to-noise ratio of one period, dB", ylabel="probability of detection")
    left.legend(fontsize=8, loc="upper left")
    for ratio in ratios[::3]:
        p = np.sort(found[ratio]["line"])
        right.step(p, np.arange(1, p.size + 1) / p.size, label=f"{ratio:g} dB")
    chance = np.geomspace(1e-4, 1, 50)
    right.plot(chance, chance, "k:", label="chance")
    right.set(xscale="log", xlim=(1e-4, 1), xlabel="false-alarm rate of a line", ylabel="probability of detection")
    right.legend(fontsize=8)
    for axes in (left, right):
        axes.grid(visible=True, alpha=0.3)
    figure.suptitle("Three masses, 24 lines, 12 experiments of 2 periods")
    figure.savefig(path, dpi=120)


def main():
    """Print the tables."""
    numbers = [int(a) for a in sys.argv[1:] if a.isdigit()]
    recordings = numbers[0] if numbers else 2400
    results = rates(recordings)
    found = power(np.arange(-15.0, 10.0, 1.0))
    detection = {
        r: {f"{t} {level:g}": float((v[t] < level).mean()) for t in ("line", "node") for level in LEVELS}
        | {"false discoveries": v["false discoveries"]}
        for r, v in found.items()
    }
    if "--figure" in sys.argv:
        draw(found, sys.argv[sys.argv.index("--figure") + 1])
    if "--json" in sys.argv:
        print(json.dumps({"rates": results, "detection": detection}, indent=1))
        return
    for kind, rows in results.items():
        print(kind)
        for row in rows:
            print(
                f"  {row['test']:15s} {row['level']:6.3f}: {row['rate']:8.5f} of {row['tests']:7d}, "
                f"bounds {row['low']:.5f} to {row['high']:.5f}, {row['where']}"
            )
    for ratio, row in detection.items():
        print(f"  {ratio:6.1f} dB: " + ", ".join(f"{key} {value:.3f}" for key, value in row.items()))


if __name__ == "__main__":
    main()
