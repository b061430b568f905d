"""The smallest set of elements that explains the evidence, and how sure that is."""

from itertools import combinations

import numpy as np
import scipy.special

from creak.location.evidence import Edge, Evidence, along, incidence, parts_of
from creak.records import Complex, ElementShare, Real, Rig
from creak.statistics import Sums

_GROUND = "ground"
_ALPHA = 1e-3  # chance that an element is listed which is not there, over all places
_LEAST_GAIN = 0.1  # mean gain above 1 that counts: far below 3 dB, far above what the whitening neglects
_CLEAR = 0.999  # confidence above which one tree within a part is told from the others
_STRONG = 4.0  # power over noise that every tree's every force must have for a line to speak about correlation
_FEWEST_LINES = 5
_CORRELATED = 0.5  # mean -ln(1 - coherence^2) of an element's force with the others', beyond which none is sure
_LARGEST_PART = 5  # vertices of a part whose spanning trees (125) are compared
_MOST_NODES_FOR_PAIRS = 10
_MOST_ELEMENTS = 8  # beyond which the search stops: where all that moves distorts, a longer list tells nothing
_SWEEPS = 4  # of exchanges after each new element; so the search asks at most 150 times what a place explains


def locate(rig: Rig, sums: Sums) -> tuple[ElementShare, ...]:
    """Find the smallest set of elements that explains the distortion.

    Parameters
    ----------
    rig : Rig
        Every node is driven.
    sums : Sums
        At least two periods and two realisations.

    Returns
    -------
    tuple of ElementShare
        In falling share of the noise-corrected power of the missing force; empty if none is significant. At most
        eight: what more there are make the sum of the shares fall short of 1.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the noise covariance or ``S`` is singular, for instance because a sensor is dead.
    """
    evidence = Evidence.of(sums)
    edges = _smallest_set(evidence)
    if not edges:
        return ()
    certain = {edge: _confidence(evidence, edges, edge) for edge in edges}
    separable = dict.fromkeys(edges, True)
    for part in parts_of(edges):
        if len(part) > 1:
            tree, confidence = _least_correlated(evidence, edges, part)
            sure = min(certain.pop(edge) for edge in part)
            edges = tuple(edge for edge in edges if edge not in part) + tree
            certain |= dict.fromkeys(tree, min(sure, confidence))
            separable |= dict.fromkeys(tree, confidence >= _CLEAR)
    names = [*(node.name for node in rig.nodes), _GROUND]
    shares = _shares(evidence, edges)
    found = [
        ElementShare((names[i], names[j]), share, certain[i, j], separable[i, j])
        for (i, j), share in zip(edges, shares.tolist(), strict=True)
    ]
    return tuple(sorted(found, key=lambda element: -element.share))


def _smallest_set(evidence: Evidence) -> tuple[Edge, ...]:
    """Add the strongest place until noise is left, exchanging earlier choices; then try with fewer."""
    edges: tuple[Edge, ...] = ()
    while len(edges) < min(evidence.nodes, _MOST_ELEMENTS):
        more = _strongest(evidence.without(edges))
        if more is None:
            break
        edges = _exchanged(evidence, (*edges, more))
    if len(edges) > 2 and evidence.nodes <= _MOST_NODES_FOR_PAIRS:
        pair = _sufficient_pair(evidence)
        if pair is not None:
            return pair
    return edges


def _strongest(rest: Evidence) -> Edge | None:
    """The place that explains most of what is left; None if that is noise."""
    edges, gains = rest.gains()
    if not edges:
        return None
    best = int(np.argmax(rest.scores(gains).sum(axis=0)))
    if gains[:, best].mean() - 1.0 < _LEAST_GAIN:
        return None
    return edges[best] if _pooled(rest, gains[:, best]) * len(edges) < _ALPHA else None


def _pooled(rest: Evidence, gains: Real) -> float:
    """Probability of such gains over all lines if there is no force, by Fisher's method."""
    p = np.maximum(rest.p_values(gains), np.finfo(np.float64).tiny)
    return float(scipy.special.chdtrc(2.0 * len(p), -2.0 * np.log(p).sum()))


def _exchanged(evidence: Evidence, edges: tuple[Edge, ...]) -> tuple[Edge, ...]:
    """Replace one element at a time by the place that explains most beside the others, until none is better."""
    for _ in range(_SWEEPS):
        before = edges
        for edge in before:
            others = tuple(other for other in edges if other != edge)
            places, gains = evidence.without(others).gains()
            totals = evidence.scores(gains).sum(axis=0)
            best = int(np.argmax(totals))
            if edge not in places or totals[best] > totals[places.index(edge)]:
                edges = (*others, places[best])
        if edges == before or set(edges) == set(before):
            break
    return edges


def _sufficient_pair(evidence: Evidence) -> tuple[Edge, ...] | None:
    """Two places beside which only noise is left, the likeliest such pair; None if there is none."""
    found: list[tuple[float, tuple[Edge, ...]]] = []
    first_places, first_gains = evidence.gains()
    first_totals = evidence.scores(first_gains).sum(axis=0)
    for first, total in zip(first_places, first_totals.tolist(), strict=True):
        rest = evidence.without((first,))
        places, gains = rest.gains()
        totals = rest.scores(gains).sum(axis=0)
        best = int(np.argmax(totals))
        found.append((total + totals[best], (first, places[best])))
    _, pair = max(found)
    return pair if _strongest(evidence.without(pair)) is None else None


def _confidence(evidence: Evidence, edges: tuple[Edge, ...], edge: Edge) -> float:
    """Probability that this place, and no other beside the rest of the set, is where a force acts.

    Lines are independent, so the mean difference of two places' log-likelihoods has a known spread (Q. H. Vuong,
    *Econometrica* 57 (1989) 307, for models of which neither contains the other).
    """
    beside = evidence.without(tuple(other for other in edges if other != edge))
    places, gains = beside.gains()
    own = places.index(edge)
    spanned = set(places) - set(evidence.without(edges).gains()[0])
    scores = beside.scores(gains)
    rivals = [i for i, place in enumerate(places) if place not in spanned]
    doubt = _pooled(beside, gains[:, own]) * len(places)
    doubt += float(_doubts(scores[:, [own]] - scores[:, rivals]).sum())
    return max(0.0, 1.0 - doubt)


def _doubts(advantage: Real) -> Real:
    """Probability that the true mean of each column is not above 0: ``(lines, columns)`` to ``(columns,)``."""
    lines = len(advantage)
    spread = advantage.std(axis=0, ddof=1) / np.sqrt(lines) if lines > 1 else np.full(advantage.shape[1], np.inf)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.nan_to_num(advantage.mean(axis=0) / spread)
    return np.asarray(scipy.special.ndtr(-z))


def _least_correlated(
    evidence: Evidence, edges: tuple[Edge, ...], part: tuple[Edge, ...]
) -> tuple[tuple[Edge, ...], float]:
    """Choose the spanning tree of a part whose forces are least correlated.

    All trees span the same forces, and ``det D`` is the same for all (the change from one to another has
    determinant 1), so by Hadamard's inequality the least correlated tree has the smallest product of powers.

    Returns
    -------
    tuple of Edge
        The tree.
    float
        Confidence that it is the right one; 0 if too few lines speak, or its forces are correlated too.
    """
    vertices = sorted({vertex for edge in part for vertex in edge})
    trees = [part]
    if len(vertices) <= _LARGEST_PART:
        every = tuple(combinations(vertices, 2))
        trees = [tree for tree in combinations(every, len(part)) if _spans(tree, vertices)]
    others = tuple(edge for edge in edges if edge not in part)
    if len(trees) == 1:
        return part, 0.0
    fits = [_powers(evidence, tree, others) for tree in trees]
    determinant = np.linalg.slogdet(_covariance(evidence, part + others)[0][:, : len(part), : len(part)])[1]
    clear = np.stack([noisy / quiet for noisy, quiet in fits]).min(axis=(0, 2)) > _STRONG
    if clear.sum() < _FEWEST_LINES:
        return part, 0.0
    logs = np.stack([np.log(noisy[clear]).sum(axis=1) for noisy, _ in fits], axis=1)
    best = int(np.argmin(logs.mean(axis=0)))
    if (logs[:, best] - determinant[clear]).mean() > _CORRELATED * (len(part) - 1):
        return trees[best], 0.0
    rivals = [i for i in range(len(trees)) if i != best]
    return trees[best], max(0.0, 1.0 - float(_doubts(logs[:, rivals] - logs[:, [best]]).sum()))


def _spans(edges: tuple[Edge, ...], vertices: list[int]) -> bool:
    """True if these edges hang together and leave out none of the vertices."""
    return len(parts_of(edges)) == 1 and {vertex for edge in edges for vertex in edge} == set(vertices)


def _powers(evidence: Evidence, edges: tuple[Edge, ...], others: tuple[Edge, ...] = ()) -> tuple[Real, Real]:
    """Force power of every element per line as it is measured, and what noise gives there, each ``(F, edges)``."""
    measured, noise = (
        np.einsum("fii->fi", matrix).real[:, : len(edges)] for matrix in _covariance(evidence, edges + others)
    )
    return measured, evidence.bias * noise


def _covariance(evidence: Evidence, edges: tuple[Edge, ...]) -> tuple[Complex, Complex]:
    """Covariance of the elements' forces, and of its noise, by weighted least squares; ``(F, edges, edges)``."""
    spread = np.linalg.inv(along(evidence.J, edges))
    return np.asarray(spread @ along(evidence.H, edges) @ spread), np.asarray(spread)


def _shares(evidence: Evidence, edges: tuple[Edge, ...]) -> Real:
    """Fractions of the noise-corrected power of the missing force, ``(edges,)``.

    An element's force counts at both nodes that it acts on. Only lines at which the element stands out of the
    noise are summed, so that noise which ``S^-1`` amplifies at high frequencies does not drown the rest.
    """
    measured, noise = _powers(evidence, edges)
    power = np.empty(len(edges))
    ends = (incidence(edges, evidence.nodes) ** 2).sum(axis=0)
    for i, edge in enumerate(edges):
        beside = evidence.without(tuple(other for other in edges if other != edge))
        places, gains = beside.gains()
        stands = beside.p_values(gains[:, places.index(edge)]) < _ALPHA
        at = stands if stands.any() else slice(None)
        power[i] = ends[i] * max(0.0, float(((measured - noise)[at, i] / evidence.size[at]).sum()))
    total = power.sum()
    return evidence.explained(edges) * (power / total if total > 0 else np.full(len(edges), 1 / len(edges)))
