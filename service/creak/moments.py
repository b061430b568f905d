"""Inner loops of the streaming sums, compiled: response matrices, residuals and their moments, line by line.

All arrays have the lines last, ``(..., matrix, F)``, so that neighbouring lines stand side by side in memory: the
loops work on tiles of lines whose real and imaginary parts are kept apart, which lets the processor take several
lines at once. Hermitian matrices are packed as :mod:`creak.hermitian` has them.
"""

import numpy as np

from creak.compiling import compiled, part, vectorised
from creak.elimination import eliminate
from creak.hermitian import TILE
from creak.records import Complex, Real


@vectorised
def responses(spectra: Complex, q: int, S: Complex, condition: Real) -> None:
    """``S = mean_p(Y) mean_p(U)^-1`` (28) of one realisation, by elimination with partial pivoting.

    Parameters
    ----------
    spectra : array, (q, P, q + n, F)
        Lines beyond those of `S` are passed over.
    q : int
    S : array, (n, q, F)
        Result; without meaning at a line whose condition is infinite, that is whose input matrix is singular.
    condition : array, (F,)
        Result: upper bound of the condition number of the input matrix, ``2/|det A| (|A|_F/sqrt(q))^q`` (H. W.
        Guggenheimer, A. S. Edelman, C. R. Johnson, *College Mathematics J.* 26 (1995) 2); 2 for orthogonal
        experiments of equal power.
    """
    P = spectra.shape[1]
    n, _, F = S.shape
    w = q + n
    real, imag = np.zeros((q, w, TILE)), np.zeros((q, w, TILE))  # a row an experiment: sum_i U_i S_ji = Y_j
    size, bound, pivots = np.zeros(TILE), np.zeros(TILE), np.zeros((q, TILE))
    larger, a, b = np.zeros(TILE), np.zeros(TILE), np.zeros(TILE)
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        for e in range(q):
            for i in range(w):
                for t in range(m):
                    real[e, i, t] = spectra[e, 0, i, first + t].real
                    imag[e, i, t] = spectra[e, 0, i, first + t].imag
                for p in range(1, P):
                    for t in range(m):
                        real[e, i, t] += spectra[e, p, i, first + t].real
                        imag[e, i, t] += spectra[e, p, i, first + t].imag
                for t in range(m):
                    real[e, i, t] /= P
                    imag[e, i, t] /= P
        for t in range(m):
            size[t] = 0.0
            bound[t] = 2.0
        for e in range(q):
            for i in range(q):
                for t in range(m):
                    size[t] += real[e, i, t] * real[e, i, t] + imag[e, i, t] * imag[e, i, t]
        for t in range(m):
            size[t] = np.sqrt(size[t] / q)
        eliminate(real, imag, pivots, larger, a, b)
        for k in range(q):
            for t in range(m):
                bound[t] *= size[t] / np.sqrt(pivots[k, t])
        for t in range(m):
            condition[first + t] = bound[t] if bound[t] < np.inf else np.inf  # 0/0 at a line that is not driven
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    S[i, j, first + t] = complex(real[j, q + i, t], imag[j, q + i, t])


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


@part
def _product(real: Real, imag: Real, start: int, stop: int, i: int, j: int, a: Real, b: Real) -> None:
    """``sum v_i conj(v_j)`` over some rows of a tile, ``(rows, w, tile)``; three rows at a time spare stores."""
    for t in range(TILE):
        a[t] = 0.0
        b[t] = 0.0
    threes = stop - (stop - start) % 3
    for r in range(start, threes, 3):
        for t in range(TILE):
            a[t] += (
                (real[r, i, t] * real[r, j, t] + imag[r, i, t] * imag[r, j, t])
                + (real[r + 1, i, t] * real[r + 1, j, t] + imag[r + 1, i, t] * imag[r + 1, j, t])
                + (real[r + 2, i, t] * real[r + 2, j, t] + imag[r + 2, i, t] * imag[r + 2, j, t])
            )
            b[t] += (
                (imag[r, i, t] * real[r, j, t] - real[r, i, t] * imag[r, j, t])
                + (imag[r + 1, i, t] * real[r + 1, j, t] - real[r + 1, i, t] * imag[r + 1, j, t])
                + (imag[r + 2, i, t] * real[r + 2, j, t] - real[r + 2, i, t] * imag[r + 2, j, t])
            )
    for r in range(threes, stop):
        for t in range(TILE):
            a[t] += real[r, i, t] * real[r, j, t] + imag[r, i, t] * imag[r, j, t]
            b[t] += imag[r, i, t] * real[r, j, t] - real[r, i, t] * imag[r, j, t]


@part
def _store(a: Real, b: Real, i: int, j: int, packed: Real, first: int, m: int) -> None:
    """Entry ``a + jb`` of a row and column of packed moments, from a line on."""
    row = i * i + 2 * j
    for t in range(m):
        packed[row, first + t] = a[t]
    if j < i:
        for t in range(m):
            packed[row + 1, first + t] = b[t]


@vectorised
def residual_moments(spectra: Complex, S: Complex, between: Real, within: Real, period_sums: Complex) -> None:
    """Moments of ``V = [U; Y - S U]`` of one realisation, for any ``S``.

    Within an experiment mean and deviations follow B. P. Welford, *Technometrics* 4 (1962) 419: period k adds the
    deviation from the mean of the earlier ones, times ``sqrt(k/(k + 1))``, to what changes from period to period.

    Parameters
    ----------
    spectra : array, (q, P, q + n, F)
    S : array, (n, q, F)
    between, within : array, ((q + n)^2, F)
        Results, as :class:`creak.statistics.Sums` has them, packed.
    period_sums : array, (P, q + n, F)
        Result.
    """
    E, P, w, F = spectra.shape
    n, q = S.shape[:2]
    apart, means, sums = E * (P - 1), E, P  # rows of V: deviations, means, sums of the periods
    real = np.zeros((apart + means + sums, w, TILE))
    imag = np.zeros((apart + means + sums, w, TILE))
    S_real, S_imag = np.zeros((n, q, TILE)), np.zeros((n, q, TILE))
    a, b = np.zeros(TILE), np.zeros(TILE)
    root = np.sqrt(float(P))
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        real[apart + means :] = 0.0
        imag[apart + means :] = 0.0
        for e in range(E):
            for i in range(w):
                mean = apart + e
                for p in range(P):
                    total = apart + means + p
                    for t in range(m):
                        real[total, i, t] += spectra[e, p, i, first + t].real
                        imag[total, i, t] += spectra[e, p, i, first + t].imag
                    if p == 0:
                        for t in range(m):
                            real[mean, i, t] = spectra[e, p, i, first + t].real
                            imag[mean, i, t] = spectra[e, p, i, first + t].imag
                    else:
                        share, weight, off = 1.0 / (p + 1.0), np.sqrt(p / (p + 1.0)), e * (P - 1) + p - 1
                        for t in range(m):
                            x = spectra[e, p, i, first + t].real - real[mean, i, t]
                            y = spectra[e, p, i, first + t].imag - imag[mean, i, t]
                            real[off, i, t] = weight * x
                            imag[off, i, t] = weight * y
                            real[mean, i, t] += share * x
                            imag[mean, i, t] += share * y
                for t in range(m):
                    real[mean, i, t] *= root
                    imag[mean, i, t] *= root
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    S_real[i, j, t] = S[i, j, first + t].real
                    S_imag[i, j, t] = S[i, j, first + t].imag
        for row in range(apart + means + sums):
            for i in range(n):
                for j in range(q):
                    for t in range(TILE):
                        real[row, q + i, t] -= (
                            S_real[i, j, t] * real[row, j, t] - S_imag[i, j, t] * imag[row, j, t]
                        )
                        imag[row, q + i, t] -= (
                            S_real[i, j, t] * imag[row, j, t] + S_imag[i, j, t] * real[row, j, t]
                        )
        for i in range(w):
            for j in range(i + 1):
                _product(real, imag, 0, apart, i, j, a, b)
                _store(a, b, i, j, within, first, m)
                _product(real, imag, apart, apart + means, i, j, a, b)
                _store(a, b, i, j, between, first, m)
        for p in range(P):
            for i in range(w):
                for t in range(m):
                    period_sums[p, i, first + t] = complex(
                        real[apart + means + p, i, t], imag[apart + means + p, i, t]
                    )


@compiled  # fused products would not commute
def pool(
    S: Complex, spread: Real, M: float, other: Complex, other_spread: Real, N: float, mean: Complex, total: Real
) -> None:
    """Mean and summed squared deviations of M and N values together, all arrays ``(n, q, F)``.

    T. F. Chan, G. H. Golub, R. J. LeVeque, *American Statistician* 37 (1983) 242.

    Parameters
    ----------
    S, other : array
        Means.
    spread, other_spread : array
        Sums of squared deviations from them.
    M, N : float
    mean, total : array
        Results.
    """
    weight = M * N / (M + N)
    n, q, F = S.shape
    for i in range(n):
        for j in range(q):
            for f in range(F):
                apart = S[i, j, f] - other[i, j, f]
                mean[i, j, f] = complex(
                    (M * S[i, j, f].real + N * other[i, j, f].real) / (M + N),
                    (M * S[i, j, f].imag + N * other[i, j, f].imag) / (M + N),
                )
                power = apart.real * apart.real + apart.imag * apart.imag
                total[i, j, f] = spread[i, j, f] + other_spread[i, j, f] + weight * power
