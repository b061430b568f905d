"""Inner loops of the estimates, compiled: powers of residuals about any response matrix, line by line.

As in :mod:`creak.moments` the lines come last in memory, and loops work on tiles of lines whose real and imaginary
parts are kept apart. Moments are packed (:mod:`creak.hermitian`) and read once, and nothing of their size is
written: what an estimate needs of a line is worked out while its moments are at hand.
"""

import numpy as np

from creak.compiling import part, vectorised
from creak.hermitian import TILE, load, shear_tile
from creak.records import Complex, Real

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
    real, imag = np.zeros((w, w, TILE)), np.zeros((w, w, TILE))
    S_real, S_imag = np.zeros((n, q, TILE)), np.zeros((n, q, TILE))
    D_real, D_imag = np.zeros((n, q, TILE)), np.zeros((n, q, TILE))
    g_real, g_imag = np.zeros((n, w, TILE)), np.zeros((n, w, TILE))
    v_real, v_imag = np.zeros((w, TILE)), np.zeros((w, TILE))
    total, a, b = np.zeros(TILE), np.zeros(TILE), np.zeros(TILE)
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
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
            load(between if kind == 0 else within, q, first, m, real, imag)
            shear_tile(D_real, D_imag, real, imag)
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
                    for t in range(TILE):
                        v_real[q + i, t] += D_real[i, j, t] * v_real[j, t] - D_imag[i, j, t] * v_imag[j, t]
                        v_imag[q + i, t] += D_real[i, j, t] * v_imag[j, t] + D_imag[i, j, t] * v_real[j, t]
                for t in range(m):
                    powers[3, i, first + t] += v_real[q + i, t] ** 2 + v_imag[q + i, t] ** 2
            if networked:
                for i in range(n):
                    for t in range(TILE):
                        a[t] = 0.0
                        b[t] = 0.0
                    for j in range(start, w):
                        for t in range(TILE):
                            a[t] += g_real[i, j, t] * v_real[j, t] - g_imag[i, j, t] * v_imag[j, t]
                            b[t] += g_real[i, j, t] * v_imag[j, t] + g_imag[i, j, t] * v_real[j, t]
                    for t in range(m):
                        powers[6, i, first + t] += a[t] * a[t] + b[t] * b[t]


@part
def _moved(x_real: Real, x_imag: Real, real: Real, imag: Real, row: int, total: Real, a: Real, b: Real) -> None:
    """Power of ``R_i + x U``, ``(q, tile)``, from the moments of ``[U; R]``; `row` is that of ``R_i``."""
    for t in range(TILE):
        total[t] = real[row, row, t]
    for j in range(len(x_real)):  # |x_j|^2 A_jj + 2 Re conj(x_j) (A_rj + sum_(k < j) conj(A_jk) x_k)
        for t in range(TILE):
            a[t] = real[row, j, t]
            b[t] = imag[row, j, t]
        for k in range(j):
            for t in range(TILE):
                a[t] += real[j, k, t] * x_real[k, t] + imag[j, k, t] * x_imag[k, t]
                b[t] += real[j, k, t] * x_imag[k, t] - imag[j, k, t] * x_real[k, t]
        for t in range(TILE):
            power = x_real[j, t] * x_real[j, t] + x_imag[j, t] * x_imag[j, t]
            total[t] += power * real[j, j, t] + 2.0 * (x_real[j, t] * a[t] + x_imag[j, t] * b[t])


@part
def _form(g_real: Real, g_imag: Real, start: int, real: Real, imag: Real, total: Real, a: Real, b: Real) -> None:
    """``g A g^H`` of a row ``(q + n, tile)`` that begins at channel `start`."""
    for t in range(TILE):
        total[t] = 0.0
    for i in range(start, len(g_real)):  # |g_i|^2 A_ii + 2 Re conj(g_i) sum_(j < i) conj(A_ij) g_j
        for t in range(TILE):
            a[t] = 0.0
            b[t] = 0.0
        for j in range(start, i):
            for t in range(TILE):
                a[t] += real[i, j, t] * g_real[j, t] + imag[i, j, t] * g_imag[j, t]
                b[t] += real[i, j, t] * g_imag[j, t] - imag[i, j, t] * g_real[j, t]
        for t in range(TILE):
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
    real, imag = np.zeros((w, w, TILE)), np.zeros((w, w, TILE))
    L_real, L_imag = np.zeros((q, q, TILE)), np.zeros((q, q, TILE))
    d = np.ones((q, TILE))
    D_real, D_imag = np.zeros((n, q, TILE)), np.zeros((n, q, TILE))
    K_real, K_imag = np.zeros((n, q, TILE)), np.zeros((n, q, TILE))
    total, a, b = np.zeros(TILE), np.zeros(TILE), np.zeros(TILE)
    plain[:] = 0.0
    least[:] = 0.0
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    x = about[i, j, first + t] - S[i, j, first + t]
                    D_real[i, j, t], D_imag[i, j, t] = x.real, x.imag
        load(between, q, first, m, real, imag)
        if not decompose(q, m, real, imag, L_real, L_imag, d):
            return False
        for i in range(n):
            _minus_divided(real[q + i], imag[q + i], L_real, L_imag, d, K_real[i], K_imag[i])
        for kind in range(2):
            if kind == 1:
                load(within, q, first, m, real, imag)
            for i in range(n):
                _moved(D_real[i], D_imag[i], real, imag, q + i, total, a, b)
                for t in range(m):
                    plain[i] += total[t]
                _moved(K_real[i], K_imag[i], real, imag, q + i, total, a, b)
                for t in range(m):
                    least[i] += total[t]
    return True


@part
def decompose(q: int, m: int, real: Real, imag: Real, L_real: Real, L_imag: Real, d: Real) -> bool:
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


@part
def _minus_divided(
    row_real: Real, row_imag: Real, L_real: Real, L_imag: Real, d: Real, K_real: Real, K_imag: Real
) -> None:
    """``-b A^-1`` of a row ``(q, tile)``: forwards ``z L^H = b``, ``z / D``, backwards ``k L = z``."""
    q = len(K_real)
    for j in range(q):
        for t in range(TILE):
            K_real[j, t] = -row_real[j, t]
            K_imag[j, t] = -row_imag[j, t]
        for k in range(j):
            for t in range(TILE):
                K_real[j, t] -= K_real[k, t] * L_real[j, k, t] + K_imag[k, t] * L_imag[j, k, t]
                K_imag[j, t] -= K_imag[k, t] * L_real[j, k, t] - K_real[k, t] * L_imag[j, k, t]
    for j in range(q):
        for t in range(TILE):
            K_real[j, t] /= d[j, t]
            K_imag[j, t] /= d[j, t]
    for j in range(q - 1, -1, -1):
        for k in range(j + 1, q):
            for t in range(TILE):
                K_real[j, t] -= K_real[k, t] * L_real[k, j, t] - K_imag[k, t] * L_imag[k, j, t]
                K_imag[j, t] -= K_real[k, t] * L_imag[k, j, t] + K_imag[k, t] * L_real[k, j, t]
