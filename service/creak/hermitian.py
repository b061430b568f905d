"""Hermitian matrices of moments, line by line, packed: half the memory, and compiled loops over it.

A packed matrix of w rows takes w^2 rows of real numbers, lines last, ``(w^2, F)``: the lower half row by row, of
each row the real and imaginary parts of the entries left of the diagonal, then the diagonal entry, which is real.
So entry (i, j) begins at row ``i^2 + 2j``, and the first k^2 rows are the leading k by k matrix.
"""

from typing import TypeVar

import numpy as np

from creak.compiling import part, vectorised
from creak.records import Complex, Real

TILE = 64
"""Lines that are worked on together."""

_Array = TypeVar("_Array", Complex, Real)


def lines_last(matrices: _Array) -> _Array:
    """``(F, rows, columns)`` as the compiled loops take them, ``(rows, columns, F)``."""
    return np.ascontiguousarray(matrices.transpose(1, 2, 0))


@vectorised
def unpack(packed: Real, matrices: Complex) -> None:
    """Both halves as complex numbers, ``(w^2, F)`` to ``(w, w, F)``."""
    w, F = len(matrices), packed.shape[1]
    for i in range(w):
        for j in range(i):
            row = i * i + 2 * j
            for f in range(F):
                matrices[i, j, f] = complex(packed[row, f], packed[row + 1, f])
                matrices[j, i, f] = complex(packed[row, f], -packed[row + 1, f])
        for f in range(F):
            matrices[i, i, f] = packed[i * i + 2 * i, f]


@part
def load(packed: Real, q: int, first: int, m: int, real: Real, imag: Real) -> None:
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


@part
def shear_tile(D_real: Real, D_imag: Real, real: Real, imag: Real) -> None:
    """Moments of ``[U; R + D U]`` in the place of those of ``[U; R]``, one tile, in the lower half."""
    n, q = D_real.shape[:2]
    for i in range(n):  # R R^H first needs the old R U^H: + D (U R^H)
        for j in range(i + 1):
            for k in range(q):
                for t in range(TILE):
                    a, b, c, d = D_real[i, k, t], D_imag[i, k, t], real[q + j, k, t], imag[q + j, k, t]
                    real[q + i, q + j, t] += a * c + b * d
                    imag[q + i, q + j, t] += b * c - a * d
    for i in range(n):  # R U^H + D U U^H
        for j in range(q):
            for k in range(q):
                for t in range(TILE):
                    a, b, c, d = D_real[i, k, t], D_imag[i, k, t], real[k, j, t], imag[k, j, t]
                    real[q + i, j, t] += a * c - b * d
                    imag[q + i, j, t] += a * d + b * c
    for i in range(n):  # and with the new one: + (R U^H) D^H
        for j in range(i + 1):
            for k in range(q):
                for t in range(TILE):
                    a, b, c, d = real[q + i, k, t], imag[q + i, k, t], D_real[j, k, t], D_imag[j, k, t]
                    real[q + i, q + j, t] += a * c + b * d
                    imag[q + i, q + j, t] += b * c - a * d


@vectorised
def shear(packed: Real, D: Complex, sheared: Real) -> None:
    """``T A T^H`` with ``T = [I 0; D I]``: moments of ``[U; R + D U]`` from those of ``[U; R]``.

    Parameters
    ----------
    packed : array, ((q + n)^2, F)
    D : array, (n, q, F)
    sheared : array, ((q + n)^2, F)
        Result.
    """
    n, q, F = D.shape
    w = n + q
    real, imag = np.zeros((w, w, TILE)), np.zeros((w, w, TILE))
    D_real, D_imag = np.zeros((n, q, TILE)), np.zeros((n, q, TILE))
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        load(packed, q, first, m, real, imag)
        for i in range(n):
            for j in range(q):
                for t in range(m):
                    D_real[i, j, t] = D[i, j, first + t].real
                    D_imag[i, j, t] = D[i, j, first + t].imag
        shear_tile(D_real, D_imag, real, imag)
        for i in range(w):
            for j in range(i):
                row = i * i + 2 * j
                for t in range(m):
                    sheared[row, first + t] = real[i, j, t]
                    sheared[row + 1, first + t] = imag[i, j, t]
            for t in range(m):
                sheared[i * i + 2 * i, first + t] = real[i, i, t]


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
def quadratic_forms(forms: Complex, packed: Real, powers: Real) -> None:
    """``g A g^H`` per row and line.

    Parameters
    ----------
    forms : array, (rows, w, F)
        g.
    packed : array, (w^2, F)
        A.
    powers : array, (rows, F)
        Result.
    """
    rows, w, F = forms.shape
    real, imag = np.zeros((w, TILE)), np.zeros((w, TILE))
    total, a, b = np.zeros(TILE), np.zeros(TILE), np.zeros(TILE)
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        for row in range(rows):
            for i in range(w):
                for t in range(m):
                    real[i, t] = forms[row, i, first + t].real
                    imag[i, t] = forms[row, i, first + t].imag
            for t in range(TILE):
                total[t] = 0.0
            for i in range(w):  # |g_i|^2 A_ii + 2 Re conj(g_i) sum_(j < i) conj(A_ij) g_j
                for t in range(TILE):
                    a[t] = 0.0
                    b[t] = 0.0
                for j in range(i):
                    at = i * i + 2 * j
                    for t in range(m):
                        x, y = packed[at, first + t], packed[at + 1, first + t]
                        a[t] += x * real[j, t] + y * imag[j, t]
                        b[t] += x * imag[j, t] - y * real[j, t]
                own = i * i + 2 * i
                for t in range(m):
                    power = real[i, t] * real[i, t] + imag[i, t] * imag[i, t]
                    total[t] += power * packed[own, first + t] + 2.0 * (real[i, t] * a[t] + imag[i, t] * b[t])
            for t in range(m):
                powers[row, first + t] = total[t]
