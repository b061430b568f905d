"""Inner loops of the estimates, compiled: powers of residuals about any response matrix, line by line.

As in :mod:`creak.moments` the lines come last in memory, and loops work on tiles of lines whose real and imaginary
parts are kept apart. Moments are packed (:mod:`creak.hermitian`) and read once, and nothing of their size is
written: what an estimate needs of a line is worked out while its moments are at hand.
"""

import numpy as np
from numpy.typing import NDArray

from creak.compiling import vectorised
from creak.records import Complex, Real

_TILE = 64  # lines that are worked on together

_DEPENDENT = 1e-15  # part of a row that is left of it beside others, below which it is rounding

POWERS = 7
"""Powers that :func:`residual_powers` gives, in its order."""


@vectorised
def residual_powers(
    between: Real,
    within: Real,
    period_sums: Complex,
    S: Complex,
    about: Complex,
    misfit: Complex,
    pull: Complex,
    powers: Real,
) -> None:
    """Powers of responses, of residuals ``R = Y - S U`` and of networked residuals ``e = misfit U + pull R``.

    Parameters
    ----------
    between, within : array, ((q + n)^2, F)
        Moments of ``[U; Y - about U]`` as :class:`creak.statistics.Sums` has them, packed.
    period_sums : array, (P, q + n, F)
    S, about : array, (n, q, F)
    misfit : array, (n, n, F) or (0, 0, 0)
        Nothing where it vanishes.
    pull : array, (n, n, F) or (0, 0, 0)
        Nothing if networked residuals are not wanted.
    powers : array, (7, n, F)
        Result: ``|Y|^2``, between and within together; of the residuals between, within, and ``|sum_e R|^2``
        summed over periods; the same three of the networked residuals, if wanted.
    """
    P, w, F = period_sums.shape
    n, q = S.shape[:2]
    networked = len(pull) > 0
    start = 0 if len(misfit) > 0 else q
    real, imag = np.zeros((w, w, _TILE)), np.zeros((w, w, _TILE))
    S_real, S_imag = np.zeros((n, q, _TILE)), np.zeros((n, q, _TILE))
    D_real, D_imag = np.zeros((n, q, _TILE)), np.zeros((n, q, _TILE))
    g_real, g_imag = np.zeros((n, w, _TILE)), np.zeros((n, w, _TILE))
    v_real, v_imag = np.zeros((w, _TILE)), np.zeros((w, _TILE))
    total, a, b = np.zeros(_TILE), np.zeros(_TILE), np.zeros(_TILE)
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    s = S[i, j, first + t]
                    d = about[i, j, first + t] - s
                    S_real[i, j, t], S_imag[i, j, t] = s.real, s.imag
                    D_real[i, j, t], D_imag[i, j, t] = d.real, d.imag
        if networked:
            for i in range(n):
                for j in range(n):
                    for t in range(m):
                        g_real[i, q + j, t] = pull[i, j, first + t].real
                        g_imag[i, q + j, t] = pull[i, j, first + t].imag
                for j in range(q - start):
                    for t in range(m):
                        g_real[i, j, t] = misfit[i, j, first + t].real
                        g_imag[i, j, t] = misfit[i, j, first + t].imag
        for kind in range(2):
            _load(between if kind == 0 else within, q, first, m, real, imag)
            _shear(D_real, D_imag, real, imag)
            for i in range(n):
                _moved(S_real[i], S_imag[i], real, imag, q + i, total, a, b)
                if kind == 0:
                    for t in range(m):
                        powers[0, i, first + t] = total[t]
                else:
                    for t in range(m):
                        powers[0, i, first + t] += total[t]
                for t in range(m):
                    powers[1 + kind, i, first + t] = real[q + i, q + i, t]
                if networked:
                    _form(g_real[i], g_imag[i], start, real, imag, total, a, b)
                    for t in range(m):
                        powers[4 + kind, i, first + t] = total[t]
        for i in range(n):
            for t in range(m):
                powers[3, i, first + t] = 0.0
                powers[6, i, first + t] = 0.0
        for p in range(P):
            for i in range(w):
                for t in range(m):
                    v_real[i, t] = period_sums[p, i, first + t].real
                    v_imag[i, t] = period_sums[p, i, first + t].imag
            for i in range(n):
                for j in range(q):
                    for t in range(_TILE):
                        v_real[q + i, t] += D_real[i, j, t] * v_real[j, t] - D_imag[i, j, t] * v_imag[j, t]
                        v_imag[q + i, t] += D_real[i, j, t] * v_imag[j, t] + D_imag[i, j, t] * v_real[j, t]
                for t in range(m):
                    powers[3, i, first + t] += v_real[q + i, t] ** 2 + v_imag[q + i, t] ** 2
            if networked:
                for i in range(n):
                    for t in range(_TILE):
                        a[t] = 0.0
                        b[t] = 0.0
                    for j in range(start, w):
                        for t in range(_TILE):
                            a[t] += g_real[i, j, t] * v_real[j, t] - g_imag[i, j, t] * v_imag[j, t]
                            b[t] += g_real[i, j, t] * v_imag[j, t] + g_imag[i, j, t] * v_real[j, t]
                    for t in range(m):
                        powers[6, i, first + t] += a[t] * a[t] + b[t] * b[t]


@vectorised
def _load(packed: Real, q: int, first: int, m: int, real: Real, imag: Real) -> None:
    """Lower half of a tile of moments, and the upper half of the inputs'."""
    for i in range(len(real)):
        for j in range(i):
            row = i * i + 2 * j
            for t in range(m):
                real[i, j, t] = packed[row, first + t]
                imag[i, j, t] = packed[row + 1, first + t]
        for t in range(m):
            real[i, i, t] = packed[i * i + 2 * i, first + t]
    for i in range(q):
        for j in range(i):
            for t in range(m):
                real[j, i, t] = real[i, j, t]
                imag[j, i, t] = -imag[i, j, t]


@vectorised
def _shear(D_real: Real, D_imag: Real, real: Real, imag: Real) -> None:
    """Moments of ``[U; R + D U]`` in the place of those of ``[U; R]``, one tile, in the lower half."""
    n, q = D_real.shape[:2]
    for i in range(n):  # R R^H first needs the old R U^H: + D (U R^H)
        for j in range(i + 1):
            for k in range(q):
                for t in range(_TILE):
                    a, b, c, d = D_real[i, k, t], D_imag[i, k, t], real[q + j, k, t], imag[q + j, k, t]
                    real[q + i, q + j, t] += a * c + b * d
                    imag[q + i, q + j, t] += b * c - a * d
    for i in range(n):  # R U^H + D U U^H
        for j in range(q):
            for k in range(q):
                for t in range(_TILE):
                    a, b, c, d = D_real[i, k, t], D_imag[i, k, t], real[k, j, t], imag[k, j, t]
                    real[q + i, j, t] += a * c - b * d
                    imag[q + i, j, t] += a * d + b * c
    for i in range(n):  # and with the new one: + (R U^H) D^H
        for j in range(i + 1):
            for k in range(q):
                for t in range(_TILE):
                    a, b, c, d = real[q + i, k, t], imag[q + i, k, t], D_real[j, k, t], D_imag[j, k, t]
                    real[q + i, q + j, t] += a * c + b * d
                    imag[q + i, q + j, t] += b * c - a * d


@vectorised
def _moved(x_real: Real, x_imag: Real, real: Real, imag: Real, row: int, total: Real, a: Real, b: Real) -> None:
    """Power of ``R_i + x U``, ``(q, tile)``, from the moments of ``[U; R]``; `row` is that of ``R_i``."""
    for t in range(_TILE):
        total[t] = real[row, row, t]
    for j in range(len(x_real)):  # |x_j|^2 A_jj + 2 Re conj(x_j) (A_rj + sum_(k < j) conj(A_jk) x_k)
        for t in range(_TILE):
            a[t] = real[row, j, t]
            b[t] = imag[row, j, t]
        for k in range(j):
            for t in range(_TILE):
                a[t] += real[j, k, t] * x_real[k, t] + imag[j, k, t] * x_imag[k, t]
                b[t] += real[j, k, t] * x_imag[k, t] - imag[j, k, t] * x_real[k, t]
        for t in range(_TILE):
            power = x_real[j, t] * x_real[j, t] + x_imag[j, t] * x_imag[j, t]
            total[t] += power * real[j, j, t] + 2.0 * (x_real[j, t] * a[t] + x_imag[j, t] * b[t])


@vectorised
def _form(g_real: Real, g_imag: Real, start: int, real: Real, imag: Real, total: Real, a: Real, b: Real) -> None:
    """``g A g^H`` of a row ``(q + n, tile)`` that begins at channel `start`."""
    for t in range(_TILE):
        total[t] = 0.0
    for i in range(start, len(g_real)):  # |g_i|^2 A_ii + 2 Re conj(g_i) sum_(j < i) conj(A_ij) g_j
        for t in range(_TILE):
            a[t] = 0.0
            b[t] = 0.0
        for j in range(start, i):
            for t in range(_TILE):
                a[t] += real[i, j, t] * g_real[j, t] + imag[i, j, t] * g_imag[j, t]
                b[t] += real[i, j, t] * g_imag[j, t] - imag[i, j, t] * g_real[j, t]
        for t in range(_TILE):
            power = g_real[i, t] * g_real[i, t] + g_imag[i, t] * g_imag[i, t]
            total[t] += power * real[i, i, t] + 2.0 * (g_real[i, t] * a[t] + g_imag[i, t] * b[t])


@vectorised
def least_squares_powers(
    between: Real, within: Real, S: Complex, about: Complex, plain: Real, least: Real
) -> bool:
    """Power of the residuals about ``S`` and about the least-squares approximation, over all lines.

    The latter lies ``K = sum R U^H (sum U U^H)^-1`` of the period means away from `about`; by ``L D L^H`` of the
    inputs' moments.

    Parameters
    ----------
    between, within : array, ((q + n)^2, F)
        Moments of ``[U; Y - about U]``, packed.
    S, about : array, (n, q, F)
    plain, least : array, (n,)
        Results.

    Returns
    -------
    bool
        False if the inputs of a line do not span all directions; nothing then is known.
    """
    n, q, F = S.shape
    w = n + q
    real, imag = np.zeros((w, w, _TILE)), np.zeros((w, w, _TILE))
    L_real, L_imag = np.zeros((q, q, _TILE)), np.zeros((q, q, _TILE))
    d = np.ones((q, _TILE))
    D_real, D_imag = np.zeros((n, q, _TILE)), np.zeros((n, q, _TILE))
    K_real, K_imag = np.zeros((n, q, _TILE)), np.zeros((n, q, _TILE))
    total, a, b = np.zeros(_TILE), np.zeros(_TILE), np.zeros(_TILE)
    plain[:] = 0.0
    least[:] = 0.0
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    x = about[i, j, first + t] - S[i, j, first + t]
                    D_real[i, j, t], D_imag[i, j, t] = x.real, x.imag
        _load(between, q, first, m, real, imag)
        if not _decompose(q, m, real, imag, L_real, L_imag, d):
            return False
        for i in range(n):
            _minus_divided(real[q + i], imag[q + i], L_real, L_imag, d, K_real[i], K_imag[i])
        for kind in range(2):
            if kind == 1:
                _load(within, q, first, m, real, imag)
            for i in range(n):
                _moved(D_real[i], D_imag[i], real, imag, q + i, total, a, b)
                for t in range(m):
                    plain[i] += total[t]
                _moved(K_real[i], K_imag[i], real, imag, q + i, total, a, b)
                for t in range(m):
                    least[i] += total[t]
    return True


@vectorised
def _decompose(q: int, m: int, real: Real, imag: Real, L_real: Real, L_imag: Real, d: Real) -> bool:
    """``A = L D L^H`` of the first q rows of a tile, `L` of unit diagonal; False if `D` is not above 0."""
    for j in range(q):
        for i in range(j, q):
            for t in range(m):
                L_real[i, j, t] = real[i, j, t]
                L_imag[i, j, t] = imag[i, j, t]
            for k in range(j):
                for t in range(m):
                    a, b = d[k, t] * L_real[j, k, t], d[k, t] * L_imag[j, k, t]
                    L_real[i, j, t] -= L_real[i, k, t] * a + L_imag[i, k, t] * b
                    L_imag[i, j, t] -= L_imag[i, k, t] * a - L_real[i, k, t] * b
            if i == j:
                for t in range(m):
                    d[j, t] = L_real[j, j, t]
                    if not d[j, t] > 0.0:
                        return False
            else:
                for t in range(m):
                    L_real[i, j, t] /= d[j, t]
                    L_imag[i, j, t] /= d[j, t]
    return True


@vectorised
def _minus_divided(
    row_real: Real, row_imag: Real, L_real: Real, L_imag: Real, d: Real, K_real: Real, K_imag: Real
) -> None:
    """``-b A^-1`` of a row ``(q, tile)``: forwards ``z L^H = b``, ``z / D``, backwards ``k L = z``."""
    q = len(K_real)
    for j in range(q):
        for t in range(_TILE):
            K_real[j, t] = -row_real[j, t]
            K_imag[j, t] = -row_imag[j, t]
        for k in range(j):
            for t in range(_TILE):
                K_real[j, t] -= K_real[k, t] * L_real[j, k, t] + K_imag[k, t] * L_imag[j, k, t]
                K_imag[j, t] -= K_imag[k, t] * L_real[j, k, t] - K_real[k, t] * L_imag[j, k, t]
    for j in range(q):
        for t in range(_TILE):
            K_real[j, t] /= d[j, t]
            K_imag[j, t] /= d[j, t]
    for j in range(q - 1, -1, -1):
        for k in range(j + 1, q):
            for t in range(_TILE):
                K_real[j, t] -= K_real[k, t] * L_real[k, j, t] - K_imag[k, t] * L_imag[k, j, t]
                K_imag[j, t] -= K_real[k, t] * L_imag[k, j, t] + K_imag[k, t] * L_real[k, j, t]


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
    real, imag = np.zeros((n, w, _TILE)), np.zeros((n, w, _TILE))  # S beside the unit matrix
    larger, a, b = np.zeros(_TILE), np.zeros(_TILE), np.zeros(_TILE)
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        for i in range(n):
            for j in range(n):
                for t in range(m):
                    real[i, j, t] = S[i, j, first + t].real
                    imag[i, j, t] = S[i, j, first + t].imag
                for t in range(_TILE):
                    real[i, n + j, t] = 1.0 if i == j else 0.0
                    imag[i, n + j, t] = 0.0
        for k in range(n):
            for i in range(k + 1, n):  # the largest pivot of each line comes up row by row
                for t in range(_TILE):
                    here, there = abs(real[k, k, t]) + abs(imag[k, k, t]), abs(real[i, k, t]) + abs(imag[i, k, t])
                    larger[t] = 1.0 if there > here else 0.0
                for j in range(k, w):
                    for t in range(_TILE):
                        x, y, z, v = real[k, j, t], real[i, j, t], imag[k, j, t], imag[i, j, t]
                        real[k, j, t] = y if larger[t] > 0.0 else x
                        real[i, j, t] = x if larger[t] > 0.0 else y
                        imag[k, j, t] = v if larger[t] > 0.0 else z
                        imag[i, j, t] = z if larger[t] > 0.0 else v
            for t in range(m):
                power = real[k, k, t] * real[k, k, t] + imag[k, k, t] * imag[k, k, t]
                if not power > 0.0:
                    return False
                a[t] = real[k, k, t] / power
                b[t] = -imag[k, k, t] / power
            for j in range(k + 1, w):
                for t in range(_TILE):
                    x, y = real[k, j, t], imag[k, j, t]
                    real[k, j, t] = x * a[t] - y * b[t]
                    imag[k, j, t] = x * b[t] + y * a[t]
            for i in range(n):
                if i != k:
                    for j in range(k + 1, w):
                        for t in range(_TILE):
                            x, y, z, v = real[i, k, t], imag[i, k, t], real[k, j, t], imag[k, j, t]
                            real[i, j, t] -= x * z - y * v
                            imag[i, j, t] -= x * v + y * z
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


@vectorised
def _size(v_real: Real, v_imag: Real, size: Real) -> None:
    """Lengths of the vectors of a tile, ``(n, tile)``."""
    for t in range(_TILE):
        size[t] = 0.0
    for i in range(len(v_real)):
        for t in range(_TILE):
            size[t] += v_real[i, t] * v_real[i, t] + v_imag[i, t] * v_imag[i, t]
    for t in range(_TILE):
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
    real, imag = np.zeros((n, n, _TILE)), np.zeros((n, n, _TILE))
    L_real, L_imag, d = np.zeros((n, n, _TILE)), np.zeros((n, n, _TILE)), np.ones((n, _TILE))
    S_real, S_imag = np.zeros((n, n, _TILE)), np.zeros((n, n, _TILE))
    Y_real, Y_imag = np.zeros((n, n, _TILE)), np.zeros((n, n, _TILE))
    Q_real, Q_imag = np.zeros((n, n, _TILE)), np.zeros((n, n, _TILE))
    R_real, R_imag = np.zeros((n + 1, n, _TILE)), np.zeros((n + 1, n, _TILE))
    x_real, x_imag = np.zeros((n, _TILE)), np.zeros((n, _TILE))
    v_real, v_imag = np.zeros((n, _TILE)), np.zeros((n, _TILE))
    before, after = np.zeros(_TILE), np.zeros(_TILE)
    at = np.zeros(n + 1, dtype=np.intp)
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        _load(between, n, first, m, real, imag)
        if not _decompose(n, m, real, imag, L_real, L_imag, d):
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
                for t in range(_TILE):
                    Y_real[i, j, t], Y_imag[i, j, t] = 0.0, 0.0
                for k in range(j, n):
                    for t in range(_TILE):
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
                    for t in range(_TILE):
                        v_real[j, t] = Y_real[at[k], j, t] if k > 0 else L_real[node, j, t]
                        v_imag[j, t] = Y_imag[at[k], j, t] if k > 0 else L_imag[node, j, t]
                _size(v_real, v_imag, before)
                for j in range(k):
                    for t in range(_TILE):
                        R_real[k, j, t], R_imag[k, j, t] = 0.0, 0.0
                    for i in range(n):
                        for t in range(_TILE):
                            a, b, x, y = v_real[i, t], v_imag[i, t], Q_real[j, i, t], Q_imag[j, i, t]
                            R_real[k, j, t] += a * x + b * y
                            R_imag[k, j, t] += b * x - a * y
                    for i in range(n):
                        for t in range(_TILE):
                            a, b, x, y = R_real[k, j, t], R_imag[k, j, t], Q_real[j, i, t], Q_imag[j, i, t]
                            v_real[i, t] -= a * x - b * y
                            v_imag[i, t] -= a * y + b * x
                if k < count:
                    _size(v_real, v_imag, after)
                    for t in range(m):
                        if not before[t] > 0.0:
                            return False
                    for t in range(_TILE):
                        left = after[t] > _DEPENDENT * before[t]
                        R_real[k, k, t] = after[t] if left else 1.0
                        before[t] = 1.0 / after[t] if left else 0.0
                    for i in range(n):
                        for t in range(_TILE):
                            Q_real[k, i, t] = v_real[i, t] * before[t]
                            Q_imag[k, i, t] = v_imag[i, t] * before[t]
            for k in range(count - 1, -1, -1):  # x R = right-hand side
                for t in range(_TILE):
                    x_real[k, t], x_imag[k, t] = R_real[count, k, t], R_imag[count, k, t]
                for j in range(k + 1, count):
                    for t in range(_TILE):
                        x_real[k, t] -= x_real[j, t] * R_real[j, k, t] - x_imag[j, t] * R_imag[j, k, t]
                        x_imag[k, t] -= x_real[j, t] * R_imag[j, k, t] + x_imag[j, t] * R_real[j, k, t]
                for t in range(_TILE):
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
                for t in range(_TILE):
                    v_real[j, t] = -S_real[node, j, t] + (x_real[0, t] if j == node else 0.0)
                    v_imag[j, t] = -S_imag[node, j, t] + (x_imag[0, t] if j == node else 0.0)
                for k in range(1, count):
                    for t in range(_TILE):
                        a, b, x, y = x_real[k, t], x_imag[k, t], S_real[at[k], j, t], S_imag[at[k], j, t]
                        v_real[j, t] += a * x - b * y
                        v_imag[j, t] += a * y + b * x
                for t in range(m):
                    misfit[row, j, first + t] = complex(v_real[j, t], v_imag[j, t])
    return True


def lines_last(matrices: Complex) -> Complex:
    """``(F, rows, columns)`` as these loops take them, ``(rows, columns, F)``."""
    return np.ascontiguousarray(matrices.transpose(1, 2, 0))
