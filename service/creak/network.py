"""Sums to levels: BLA, node-to-node network, distortion levels and p-values.

Every residual of the method is a linear form ``e = g V`` of ``V = [U; R]``, so each variance is the quadratic form
``g A g^H`` of a moment matrix of :class:`creak.statistics.Sums`. The rows ``g`` differ with the analysis:

* classical, ``e = S U - Y`` (30): ``g = [0, -I]``;
* networked, ``e_i = G_u,i u_i + sum_j G_ij y_j - y_i`` (36), the row of ``G`` estimated by (31)-(35).
"""

from typing import NamedTuple

import numpy as np

from creak.location import locate
from creak.records import Complex, ElementShare, Estimate, NodeLevel, Real, Rig, Scope, Spectra
from creak.significance import line_p_values, pooled_p_value, q_values
from creak.statistics import Sums, quadratic

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
    if rig.network is None:
        inverse = np.linalg.inv(sums.S)
        diagonal = np.einsum("fii->fi", inverse)
        G_y = -inverse / diagonal[..., None]
        G_y[:, np.arange(n), np.arange(n)] = 0.0
        return 1.0 / diagonal, G_y
    G_u = np.zeros((len(rig.lines), n), dtype=np.complex128)
    G_y = np.zeros((len(rig.lines), n, n), dtype=np.complex128)
    inputs = sums.between[:, :n, :n]  # P sum_e U U^H: how strongly each direction of the inputs was excited
    factor = np.linalg.cholesky(inputs)
    simulated = sums.S @ factor
    for i, near in enumerate(_neighbours(rig)):
        Z = np.concatenate((factor[:, i : i + 1], simulated[:, near]), axis=1)
        # Inputs and motions differ by orders of magnitude; rows of unit length keep the pseudo-inverse sharp.
        scale = np.linalg.norm(Z, axis=2)
        row = np.einsum("fk,fkj->fj", simulated[:, i], np.linalg.pinv(Z / scale[..., None])) / scale
        G_u[:, i] = row[:, 0]
        G_y[:, i, near] = row[:, 1:]
    return G_u, G_y


def fitted_parameters(rig: Rig) -> Real:
    """Complex parameters that the networked analysis fits at each node and line, d_i, ``(n,)``."""
    if rig.network is None:
        return np.full(rig.n, float(rig.n))
    return np.array([1.0 + len(near) for near in _neighbours(rig)])


def estimate(rig: Rig, sums: Sums, scope: Scope, time: int, realisation: int) -> Estimate:
    """Levels and spectra of all nodes from the sums of at least one realisation.

    Parameters
    ----------
    rig : Rig
    sums : Sums
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
    q, n, F = rig.q, rig.n, len(rig.lines)
    eye = np.broadcast_to(np.eye(n, dtype=np.complex128), (F, n, n))
    response = np.concatenate((sums.S, eye), axis=2)  # Y = S U + R
    powers = _powers(response, sums)
    signal = (powers.between + powers.within) / (sums.experiments * sums.periods)
    classical = np.concatenate((np.zeros((F, n, q), dtype=np.complex128), -eye), axis=2)
    powers = _Powers(*(np.einsum("fii->fi", moments)[:, q:].real for moments in (sums.between, sums.within)))
    classical_total, classical_noise = _variances(classical, powers, sums)
    p_value = np.full(n, np.nan)
    line_p = classical_p = np.full((F, n), np.nan)
    testable = sums.periods > 1 and sums.realisations > 1
    if testable:
        classical_p = _p_values(powers, sums, np.full(n, float(q)))
    elements: tuple[ElementShare, ...] = ()
    if forms is None:
        total = noise = np.full((F, n), np.nan)
    else:
        powers = _powers(forms, sums)
        total, noise = _variances(forms, powers, sums)
        if testable:
            line_p = _p_values(powers, sums, fitted_parameters(rig))
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
        return locate(rig, sums)
    except np.linalg.LinAlgError:  # more nodes than the noise covariance has degrees of freedom, or a dead one
        return ()


def _neighbours(rig: Rig) -> list[list[int]]:
    """Indices of the nodes that share an edge with each node, rising."""
    names = [node.name for node in rig.nodes]
    near: list[set[int]] = [set() for _ in names]
    for a, b in rig.network or ():
        i, j = names.index(a), names.index(b)
        near[i].add(j)
        near[j].add(i)
    return [sorted(indices) for indices in near]


def _networked_forms(rig: Rig, sums: Sums) -> Complex:
    """Rows g of the networked residuals (36) in terms of ``V = [U; R]``, ``(F, n, 2n)``."""
    G_u, G_y = node_to_node(sums, rig)
    n = rig.n
    pull = G_y - np.eye(n)  # acts on Y = S U + R
    if rig.network is None:
        on_inputs = np.zeros_like(sums.S)  # G_u + (G_y - I) S vanishes for a dense network
    else:
        on_inputs = pull @ sums.S
        on_inputs[:, np.arange(n), np.arange(n)] += G_u
    return np.concatenate((on_inputs, pull), axis=2)


class _Powers(NamedTuple):
    """Quadratic forms ``g A g^H`` of the moments between and within experiments, each ``(F, n)``."""

    between: Real
    within: Real


def _powers(forms: Complex, sums: Sums) -> _Powers:
    return _Powers(quadratic(forms, sums.between), quadratic(forms, sums.within))


def _p_values(powers: _Powers, sums: Sums, fitted: Real) -> Real:
    """p-values of the residuals per line and node, ``(F, n)``."""
    return line_p_values(powers.between, powers.within, sums.experiments, sums.periods, fitted)


def _variances(forms: Complex, powers: _Powers, sums: Sums) -> tuple[Real, Real]:
    """Total (39) and noise (40) variance of residuals, each ``(F, n)``; NaN where the data carry none."""
    E, P = sums.experiments, sums.periods
    none = np.full(forms.shape[:2], np.nan)
    noise = powers.within / (E * (P - 1)) if P > 1 else none
    if sums.realisations < 2:
        return none, noise
    means = np.einsum("fij,pfj->pfi", forms, sums.period_sums) / E
    common = (means.real**2 + means.imag**2).sum(axis=0)
    total = (powers.between + powers.within - E * common) / (P * (E - 1))
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
