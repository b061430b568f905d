"""Sums to levels: BLA, node-to-node network, distortion levels and p-values.

Every residual of the method is a linear form ``e = g V`` of ``V = [U; R]``, so each variance is the quadratic form
``g A g^H`` of a moment matrix of :class:`creak.statistics.Sums`. The rows ``g`` differ with the analysis:

* classical, ``e = S U - Y`` (30): ``g = [0, -I]``;
* networked, ``e_i = G_u,i u_i + sum_j G_ij y_j - y_i`` (36), the row of ``G`` estimated by (31)-(35).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from creak.hermitian import lines_last
from creak.location import locate
from creak.records import Complex, ElementShare, Estimate, NodeLevel, Real, Rig, Scope, Spectra
from creak.residuals import POWERS, residual_powers
from creak.rows import edge_rows, pulls
from creak.significance import line_p_values, pooled_p_value, q_values
from creak.statistics import Sums

SIGNIFICANT = 1e-3
"""Chance, over all nodes together, that elements are looked for where the structure is linear."""


def node_to_node(sums: Sums, rig: Rig) -> tuple[Complex, Complex]:
    """BLA from node to node (31)-(35).

    For a dense network that is ``G_u,i = 1/(S^-1)_ii`` and ``G_ij = -(S^-1)_ij/(S^-1)_ii``. Where edges are
    given, the rows of absent edges are left out and the rest is solved by least squares over all experiments.

    Parameters
    ----------
    sums : Sums
    rig : Rig
        Every node is driven.

    Returns
    -------
    G_u : array, (F, n)
        From the input of a node to the node.
    G_y : array, (F, n, n)
        From node (column) to node (row); zero on the diagonal and at absent edges.

    Raises
    ------
    numpy.linalg.LinAlgError
        If ``S`` cannot be inverted, for instance because a sensor is dead.
    """
    n = rig.n
    diagonal = np.arange(n)
    if rig.network is None:
        inputs, pull = _dense_pull(sums.S)
        pull[diagonal, diagonal] = 0.0
        return inputs.T, pull.transpose(2, 0, 1)
    inputs, pull, _ = edge_forms(sums, np.arange(n), neighbours(rig))
    pull[diagonal, diagonal] = 0.0
    return inputs.T, pull.transpose(2, 0, 1)


def fitted_parameters(rig: Rig) -> Real:
    """Complex parameters that the networked analysis fits at each node and line, d_i, ``(n,)``."""
    if rig.network is None:
        return np.full(rig.n, float(rig.n))
    return np.asarray(1.0 + neighbours(rig).sum(axis=1))


def estimate(rig: Rig, sums: Sums, scope: Scope, time: int, realisation: int) -> Estimate:
    """Levels and spectra of all nodes from the sums of at least one realisation.

    Parameters
    ----------
    rig : Rig
    sums : Sums
        Levels are about its ``S``, whatever its moments are about.
    scope : Scope
    time : int
        Recorded time at the end of the last period, ns since the Unix epoch.
    realisation : int
        Index of the last realisation in the sums.

    Returns
    -------
    Estimate
        Quantities that the data do not carry are None (levels) or NaN (spectra), with the reason in
        ``unavailable``.
    """
    unavailable = []
    if sums.periods < 2:
        unavailable.append("noise and nonlinear levels and p-values need two steady periods; there is one")
    if sums.realisations < 2:
        unavailable.append("total and nonlinear levels and p-values need two realisations; there is one")
    forms = None
    if not rig.square:
        names = ", ".join(node.name for node in rig.nodes if node.input is None)
        unavailable.append(f"networked levels need every node driven; without input: {names}")
    else:
        try:
            forms = _networked_forms(rig, sums)
        except np.linalg.LinAlgError:
            unavailable.append(
                "networked levels need a response matrix that can be inverted; this one is singular"
            )
    n, F = rig.n, len(rig.lines)
    signal, classical, networked = powers_of(sums, forms)
    classical_total, classical_noise = _variances(classical, sums)
    p_value = np.full(n, np.nan)
    line_p = classical_p = np.full((F, n), np.nan)
    testable = sums.periods > 1 and sums.realisations > 1
    if testable:
        classical_p = _p_values(classical, sums, np.full(n, float(rig.q)))
    elements: tuple[ElementShare, ...] = ()
    if networked is None:
        total = noise = np.full((F, n), np.nan)
    else:
        total, noise = _variances(networked, sums)
        if testable:
            line_p = _p_values(networked, sums, fitted_parameters(rig))
            p_value = pooled_p_value(line_p)
            elements = _elements(rig, sums, p_value)
    spectra = Spectra(
        frequency=rig.frequencies,
        signal=signal,
        noise=noise,
        total=total,
        nonlinear=np.maximum(total - noise, 0.0),
        classical_noise=classical_noise,
        classical_total=classical_total,
        classical_nonlinear=np.maximum(classical_total - classical_noise, 0.0),
        p_value=line_p,
        q_value=q_values(line_p),
        classical_p_value=classical_p,
    )
    return Estimate(
        scope=scope,
        time=time,
        realisation=realisation,
        realisations=sums.realisations,
        experiments=sums.experiments,
        periods=sums.periods,
        nodes=tuple(_level(rig.nodes[i].name, i, spectra, p_value[i]) for i in range(n)),
        spectra=spectra,
        located=forms is not None,
        elements=elements,
        unavailable=tuple(unavailable),
    )


def _elements(rig: Rig, sums: Sums, p_value: Real) -> tuple[ElementShare, ...]:
    """Elements that distort; none where no node is significant."""
    if not p_value.min() * rig.n < SIGNIFICANT:
        return ()
    try:
        return locate(rig, sums.normal())
    except np.linalg.LinAlgError:  # more nodes than the noise covariance has degrees of freedom, or a dead one
        return ()


def neighbours(rig: Rig) -> NDArray[np.bool_]:
    """Which nodes share an edge, ``(n, n)``; none of a dense network, whose edges are not given."""
    names = [node.name for node in rig.nodes]
    near = np.zeros((rig.n, rig.n), dtype=np.bool_)
    for a, b in rig.network or ():
        i, j = names.index(a), names.index(b)
        near[i, j] = near[j, i] = True
    return near


class Forms(NamedTuple):
    """Networked residuals (36) as ``e = misfit U + pull R``, lines last, ``(n, n, F)``."""

    misfit: Complex
    pull: Complex


def _networked_forms(rig: Rig, sums: Sums) -> Forms:
    n = rig.n
    if rig.network is None:  # G_u + (G_y - I) S vanishes
        return Forms(NONE, _dense_pull(sums.S)[1])
    _, pull, misfit = edge_forms(sums, np.arange(n), neighbours(rig))
    return Forms(misfit, pull)


def edge_forms(sums: Sums, nodes: NDArray[np.intp], near: NDArray[np.bool_]) -> tuple[Complex, Complex, Complex]:
    """Rows of ``G`` for given edges, any number for a node.

    Parameters
    ----------
    sums : Sums
        As many nodes as inputs.
    nodes : array, (rows,)
        The node of each row.
    near : array, (rows, n)
        Its neighbours.

    Returns
    -------
    inputs : array, (rows, F)
        ``G_u`` of the node.
    pull, misfit : array, (rows, n, F)
        The row's ``G_y``, with -1 at the node itself; what remains of the inputs in ``misfit U + pull R``.

    Raises
    ------
    numpy.linalg.LinAlgError
        If inputs do not span all directions, or a neighbour does not move.
    """
    rows, n, F = len(nodes), sums.inputs, len(sums.S)
    inputs = np.empty((rows, F), dtype=np.complex128)
    pull, misfit = np.empty((rows, n, F), dtype=np.complex128), np.empty((rows, n, F), dtype=np.complex128)
    if not edge_rows(lines_last(sums.S), sums.packed_between, nodes, near, inputs, pull, misfit):
        raise np.linalg.LinAlgError("the inputs, or the motion of a node, are singular at a line")
    return inputs, pull, misfit


def _dense_pull(S: Complex) -> tuple[Complex, Complex]:
    """``1 / diag(S^-1)``, ``(n, F)``, and that times ``-S^-1``, ``(n, n, F)``.

    Raises
    ------
    numpy.linalg.LinAlgError
    """
    S = lines_last(S)
    inputs, pull = np.empty(S.shape[1:], dtype=np.complex128), np.empty_like(S)
    if not pulls(S, inputs, pull):
        raise np.linalg.LinAlgError("the response matrix of a line is singular")
    return inputs, pull


NONE = np.zeros((0, 0, 0), dtype=np.complex128)
"""A form that is nothing."""


class Powers(NamedTuple):
    """Sums of squares of residuals, each ``(F, n)``: between and within experiments, and of the periods' sums."""

    between: Real
    within: Real
    common: Real


def powers_of(sums: Sums, forms: Forms | None) -> tuple[Real, Powers, Powers | None]:
    """Signal power ``(F, n)``; the powers of classical and networked residuals."""
    F, n = sums.S.shape[:2]
    powers = np.empty((POWERS, n, F))
    S = lines_last(sums.S)
    residual_powers(
        sums.packed_between,
        sums.packed_within,
        np.ascontiguousarray(sums.period_sums.swapaxes(1, 2)),
        S,
        S if sums.about is None else lines_last(sums.about),
        NONE if forms is None else forms.misfit,
        NONE if forms is None else forms.pull,
        powers,
    )
    signal, *residuals = powers.swapaxes(1, 2)
    signal /= sums.experiments * sums.periods
    return signal, Powers(*residuals[:3]), None if forms is None else Powers(*residuals[3:])


def _p_values(powers: Powers, sums: Sums, fitted: Real) -> Real:
    """p-values of the residuals per line and node, ``(F, n)``."""
    return line_p_values(powers.between, powers.within, sums.experiments, sums.periods, fitted)


def _variances(powers: Powers, sums: Sums) -> tuple[Real, Real]:
    """Total (39) and noise (40) variance of residuals, each ``(F, n)``; NaN where the data carry none."""
    E, P = sums.experiments, sums.periods
    none = np.full(powers.between.shape, np.nan)
    noise = powers.within / (E * (P - 1)) if P > 1 else none
    if sums.realisations < 2:
        return none, noise
    total = (powers.between + powers.within - powers.common / E) / (P * (E - 1))
    return total, noise


def _level(name: str, i: int, spectra: Spectra, p_value: float) -> NodeLevel:
    """Band levels of node i: sums over the excited lines."""
    noise, total = spectra.noise[:, i].sum(), spectra.total[:, i].sum()
    classical_noise = spectra.classical_noise[:, i].sum()
    classical_total = spectra.classical_total[:, i].sum()
    return NodeLevel(
        name=name,
        signal_db=_db(spectra.signal[:, i].sum()),
        noise_db=_db(noise),
        total_db=_db(total),
        nonlinear_db=_db(total - noise),
        total_to_noise_db=_ratio_db(total, noise),
        classical_noise_db=_db(classical_noise),
        classical_total_db=_db(classical_total),
        classical_total_to_noise_db=_ratio_db(classical_total, classical_noise),
        p_value=float(p_value) if np.isfinite(p_value) else None,
    )


def _db(power: float) -> float | None:
    """Level of a power in dB; None if it is not positive or not available."""
    return float(10.0 * np.log10(power)) if power > 0 else None


def _ratio_db(power: float, reference: float) -> float | None:
    return _db(power / reference) if reference > 0 and power > 0 else None
