"""Inner loops of the checks over the spectra of a realisation, compiled; lines last as in :mod:`creak.moments`."""

import numpy as np

from creak.compiling import vectorised
from creak.hermitian import TILE
from creak.records import Complex, Real


@vectorised
def period_changes(spectra: Complex, power: Real, moved: Real, cross: Complex) -> None:
    """Powers of all periods and of the changes from one to the next, and how those agree in phase.

    Parameters
    ----------
    spectra : array, (q, P, channels, F)
        Periods in their order.
    power, moved : array, (channels,)
        Results: ``sum |X_p|^2``, ``sum |X_(p+1) - X_p|^2``.
    cross : array, (channels, F)
        Result: ``sum X_(p+1) conj(X_p)``, over experiments and periods.
    """
    q, P, w, F = spectra.shape
    a, b, size, change = np.empty(TILE), np.empty(TILE), np.empty(TILE), np.empty(TILE)
    for i in range(w):
        power[i], moved[i] = 0.0, 0.0
        for first in range(0, F, TILE):
            m = min(TILE, F - first)
            for t in range(m):
                a[t], b[t], size[t], change[t] = 0.0, 0.0, 0.0, 0.0
            for e in range(q):
                for p in range(P):
                    for t in range(m):
                        x = spectra[e, p, i, first + t]
                        size[t] += x.real * x.real + x.imag * x.imag
                for p in range(P - 1):
                    for t in range(m):
                        x, y = spectra[e, p, i, first + t], spectra[e, p + 1, i, first + t]
                        a[t] += y.real * x.real + y.imag * x.imag
                        b[t] += y.imag * x.real - y.real * x.imag
                        off_real, off_imag = y.real - x.real, y.imag - x.imag
                        change[t] += off_real * off_real + off_imag * off_imag
            for t in range(m):
                power[i] += size[t]
                moved[i] += change[t]
                cross[i, first + t] = complex(a[t], b[t])


@vectorised
def early_differences(
    spectra: Complex, channel: int, discarded: Complex, first: Real, second: Real, cross: Complex
) -> float:
    """How the first two periods of a channel differ from the mean of those that follow.

    Parameters
    ----------
    spectra : array, (q, P, channels, F)
        Kept periods.
    channel : int
    discarded : array, (q, F) or (0, 0)
        The period before them, if it is known; it is the first then. At least three periods in all.
    first, second : array, (F,)
        Results: ``sum_e |D0|^2`` and ``sum_e |D1|^2``.
    cross : array, (F,)
        Result: ``sum_e D1 conj(D0)``.

    Returns
    -------
    float
        ``sum |X|^2`` of the last period.
    """
    q, P, _, F = spectra.shape
    known = len(discarded) > 0
    begin = 1 if known else 2  # of the periods after the second
    rest = np.empty(TILE, dtype=np.complex128)
    response = 0.0
    for start in range(0, F, TILE):
        m = min(TILE, F - start)
        for t in range(m):
            first[start + t], second[start + t], cross[start + t] = 0.0, 0.0, 0.0
        for e in range(q):
            for t in range(m):
                rest[t] = 0.0
            for p in range(begin, P):
                for t in range(m):
                    rest[t] += spectra[e, p, channel, start + t]
            for t in range(m):
                x = discarded[e, start + t] if known else spectra[e, 0, channel, start + t]
                y = spectra[e, begin - 1, channel, start + t]
                x -= (y + rest[t]) / (P - begin + 1)
                y -= rest[t] / (P - begin)
                first[start + t] += x.real * x.real + x.imag * x.imag
                second[start + t] += y.real * y.real + y.imag * y.imag
                cross[start + t] += y * x.conjugate()
                last = spectra[e, P - 1, channel, start + t]
                response += last.real * last.real + last.imag * last.imag
    return response


@vectorised
def coherent_power(
    first: Real, second: Real, cross: Complex, width: int, repetitions: int, chance: float
) -> float:
    """Part of `second` that is coherent with `first`, at the lines where the coherence is beyond chance.

    Parameters
    ----------
    first, second : array, (F,)
        Powers.
    cross : array, (F,)
    width : int
        Lines over which the coherence is taken; fewer at the ends of the band.
    repetitions : int
        Values behind each line.
    chance : float
        Logarithm of the probability of so high a coherence of independent values.
    """
    F = first.size
    found = 0.0
    for f in range(F):
        low, high = max(0, f - width // 2), min(F, f + (width - 1) // 2 + 1)
        a, b, x, y = 0.0, 0.0, 0.0, 0.0
        for k in range(low, high):
            a += first[k]
            b += second[k]
            x += cross[k].real
            y += cross[k].imag
        if a * b > 0.0:
            coherence = (x * x + y * y) / (a * b)
            free = repetitions * (high - low) - 1
            # log(1 - c) lies above -c / (1 - c), so that most lines need no logarithm
            if free * coherence > -chance * (1.0 - coherence) and (
                free * np.log1p(-min(coherence, 1.0 - 1e-15)) < chance
            ):
                found += second[f] * coherence
    return found


@vectorised
def noise_gains(U: Complex, gains: Real) -> None:
    """Mean diagonal of ``(U U^H / q)^-1`` of every line, the rows of ``U`` scaled to unit power.

    Parameters
    ----------
    U : array, (q, q, F)
        Experiment, input, line.
    gains : array, (F,)
        Result; infinite where ``U`` is singular to rounding.
    """
    q, _, F = U.shape
    real, imag = np.zeros((q, q, TILE)), np.zeros((q, q, TILE))
    L_real, L_imag = np.zeros((q, q, TILE)), np.zeros((q, q, TILE))
    d, scale, total = np.zeros((q, TILE)), np.zeros((q, TILE)), np.zeros(TILE)
    for first in range(0, F, TILE):
        m = min(TILE, F - first)
        for e in range(q):
            for i in range(q):
                for t in range(m):
                    real[e, i, t] = U[e, i, first + t].real
                    imag[e, i, t] = U[e, i, first + t].imag
        for i in range(q):
            for t in range(m):
                total[t] = 0.0
            for e in range(q):
                for t in range(m):
                    total[t] += real[e, i, t] * real[e, i, t] + imag[e, i, t] * imag[e, i, t]
            for t in range(m):
                scale[i, t] = 1.0 / np.sqrt(total[t])
        for i in range(q):  # U U^H = L D L^H, row by row
            for j in range(i + 1):
                for t in range(m):
                    L_real[i, j, t] = 0.0
                    L_imag[i, j, t] = 0.0
                for e in range(q):
                    for t in range(m):
                        a, b, c, s = real[e, i, t], imag[e, i, t], real[e, j, t], imag[e, j, t]
                        L_real[i, j, t] += a * c + b * s
                        L_imag[i, j, t] += b * c - a * s
                for t in range(m):
                    L_real[i, j, t] *= scale[i, t] * scale[j, t]
                    L_imag[i, j, t] *= scale[i, t] * scale[j, t]
                for k in range(j):
                    for t in range(m):
                        a, b, c, s = L_real[i, k, t], L_imag[i, k, t], L_real[j, k, t], L_imag[j, k, t]
                        L_real[i, j, t] -= d[k, t] * (a * c + b * s)
                        L_imag[i, j, t] -= d[k, t] * (b * c - a * s)
                if j == i:
                    for t in range(m):
                        d[i, t] = L_real[i, i, t]
                else:
                    for t in range(m):
                        L_real[i, j, t] /= d[j, t]
                        L_imag[i, j, t] /= d[j, t]
        for t in range(m):
            total[t] = 0.0
        for j in range(q):  # the inverse's trace is sum_ij |L^-1_ij|^2 / d_i; column j of L^-1 after another
            for i in range(j, q):
                for t in range(m):
                    real[0, i, t] = 1.0 if i == j else -L_real[i, j, t]
                    imag[0, i, t] = 0.0 if i == j else -L_imag[i, j, t]
                for k in range(j + 1, i):
                    for t in range(m):
                        real[0, i, t] -= L_real[i, k, t] * real[0, k, t] - L_imag[i, k, t] * imag[0, k, t]
                        imag[0, i, t] -= L_real[i, k, t] * imag[0, k, t] + L_imag[i, k, t] * real[0, k, t]
                for t in range(m):
                    total[t] += (real[0, i, t] * real[0, i, t] + imag[0, i, t] * imag[0, i, t]) / d[i, t]
        for t in range(m):
            gains[first + t] = total[t] / q
        for i in range(q):
            for t in range(m):
                if not d[i, t] > 0.0:
                    gains[first + t] = np.inf
