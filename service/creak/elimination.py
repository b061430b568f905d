"""Gauss-Jordan elimination on a tile of lines at once, compiled; real and imaginary parts apart."""

from creak.compiling import part
from creak.hermitian import TILE
from creak.records import Real


@part
def eliminate(real: Real, imag: Real, pivots: Real, larger: Real, a: Real, b: Real) -> None:
    """Solve ``A X = B`` in the place of ``[A B]``, with partial pivoting in each line by itself.

    Parameters
    ----------
    real, imag : array, (n, w, TILE)
        ``[A B]``; afterwards X stands in the place of B, and nothing of use in that of A.
    pivots : array, (n, TILE)
        Result: squared moduli of the pivots, whose product is ``|det A|^2``; 0 or NaN where A is singular.
    larger, a, b : array, (TILE,)
        Room to work in.
    """
    n, w, _ = real.shape
    for k in range(n):
        for i in range(k + 1, n):  # the largest pivot of each line comes up row by row
            for t in range(TILE):
                here, there = abs(real[k, k, t]) + abs(imag[k, k, t]), abs(real[i, k, t]) + abs(imag[i, k, t])
                larger[t] = 1.0 if there > here else 0.0
            for j in range(k, w):
                for t in range(TILE):
                    x, y, z, v = real[k, j, t], real[i, j, t], imag[k, j, t], imag[i, j, t]
                    real[k, j, t] = y if larger[t] > 0.0 else x
                    real[i, j, t] = x if larger[t] > 0.0 else y
                    imag[k, j, t] = v if larger[t] > 0.0 else z
                    imag[i, j, t] = z if larger[t] > 0.0 else v
        for t in range(TILE):
            power = real[k, k, t] * real[k, k, t] + imag[k, k, t] * imag[k, k, t]
            pivots[k, t] = power
            a[t] = real[k, k, t] / power
            b[t] = -imag[k, k, t] / power
        for j in range(k + 1, w):
            for t in range(TILE):
                x, y = real[k, j, t], imag[k, j, t]
                real[k, j, t] = x * a[t] - y * b[t]
                imag[k, j, t] = x * b[t] + y * a[t]
        for i in range(n):
            if i != k:
                for j in range(k + 1, w):
                    for t in range(TILE):
                        x, y, z, v = real[i, k, t], imag[i, k, t], real[k, j, t], imag[k, j, t]
                        real[i, j, t] -= x * z - y * v
                        imag[i, j, t] -= x * v + y * z
