"""How large the gap is, per node, in dB, and how it divides into noise, linear error and nonlinear distortion."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from creak.gap.periodic import PeriodicData
from creak.gap.records import BandShare, GapLevels, NodeGap
from creak.gap.regression import Indices
from creak.gap.view import lines_of
from creak.records import Complex, Real, Rig

_BANDS = 5  # into which the excited band is cut


@dataclass(frozen=True, eq=False)
class Level:
    """Gap of one simulation at some experiments.

    Parameters
    ----------
    power : array, (n,)
        Of measured minus simulated over that of measured, lines 0..N/2.
    noise : array, (n,)
        What noise alone leaves.
    whitened : float
        Mean whitened power over all lines, nodes and experiments.
    """

    power: Real
    noise: Real
    whitened: float


def level(data: PeriodicData, y: Real, experiments: Indices) -> Level:
    """Gap of simulated responses ``(E', n, N)`` at experiments ``(E',)``."""
    counts = data.counts
    rest = (lines_of(y) - data.Y[experiments])[:, counts]
    measured = np.sum(np.abs(data.Y[experiments][:, counts]) ** 2, axis=(0, 1))
    power, variance = np.abs(rest) ** 2, data.variance[counts]
    return Level(
        np.sum(power, axis=(0, 1)) / measured,
        len(experiments) * variance.sum(axis=0) / measured,
        float(np.mean(power / variance)),
    )


def noise_bound(data: PeriodicData, experiments: int, probability: float = 0.99) -> float:
    """Bound within which the mean whitened power stays with a probability if there is noise alone.

    Per line and node the sum over E experiments, over a variance of ``nu`` degrees of freedom, is E times an
    F(2E, 2nu) variable; the mean over lines and nodes is nearly normal.
    """
    import scipy.stats  # here, as it takes a quarter of the start of any command

    lines, n = data.variance.shape
    # Of the whitened power a line's own part varies by 1/E; the part that its variance estimate brings is shared
    # by the lines that were pooled for it.
    law = scipy.stats.f(2 * experiments, 2 * data.degrees)
    shared = float(law.var()) - float(law.mean()) ** 2 / experiments
    variance = (float(law.var()) + (data.pooled - 1) * max(shared, 0.0)) / (lines * n)
    return float(law.mean()) + float(scipy.stats.norm.ppf(probability)) * float(np.sqrt(variance))


def db(power: float) -> float:
    """10 log10, nothing counting as -300 dB."""
    return float(10 * np.log10(max(power, 1e-30)))


def gap_levels(before: Level, after: Level, *, gap: bool) -> GapLevels:
    """Mean over the nodes, and how much of it is closed."""
    b, a, noise = (float(np.mean(x)) for x in (before.power, after.power, before.noise))
    closed = None
    if gap:
        closed = min(max(1 - (a - noise) / (b - noise), 0.0), 1.0) if b > noise else 0.0
    return GapLevels(db(b), db(a), db(noise), closed)


@dataclass(frozen=True, eq=False)
class Division:
    """Power of the gap per line and node, ``(L, n)``, with the variances of these estimates."""

    linear: Real
    nonlinear: Real
    noise: Real
    linear_variance: Real
    nonlinear_variance: Real


def divide(rig: Rig, data: PeriodicData, rest: Complex, U: Complex) -> Division:
    """Divide the gap into what is coherent with the inputs, what is not, and noise.

    Parameters
    ----------
    rest : array, (E, L, n)
        Measured minus simulated.
    U : array, (E, L, q)
        Lines of the inputs.
    """
    E, _, q = U.shape
    excited = np.zeros(rest.shape[1], dtype=bool)
    excited[list(rig.lines)] = True
    linear = np.zeros(rest.shape[1:])
    apart = np.mean(np.abs(rest) ** 2, axis=0)
    freedom = np.ones(rest.shape[1])
    if q < E:
        u = U[:, excited].transpose(1, 0, 2)
        y = rest[:, excited].transpose(1, 0, 2)
        coherent = u @ (np.linalg.pinv(u) @ y)
        left = np.sum(np.abs(y - coherent) ** 2, axis=1) / (E - q)
        linear[excited] = np.mean(np.abs(coherent) ** 2, axis=1) - left * q / E
        apart[excited] = left
        freedom[excited] = (E - q) / E
    noise = np.where(data.counts[:, None], data.variance, 0.0)
    apart[~data.counts] = 0.0
    spread = apart**2 / (E * freedom[:, None])
    cross = 2 * np.maximum(linear, 0.0) * apart / E + (apart * q / E) ** 2 / max(q, 1) * excited[:, None]
    return Division(linear, apart - noise, noise, cross + spread * (q / E) ** 2, spread)


def node_gaps(rig: Rig, before: Level, after: Level, division: Division) -> tuple[NodeGap, ...]:
    """Levels and shares per node."""
    found = []
    for i, node in enumerate(rig.nodes):
        shares = _shares(
            *(float(part[:, i].sum()) for part in (division.linear, division.nonlinear, division.noise))
        )
        found.append(NodeGap(node.name, db(before.power[i]), db(after.power[i]), db(before.noise[i]), *shares))
    return tuple(found)


def band_shares(rig: Rig, data: PeriodicData, division: Division) -> tuple[BandShare, ...]:
    """Shares per node and band, with standard errors."""
    resolution = rig.sample_rate / rig.period_samples
    first, last, top = rig.lines[0], rig.lines[-1], rig.period_samples // 2
    edges = np.unique(np.round(np.geomspace(max(first, 1), last + 1, _BANDS + 1)).astype(int))
    ranges = [(0, first), *pairwise(edges.tolist()), (last + 1, top + 1)]
    found = []
    for i, node in enumerate(rig.nodes):
        measured = float(np.mean(np.sum(np.abs(data.Y[..., i]) ** 2, axis=1)))
        for low, high in ranges:
            if high <= low:
                continue
            at = slice(int(low), int(high))
            parts = [float(part[at, i].sum()) for part in (division.linear, division.nonlinear, division.noise)]
            total = max(sum(max(part, 0.0) for part in parts), 1e-300)
            errors = [
                float(np.sqrt(part[at, i].sum())) / total
                for part in (division.linear_variance, division.nonlinear_variance)
            ]
            noise_error = parts[2] / total / np.sqrt(data.degrees * (high - low))
            found.append(
                BandShare(
                    node.name,
                    (float(low * resolution), float((high - 1) * resolution)),
                    db(sum(parts) / measured),
                    *_shares(*parts),
                    errors[0],
                    errors[1],
                    float(noise_error),
                )
            )
    return tuple(found)


def _shares(linear: float, nonlinear: float, noise: float) -> tuple[float, float, float]:
    parts = [max(part, 0.0) for part in (linear, nonlinear, noise)]
    total = sum(parts) or 1.0
    return parts[0] / total, parts[1] / total, parts[2] / total
