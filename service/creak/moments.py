"""Inner loops of the streaming sums, compiled: response matrices, residuals and their moments, line by line.

All arrays have the lines last, ``(..., matrix, F)``, so that neighbouring lines stand side by side in memory: the
loops work on tiles of lines whose real and imaginary parts are kept apart, which lets the processor take several
lines at once. Hermitian matrices are computed in their lower half and mirrored.
"""

import numpy as np

from creak.compiling import vectorised
from creak.records import Complex, Real

_TILE = 32  # lines that are worked on together


@vectorised
def responses(spectra: Complex, q: int, S: Complex, condition: Real) -> None:
    """``S = mean_p(Y) mean_p(U)^-1`` (28) of one realisation, by elimination with partial pivoting.

    Parameters
    ----------
    spectra : array, (q, P, q + n, F)
        Lines beyond those of `S` are passed over.
    q : int
    S : array, (n, q, F)
        Result; none of a line whose condition is infinite, that is whose input matrix is singular.
    condition : array, (F,)
        Result: upper bound of the condition number of the input matrix, ``2/|det A| (|A|_F/sqrt(q))^q`` (H. W.
        Guggenheimer, A. S. Edelman, C. R. Johnson, *College Mathematics J.* 26 (1995) 2); 2 for orthogonal
        experiments of equal power.
    """
    P, w = spectra.shape[1:3]
    n, _, F = S.shape
    mean = np.empty((q, w, _TILE), dtype=np.complex128)
    A = np.empty((q, q + n), dtype=np.complex128)  # a row an experiment: sum_i U_i S_ji = Y_j
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        for e in range(q):
            for i in range(w):
                for t in range(m):
                    total = spectra[e, 0, i, first + t]
                    for p in range(1, P):
                        total += spectra[e, p, i, first + t]
                    mean[e, i, t] = total / P
        for t in range(m):
            power = 0.0
            for e in range(q):
                for i in range(q + n):
                    A[e, i] = mean[e, i, t]
                for i in range(q):
                    power += A[e, i].real ** 2 + A[e, i].imag ** 2
            size = np.sqrt(power / q)
            bound = 2.0
            for k in range(q):
                row, largest = k, 0.0
                for e in range(k, q):
                    magnitude = abs(A[e, k].real) + abs(A[e, k].imag)
                    if not magnitude <= largest:
                        row, largest = e, magnitude
                pivot = A[row, k]
                if not largest > 0.0:
                    bound = np.inf
                    break
                bound *= size / np.hypot(pivot.real, pivot.imag)
                if row != k:
                    for i in range(k, q + n):
                        A[row, i], A[k, i] = A[k, i], A[row, i]
                scale = 1.0 / pivot
                for i in range(k + 1, q + n):
                    A[k, i] = A[k, i] * scale
                for e in range(k + 1, q):
                    factor = A[e, k]
                    for i in range(k + 1, q + n):
                        A[e, i] -= factor * A[k, i]
            condition[first + t] = bound
            if bound < np.inf:
                for k in range(q - 1, -1, -1):
                    for e in range(k):
                        factor = A[e, k]
                        for i in range(q, q + n):
                            A[e, i] -= factor * A[k, i]
                for i in range(n):
                    for j in range(q):
                        S[i, j, first + t] = A[j, q + i]


@vectorised
def line_powers(spectra: Complex, mean: Real, within: Real) -> None:
    """``sum_e |mean_p Y|^2`` and ``sum_e sum_p |Y - mean_p Y|^2`` of every channel and line.

    Parameters
    ----------
    spectra : array, (E, P, n, lines)
    mean, within : array, (n, lines)
        Results.
    """
    E, P, n, F = spectra.shape
    for i in range(n):
        for f in range(F):
            power, change = 0.0, 0.0
            for e in range(E):
                total = spectra[e, 0, i, f]
                for p in range(1, P):
                    total += spectra[e, p, i, f]
                total = total / P
                power += total.real * total.real + total.imag * total.imag
                for p in range(P):
                    off = spectra[e, p, i, f] - total
                    change += off.real * off.real + off.imag * off.imag
            mean[i, f] = power
            within[i, f] = change


@vectorised
def residual_moments(
    spectra: Complex, S: Complex, between: Complex, within: Complex, period_sums: Complex
) -> None:
    """Moments of ``V = [U; Y - S U]`` of one realisation, for any ``S``.

    Within an experiment mean and deviations follow B. P. Welford, *Technometrics* 4 (1962) 419: period k adds the
    deviation from the mean of the earlier ones, times ``sqrt(k/(k + 1))``, to what changes from period to period.

    Parameters
    ----------
    spectra : array, (q, P, q + n, F)
    S : array, (n, q, F)
    between, within : array, (q + n, q + n, F)
        Results, as :class:`creak.statistics.Sums` has them.
    period_sums : array, (P, q + n, F)
        Result.
    """
    E, P, w, F = spectra.shape
    n, q = S.shape[:2]
    apart, means, sums = E * (P - 1), E, P  # rows of V: deviations, means, sums of the periods
    real = np.zeros((apart + means + sums, w, _TILE))
    imag = np.zeros((apart + means + sums, w, _TILE))
    S_real, S_imag = np.zeros((n, q, _TILE)), np.zeros((n, q, _TILE))
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        real[apart + means :] = 0.0
        imag[apart + means :] = 0.0
        for e in range(E):
            for i in range(w):
                mean_real, mean_imag = real[apart + e, i], imag[apart + e, i]
                for p in range(P):
                    x = spectra[e, p, i]
                    sum_real, sum_imag = real[apart + means + p, i], imag[apart + means + p, i]
                    for t in range(m):
                        sum_real[t] += x[first + t].real
                        sum_imag[t] += x[first + t].imag
                    if p == 0:
                        for t in range(m):
                            mean_real[t] = x[first + t].real
                            mean_imag[t] = x[first + t].imag
                    else:
                        share, weight = 1.0 / (p + 1.0), np.sqrt(p / (p + 1.0))
                        off_real, off_imag = real[e * (P - 1) + p - 1, i], imag[e * (P - 1) + p - 1, i]
                        for t in range(m):
                            a = x[first + t].real - mean_real[t]
                            b = x[first + t].imag - mean_imag[t]
                            off_real[t] = weight * a
                            off_imag[t] = weight * b
                            mean_real[t] += share * a
                            mean_imag[t] += share * b
                root = np.sqrt(float(P))
                for t in range(m):
                    mean_real[t] *= root
                    mean_imag[t] *= root
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    S_real[i, j, t] = S[i, j, first + t].real
                    S_imag[i, j, t] = S[i, j, first + t].imag
        for row in range(apart + means + sums):
            for i in range(n):
                y_real, y_imag = real[row, q + i], imag[row, q + i]
                for j in range(q):
                    u_real, u_imag = real[row, j], imag[row, j]
                    s_real, s_imag = S_real[i, j], S_imag[i, j]
                    for t in range(_TILE):
                        y_real[t] -= s_real[t] * u_real[t] - s_imag[t] * u_imag[t]
                        y_imag[t] -= s_real[t] * u_imag[t] + s_imag[t] * u_real[t]
        _outer(real[:apart], imag[:apart], within, first, m)
        _outer(real[apart : apart + means], imag[apart : apart + means], between, first, m)
        for p in range(P):
            for i in range(w):
                for t in range(m):
                    period_sums[p, i, first + t] = complex(
                        real[apart + means + p, i, t], imag[apart + means + p, i, t]
                    )


@vectorised
def _outer(real: Real, imag: Real, moments: Complex, first: int, m: int) -> None:
    """Sum of ``v v^H`` over the rows of a tile, ``(rows, w, tile)``, into the moments from a line on."""
    rows, w = real.shape[:2]
    a, b = np.empty(_TILE), np.empty(_TILE)
    for i in range(w):
        for j in range(i + 1):
            for t in range(_TILE):
                a[t] = 0.0
                b[t] = 0.0
            for row in range(rows):
                x_real, x_imag, y_real, y_imag = real[row, i], imag[row, i], real[row, j], imag[row, j]
                for t in range(_TILE):
                    a[t] += x_real[t] * y_real[t] + x_imag[t] * y_imag[t]
                    b[t] += x_imag[t] * y_real[t] - x_real[t] * y_imag[t]
            if i == j:
                for t in range(m):
                    moments[i, i, first + t] = a[t]
            else:
                for t in range(m):
                    moments[i, j, first + t] = complex(a[t], b[t])
                    moments[j, i, first + t] = complex(a[t], -b[t])


@vectorised
def shear(moments: Complex, D: Complex, sheared: Complex) -> None:
    """``T A T^H`` with ``T = [I 0; D I]``: moments of ``[U; R + D U]`` from those of ``[U; R]``.

    Parameters
    ----------
    moments : array, (q + n, q + n, F)
        Hermitian; the lower half is read.
    D : array, (n, q, F)
    sheared : array, (q + n, q + n, F)
        Result.
    """
    n, q, F = D.shape
    w = n + q
    real, imag = np.zeros((w, w, _TILE)), np.zeros((w, w, _TILE))
    D_real, D_imag = np.zeros((n, q, _TILE)), np.zeros((n, q, _TILE))
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        for i in range(w):
            for j in range(i + 1):
                for t in range(m):
                    real[i, j, t] = moments[i, j, first + t].real
                    imag[i, j, t] = moments[i, j, first + t].imag
        for i in range(q):
            for j in range(i):
                for t in range(m):
                    real[j, i, t] = real[i, j, t]
                    imag[j, i, t] = -imag[i, j, t]
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    D_real[i, j, t] = D[i, j, first + t].real
                    D_imag[i, j, t] = D[i, j, first + t].imag
        for i in range(n):  # R R^H first needs the old R U^H: + D (U R^H)
            for j in range(i + 1):
                a, b = real[q + i, q + j], imag[q + i, q + j]
                for k in range(q):
                    x_real, x_imag, y_real, y_imag = D_real[i, k], D_imag[i, k], real[q + j, k], imag[q + j, k]
                    for t in range(_TILE):
                        a[t] += x_real[t] * y_real[t] + x_imag[t] * y_imag[t]
                        b[t] += x_imag[t] * y_real[t] - x_real[t] * y_imag[t]
        for i in range(n):  # R U^H + D U U^H
            for k in range(q):
                x_real, x_imag = D_real[i, k], D_imag[i, k]
                for j in range(q):
                    a, b, y_real, y_imag = real[q + i, j], imag[q + i, j], real[k, j], imag[k, j]
                    for t in range(_TILE):
                        a[t] += x_real[t] * y_real[t] - x_imag[t] * y_imag[t]
                        b[t] += x_real[t] * y_imag[t] + x_imag[t] * y_real[t]
        for i in range(n):  # and with the new one: + (R U^H) D^H
            for j in range(i + 1):
                a, b = real[q + i, q + j], imag[q + i, q + j]
                for k in range(q):
                    x_real, x_imag, y_real, y_imag = real[q + i, k], imag[q + i, k], D_real[j, k], D_imag[j, k]
                    for t in range(_TILE):
                        a[t] += x_real[t] * y_real[t] + x_imag[t] * y_imag[t]
                        b[t] += x_imag[t] * y_real[t] - x_real[t] * y_imag[t]
        for i in range(w):
            for j in range(i):
                for t in range(m):
                    sheared[i, j, first + t] = complex(real[i, j, t], imag[i, j, t])
                    sheared[j, i, first + t] = complex(real[i, j, t], -imag[i, j, t])
            for t in range(m):
                sheared[i, i, first + t] = real[i, i, t]


@vectorised
def shear_vectors(vectors: Complex, D: Complex, sheared: Complex) -> None:
    """``T v`` with ``T = [I 0; D I]`` for vectors ``(P, q + n, F)``; the result must not be the operand."""
    P, w, F = vectors.shape
    n, q = D.shape[:2]
    for p in range(P):
        for i in range(w):
            for f in range(F):
                sheared[p, i, f] = vectors[p, i, f]
        for i in range(n):
            for j in range(q):
                for f in range(F):
                    sheared[p, q + i, f] += D[i, j, f] * vectors[p, j, f]


@vectorised
def quadratic_forms(forms: Complex, moments: Complex, powers: Real) -> None:
    """``g A g^H`` per row and line.

    Parameters
    ----------
    forms : array, (rows, channels, F)
        g.
    moments : array, (channels, channels, F)
        A, Hermitian; the lower half is read.
    powers : array, (rows, F)
        Result.
    """
    rows, w, F = forms.shape
    real, imag = np.zeros((w, _TILE)), np.zeros((w, _TILE))
    A_real, A_imag = np.zeros((w, w, _TILE)), np.zeros((w, w, _TILE))
    total, a, b = np.zeros(_TILE), np.zeros(_TILE), np.zeros(_TILE)
    for first in range(0, F, _TILE):
        m = min(_TILE, F - first)
        for i in range(w):
            for j in range(i + 1):
                for t in range(m):
                    A_real[i, j, t] = moments[i, j, first + t].real
                    A_imag[i, j, t] = moments[i, j, first + t].imag
        for row in range(rows):
            for i in range(w):
                for t in range(m):
                    real[i, t] = forms[row, i, first + t].real
                    imag[i, t] = forms[row, i, first + t].imag
            for t in range(_TILE):
                total[t] = 0.0
            for i in range(w):  # |g_i|^2 A_ii + 2 Re conj(g_i) sum_(j < i) conj(A_ij) g_j
                for t in range(_TILE):
                    a[t] = 0.0
                    b[t] = 0.0
                for j in range(i):
                    x_real, x_imag, y_real, y_imag = real[j], imag[j], A_real[i, j], A_imag[i, j]
                    for t in range(_TILE):
                        a[t] += y_real[t] * x_real[t] + y_imag[t] * x_imag[t]
                        b[t] += y_real[t] * x_imag[t] - y_imag[t] * x_real[t]
                g_real, g_imag, own = real[i], imag[i], A_real[i, i]
                for t in range(_TILE):
                    power = g_real[t] * g_real[t] + g_imag[t] * g_imag[t]
                    total[t] += power * own[t] + 2.0 * (g_real[t] * a[t] + g_imag[t] * b[t])
            for t in range(m):
                powers[row, first + t] = total[t]
