"""Inner loops of the node-to-node network, compiled: its rows, dense or of given edges, line by line.

Lines last and in tiles, as in :mod:`creak.residuals`.
"""

import numpy as np
from numpy.typing import NDArray

from creak.compiling import part, vectorised
from creak.elimination import eliminate
from creak.hermitian import TILE, load
from creak.records import Complex, Real
from creak.residuals import decompose

_DEPENDENT = 1e-15  # part of a row that is left of it beside others, below which it is rounding


@vectorised
def pulls(S: Complex, inputs: Complex, pull: Complex) -> bool:
    """Rows of the dense network: ``pull = -S^-1 / diag(S^-1)``, by Gauss-Jordan elimination with partial pivoting.

    Parameters
    ----------
    S : array, (n, n, F)
    inputs : array, (n, F)
        Result: ``1 / diag(S^-1)``.
    pull : array, (n, n, F)
        Result; -1 on its diagonal.

    Returns
    -------
    bool
        False if the matrix of a line is singular.
    """
    n, _, F = S.shape
    w = 2 * n
    real, imag = np.zeros((n, w, TILE)), np.zeros((n, w, TILE))  # S beside the unit matrix
    pivots = np.zeros((n, TILE))
    larger, a, b = np.zeros(TILE), np.zeros(TILE), np.zeros(TILE)
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        for i in range(n):
            for j in range(n):
                for t in range(m):
                    real[i, j, t] = S[i, j, first + t].real
                    imag[i, j, t] = S[i, j, first + t].imag
                for t in range(TILE):
                    real[i, n + j, t] = 1.0 if i == j else 0.0
                    imag[i, n + j, t] = 0.0
        eliminate(real, imag, pivots, larger, a, b)
        for k in range(n):
            for t in range(m):
                if not pivots[k, t] > 0.0:
                    return False
        for i in range(n):
            for t in range(m):
                x, y = real[i, n + i, t], imag[i, n + i, t]
                power = x * x + y * y
                a[t] = x / power
                b[t] = -y / power
                inputs[i, first + t] = complex(a[t], b[t])
            for j in range(n):
                for t in range(m):
                    x, y = real[i, n + j, t], imag[i, n + j, t]
                    pull[i, j, first + t] = complex(b[t] * y - a[t] * x, -a[t] * y - b[t] * x)
            for t in range(m):
                pull[i, i, first + t] = -1.0
    return True


@part
def _size(v_real: Real, v_imag: Real, size: Real) -> None:
    """Lengths of the vectors of a tile, ``(n, tile)``."""
    for t in range(TILE):
        size[t] = 0.0
    for i in range(len(v_real)):
        for t in range(TILE):
            size[t] += v_real[i, t] * v_real[i, t] + v_imag[i, t] * v_imag[i, t]
    for t in range(TILE):
        size[t] = np.sqrt(size[t])


@vectorised
def edge_rows(
    S: Complex,
    between: Real,
    nodes: NDArray[np.intp],
    near: NDArray[np.bool_],
    inputs: Complex,
    pull: Complex,
    misfit: Complex,
) -> bool:
    """Rows of a network of given edges: least squares of ``x [u_i; y_near] = y_i`` over the simulated motions.

    With ``C C^H`` the inputs' moments the motions are ``S C``. The rows of ``Z = [C_i; (S C)_near]`` are made
    orthogonal one after another, and the right-hand side with them (modified Gram-Schmidt, stable for least
    squares: A. Bjorck, *BIT* 7 (1967) 1). A row that depends on those before it gets no share.

    Parameters
    ----------
    S : array, (n, n, F)
    between : array, (at least n^2, F)
        Packed moments, those of the inputs first.
    nodes : array, (rows,)
        The node of each row.
    near : array, (rows, n)
        Its neighbours.
    inputs : array, (rows, F)
        Result: from the node's own input.
    pull : array, (rows, n, F)
        Result: from its neighbours; -1 at the node itself.
    misfit : array, (rows, n, F)
        Result: ``pull S`` and `inputs`: what of the inputs the row leaves over.

    Returns
    -------
    bool
        False if the inputs of a line do not span all directions, or a neighbour does not move.
    """
    n, _, F = S.shape
    real, imag = np.zeros((n, n, TILE)), np.zeros((n, n, TILE))
    L_real, L_imag, d = np.zeros((n, n, TILE)), np.zeros((n, n, TILE)), np.ones((n, TILE))
    S_real, S_imag = np.zeros((n, n, TILE)), np.zeros((n, n, TILE))
    Y_real, Y_imag = np.zeros((n, n, TILE)), np.zeros((n, n, TILE))
    Q_real, Q_imag = np.zeros((n, n, TILE)), np.zeros((n, n, TILE))
    R_real, R_imag = np.zeros((n + 1, n, TILE)), np.zeros((n + 1, n, TILE))
    x_real, x_imag = np.zeros((n, TILE)), np.zeros((n, TILE))
    v_real, v_imag = np.zeros((n, TILE)), np.zeros((n, TILE))
    before, after = np.zeros(TILE), np.zeros(TILE)
    at = np.zeros(n + 1, dtype=np.intp)
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        load(between, n, first, m, real, imag)
        if not decompose(n, m, real, imag, L_real, L_imag, d):
            return False
        for i in range(n):  # C = L sqrt(D)
            for j in range(i + 1):
                for t in range(m):
                    root = np.sqrt(d[j, t])
                    L_real[i, j, t] = root if i == j else root * L_real[i, j, t]
                    L_imag[i, j, t] = 0.0 if i == j else root * L_imag[i, j, t]
        for i in range(n):
            for j in range(n):
                for t in range(m):
                    S_real[i, j, t], S_imag[i, j, t] = S[i, j, first + t].real, S[i, j, first + t].imag
        for i in range(n):
            for j in range(n):
                for t in range(TILE):
                    Y_real[i, j, t], Y_imag[i, j, t] = 0.0, 0.0
                for k in range(j, n):
                    for t in range(TILE):
                        Y_real[i, j, t] += S_real[i, k, t] * L_real[k, j, t] - S_imag[i, k, t] * L_imag[k, j, t]
                        Y_imag[i, j, t] += S_real[i, k, t] * L_imag[k, j, t] + S_imag[i, k, t] * L_real[k, j, t]
        for row in range(len(nodes)):
            node = nodes[row]
            count = 1  # row 0 of Z is the input's, the last one the right-hand side
            for j in range(n):
                if near[row, j]:
                    at[count] = j
                    count += 1
            at[count] = node
            for k in range(count + 1):
                for j in range(n):
                    for t in range(TILE):
                        v_real[j, t] = Y_real[at[k], j, t] if k > 0 else L_real[node, j, t]
                        v_imag[j, t] = Y_imag[at[k], j, t] if k > 0 else L_imag[node, j, t]
                _size(v_real, v_imag, before)
                for j in range(k):
                    for t in range(TILE):
                        R_real[k, j, t], R_imag[k, j, t] = 0.0, 0.0
                    for i in range(n):
                        for t in range(TILE):
                            a, b, x, y = v_real[i, t], v_imag[i, t], Q_real[j, i, t], Q_imag[j, i, t]
                            R_real[k, j, t] += a * x + b * y
                            R_imag[k, j, t] += b * x - a * y
                    for i in range(n):
                        for t in range(TILE):
                            a, b, x, y = R_real[k, j, t], R_imag[k, j, t], Q_real[j, i, t], Q_imag[j, i, t]
                            v_real[i, t] -= a * x - b * y
                            v_imag[i, t] -= a * y + b * x
                if k < count:
                    _size(v_real, v_imag, after)
                    for t in range(m):
                        if not before[t] > 0.0:
                            return False
                    for t in range(TILE):
                        left = after[t] > _DEPENDENT * before[t]
                        R_real[k, k, t] = after[t] if left else 1.0
                        before[t] = 1.0 / after[t] if left else 0.0
                    for i in range(n):
                        for t in range(TILE):
                            Q_real[k, i, t] = v_real[i, t] * before[t]
                            Q_imag[k, i, t] = v_imag[i, t] * before[t]
            for k in range(count - 1, -1, -1):  # x R = right-hand side
                for t in range(TILE):
                    x_real[k, t], x_imag[k, t] = R_real[count, k, t], R_imag[count, k, t]
                for j in range(k + 1, count):
                    for t in range(TILE):
                        x_real[k, t] -= x_real[j, t] * R_real[j, k, t] - x_imag[j, t] * R_imag[j, k, t]
                        x_imag[k, t] -= x_real[j, t] * R_imag[j, k, t] + x_imag[j, t] * R_real[j, k, t]
                for t in range(TILE):
                    x_real[k, t] /= R_real[k, k, t]
                    x_imag[k, t] /= R_real[k, k, t]
            for j in range(n):
                for t in range(m):
                    pull[row, j, first + t] = 0.0
            for k in range(1, count):
                for t in range(m):
                    pull[row, at[k], first + t] = complex(x_real[k, t], x_imag[k, t])
            for t in range(m):
                inputs[row, first + t] = complex(x_real[0, t], x_imag[0, t])
                pull[row, node, first + t] = -1.0
            for j in range(n):
                for t in range(TILE):
                    v_real[j, t] = -S_real[node, j, t] + (x_real[0, t] if j == node else 0.0)
                    v_imag[j, t] = -S_imag[node, j, t] + (x_imag[0, t] if j == node else 0.0)
                for k in range(1, count):
                    for t in range(TILE):
                        a, b, x, y = x_real[k, t], x_imag[k, t], S_real[at[k], j, t], S_imag[at[k], j, t]
                        v_real[j, t] += a * x - b * y
                        v_imag[j, t] += a * y + b * x
                for t in range(m):
                    misfit[row, j, first + t] = complex(v_real[j, t], v_imag[j, t])
    return True
