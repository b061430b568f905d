"""Do the data fit the model: the given edges of a network, and one response matrix for all amplitudes.

Both questions are answered from :class:`creak.statistics.Sums` alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from creak.hermitian import lines_last
from creak.network import NONE, Forms, edge_forms, fitted_parameters, neighbours, powers_of
from creak.records import Complex, Real, Rig
from creak.residuals import least_squares_powers
from creak.significance import pooled_p_value, variance_ratio_p_values
from creak.statistics import Sums, quadratic


@dataclass(frozen=True)
class EdgeTest:
    """Whether the given edges of a sparse network explain a node.

    Parameters
    ----------
    node : str
    p_value : float
        Probability of so large a misfit if the edges are right (white noise, random-phase excitation); 1 where
        every other node is a neighbour, so that nothing is left to test.
    missing : str or None
        The node without an edge to this one which, joined to it, would explain most of the misfit; None where
        there is no misfit to explain.
    """

    node: str
    p_value: float
    missing: str | None


def edge_tests(rig: Rig, sums: Sums) -> tuple[EdgeTest, ...]:
    """Test the given edges, node by node.

    The row of ``G`` with ``d`` free entries leaves of the best linear approximation a coherent misfit ``c U``, and
    of the residuals about it an incoherent rest ``r``. If the edges are right the misfit is nothing but the
    uncertainty of ``S``, and at each line ::

        [P sum_e |c U[e]|^2 / (n - d)] / [P sum_e |r[e]|^2 / (E - n)]  follows  F(2 (n - d), 2 (E - n)).

    Distortion stands in both and does no harm. The lines are pooled by Fisher's method.

    Parameters
    ----------
    rig : Rig
        Every node driven, edges given.
    sums : Sums
        At least two realisations.

    Returns
    -------
    tuple of EdgeTest, (n,)
        Empty where there is nothing to test: a dense network, a node without input, one realisation.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the response matrix cannot be inverted.
    """
    n = rig.n
    if rig.network is None or not rig.square or sums.realisations < 2:
        return ()
    sums = replace(sums, S=sums.least_squares(), about=sums.S if sums.about is None else sums.about)
    near = neighbours(rig)
    _, pull, misfit = edge_forms(sums, np.arange(n), near)
    coherent = _coherent(misfit, sums)
    networked = powers_of(sums, Forms(NONE, pull))[2]
    assert networked is not None
    left, rest_free = n - fitted_parameters(rig), sums.experiments - n
    p = np.ones((len(rig.lines), n))
    open_ = left > 0
    for i in np.flatnonzero(open_).tolist():
        p[:, i] = variance_ratio_p_values(
            coherent[:, i], networked.between[:, i], float(left[i]), float(rest_free)
        )
    pooled = np.where(open_, pooled_p_value(p), 1.0)
    tests = []
    for i, node in enumerate(rig.nodes):
        missing = _most_missed(rig, sums, near[i], i) if pooled[i] < 0.05 else None
        tests.append(EdgeTest(node.name, float(pooled[i]), missing))
    return tuple(tests)


def edge_remarks(tests: tuple[EdgeTest, ...], level: float = 1e-3) -> tuple[str, ...]:
    """Sentences for the nodes whose edges the data contradict, at a false-alarm rate over all nodes together."""
    return tuple(
        f"the given edges do not explain node {test.node} (p = {test.p_value:.1e})"
        + (f"; an edge to {test.missing} would explain most" if test.missing is not None else "")
        for test in tests
        if test.p_value * len(tests) < level
    )


@dataclass(frozen=True, eq=False)
class Reference:
    """Sums whose ``S`` is the best linear approximation that the levels are to be taken from, and why.

    Parameters
    ----------
    sums : Sums
        The moments are about what they were about.
    remarks : tuple of str
        A sentence if it is not (28).
    """

    sums: Sums
    remarks: tuple[str, ...] = ()


_NOTICEABLE_DB = 0.04  # (28) may stand this far above least squares: 1 % of power


def reference(sums: Sums, names: tuple[str, ...]) -> Reference:
    """Choose between (28) and least squares.

    (28) is kept, as the paper's, unless it leaves more than 0.04 dB of residual power above least squares at
    some node: that happens where amplitudes differ between realisations, or experiments are far from orthogonal.

    Parameters
    ----------
    sums : Sums
    names : tuple of str, (n,)
        Nodes.
    """
    n = len(names)
    plain, least = np.zeros(n), np.zeros(n)
    moments = sums.packed_between, sums.packed_within
    about = sums.S if sums.about is None else sums.about
    if not least_squares_powers(*moments, lines_last(sums.S), lines_last(about), plain, least):
        return Reference(sums)
    excess = np.zeros_like(plain)
    known = least > 0
    excess[known] = 10 * np.log10(np.maximum(plain[known] / least[known], 1.0))
    worst = int(np.argmax(excess))
    if excess[worst] <= _NOTICEABLE_DB:
        return Reference(sums)
    sentence = (
        "amplitudes differ between realisations, so levels are taken about the least-squares approximation; "
        f"about the mean of (28) the classical residual of node {names[worst]} is {excess[worst]:.2f} dB higher"
    )
    return Reference(replace(sums, S=sums.least_squares(), about=about), (sentence,))


def _coherent(misfit: Complex, sums: Sums) -> Real:
    """Power of what rows ``(rows, n, F)`` leave of the inputs, ``(F, rows)``."""
    return quadratic(misfit.transpose(2, 0, 1), sums.packed_between)


def _most_missed(rig: Rig, sums: Sums, near: NDArray[np.bool_], i: int) -> str | None:
    """Name of the node whose edge to node ``i`` would leave least misfit there."""
    others = np.flatnonzero(~near & (np.arange(rig.n) != i))
    if not others.size:
        return None
    joined = np.repeat(near[None], others.size, axis=0)
    joined[np.arange(others.size), others] = True
    _, _, misfit = edge_forms(sums, np.full(others.size, i), joined)
    return rig.nodes[int(others[np.argmin(_coherent(misfit, sums).sum(axis=0))])].name
