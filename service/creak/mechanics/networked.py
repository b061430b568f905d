"""A linear structure ``M x'' + C x' + K x = u`` as a dynamic network: equations (2) to (4) of the paper.

What the networked analysis estimates from data is computed here from the matrices, so that the two can be
compared.
"""

from dataclasses import dataclass

import numpy as np

from creak.errors import MeasurementError
from creak.records import Complex, Real


@dataclass(frozen=True, eq=False)
class Networked:
    """The three matrices of a dynamic network, with ``S = (I - G_y)^-1 G_u``.

    Parameters
    ----------
    G_y : array, (F, n, n)
        From node (column) to node (row); zero on the diagonal, and where two nodes share no element.
    G_u : array, (F, n, n)
        From each input to its own node; diagonal.
    S : array, (F, n, n)
        From the inputs (columns) to the nodes (rows).
    """

    G_y: Complex
    G_u: Complex
    S: Complex


def dynamic_stiffness(mass: Real, damping: Real, stiffness: Real, frequencies: Real) -> Complex:
    """Dynamic stiffness ``Z = K + j w C - w^2 M`` with ``w = 2 pi f``.

    Parameters
    ----------
    mass, damping, stiffness : array, (n, n)
        kg, N s/m, N/m.
    frequencies : array, (F,)
        Hz.

    Returns
    -------
    array, (F, n, n)
        N/m.

    Raises
    ------
    MeasurementError
        If the matrices are not square and of one size.
    """
    M, C, K = (np.asarray(matrix, dtype=np.float64) for matrix in (mass, damping, stiffness))
    for name, matrix in (("mass", M), ("damping", C), ("stiffness", K)):
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or matrix.shape != M.shape:
            raise MeasurementError(f"{name}: shape {matrix.shape}, expected square and that of mass, {M.shape}")
    w = 2 * np.pi * np.asarray(frequencies, dtype=np.float64)[:, None, None]
    return np.asarray(K + 1j * w * C - w**2 * M, dtype=np.complex128)


def networked(mass: Real, damping: Real, stiffness: Real, frequencies: Real) -> Networked:
    """Matrices ``M, C, K`` as a dynamic network, (2)-(4).

    Row ``i`` of ``Z X = U`` reads ``Z_ii x_i + sum_j Z_ij x_j = u_i``. Solved for the node's own motion it is the
    paper's (3)::

        x_i = sum_{j != i} G_ij x_j + G_u,i u_i,     G_ij = -Z_ij / Z_ii,     G_u,i = 1 / Z_ii

    For the paper's second mass, between two springs and dampers, that is
    ``G_21 = (k_2 + c_2 p) / (m_2 p^2 + (c_2 + c_3) p + k_2 + k_3)`` with ``p = j w``. All nodes together give
    ``x = G_y x + G_u u``, hence ``S = (I - G_y)^-1 G_u``, which equals ``Z^-1``.

    Parameters
    ----------
    mass, damping, stiffness : array, (n, n)
        kg, N s/m, N/m; one coordinate a node, each with its own input.
    frequencies : array, (F,)
        Hz; not where a ``Z_ii`` is zero (an undamped mass held fast by its neighbours, at resonance).

    Returns
    -------
    Networked

    Raises
    ------
    MeasurementError
        If the shapes do not fit, or the structure without damping is excited at a resonance.

    Examples
    --------
    A mass of 1 kg on a spring of 100 N/m, at rest:

    >>> import numpy as np
    >>> alone = networked(np.eye(1), np.zeros((1, 1)), 100 * np.eye(1), np.array([0.0]))
    >>> complex(alone.S[0, 0, 0]), complex(alone.G_y[0, 0, 0])
    ((0.01+0j), 0j)
    """
    Z = dynamic_stiffness(mass, damping, stiffness, frequencies)
    n = Z.shape[1]
    diagonal = np.einsum("fii->fi", Z)
    if not (np.abs(diagonal) > 0).all():
        k, i = (int(index) for index in np.argwhere(~(np.abs(diagonal) > 0))[0])
        raise MeasurementError(f"frequencies[{k}]: node {i} has no dynamic stiffness there, so G is unbounded")
    G_y = np.where(np.eye(n, dtype=np.bool_), 0.0, -Z / diagonal[..., None])
    G_u = np.eye(n) / diagonal[..., None]
    try:
        S = np.linalg.solve(np.eye(n) - G_y, G_u)
    except np.linalg.LinAlgError:
        raise MeasurementError(
            "frequencies: the structure is undamped and at resonance, so S is unbounded"
        ) from None
    return Networked(G_y=G_y, G_u=G_u, S=S)
