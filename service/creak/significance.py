"""Is a distortion significant? Probabilities per line, band and node, and the rate of false discoveries.

All of them refer to a linear structure with white sensor noise, in which total and noise variance agree. Then the
p-value of a line is uniform on [0, 1], lines are independent, and so is what is pooled over a band or all lines.
The nodes at one line are not independent, since they share the estimated ``S`` and their neighbours' noise.

Process noise and strongly coloured noise leak from period to period: less changes within an experiment than the
test expects of noise between experiments as well, so p-values come out too large, never too small on average.
"""

from itertools import pairwise

import numpy as np
import scipy.special
from numpy.typing import NDArray

from creak.compiling import compiled, vectorised
from creak.hermitian import TILE
from creak.records import Real

FALSE_DISCOVERIES = 0.05
"""Share of false ones that is accepted among the lines and nodes that are called significant."""


def line_p_values(between: Real, within: Real, experiments: int, periods: int, fitted: Real) -> Real:
    """Probability per line and node of so large a residual if the structure is linear (section 6 of the method).

    With ``r = P sum_e |mean_p e|^2 / (E - d)`` and ``w = sum_e sum_p |e - mean_p e|^2 / (E(P - 1))`` the ratio
    ``r/w`` follows ``F(2(E - d), 2E(P - 1))``.

    Parameters
    ----------
    between, within : array, (F, n)
        The two sums of squares, ``P sum_e |mean_p e|^2`` and ``sum_e sum_p |e - mean_p e|^2``.
    experiments, periods : int
        E and P; more experiments than fitted parameters, at least two periods.
    fitted : array, (n,)
        d, complex parameters fitted at each node and line: the number of inputs for the classical analysis,
        whether there are as many nodes or more; n for a dense network; 1 + neighbours for a sparse one.

    Returns
    -------
    array, (F, n)
        NaN where there is no noise to compare with.
    """
    p = np.empty(between.shape[::-1])  # lines last, as the moments are
    noise_free = experiments * (periods - 1)
    for node, free in enumerate(experiments - fitted):
        p[node] = variance_ratio_p_values(between[:, node], within[:, node], float(free), float(noise_free))
    return p.T


_MOST_TERMS = 1000  # of the finite sum: its binomial coefficients stay far below the largest number


def variance_ratio_p_values(x: Real, y: Real, free: float, other_free: float) -> Real:
    """Probability of so large a ratio ``(x/free) / (y/other_free)`` of two sums of squared moduli.

    Parameters
    ----------
    x, y : array, (K,)
        Not below 0.
    free, other_free : float
        Complex degrees of freedom, half those of the F law.

    Returns
    -------
    array, (K,)
        NaN where both are 0.
    """
    if free == int(free) >= 1 and other_free == int(other_free) >= 1 and free + other_free <= _MOST_TERMS:
        p = np.empty(len(x))
        _variance_ratio_tails(np.ascontiguousarray(x), np.ascontiguousarray(y), int(free), int(other_free), p)
        return p
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = (x / free) / (y / other_free)
    return np.asarray(scipy.special.fdtrc(2 * free, 2 * other_free, ratio), dtype=np.float64)


@vectorised
def _variance_ratio_tails(x: Real, y: Real, m: int, k: int, p: Real) -> None:
    """``P(F(2m, 2k) > (x/m) / (y/k))`` as ``b^k sum_(j < m) C(k + j - 1, j) a^j``.

    With ``a = x/(x + y)`` and ``b = y/(x + y)``: M. Abramowitz, I. A. Stegun, *Handbook of Mathematical
    Functions*, 26.6.4. All terms are positive, so the result is good to rounding however small it is; the power
    of b comes in two halves, so that neither overflows.
    """
    a, b, total, power = np.empty(TILE), np.empty(TILE), np.empty(TILE), np.empty(TILE)
    for first in range(0, x.size, TILE):
        n = min(TILE, x.size - first)
        for t in range(n):
            both = x[first + t] + y[first + t]
            a[t] = x[first + t] / both
            b[t] = y[first + t] / both
        for t in range(TILE):
            total[t] = 1.0
        for j in range(m - 1, 0, -1):
            factor = (k + j - 1.0) / j
            for t in range(TILE):
                total[t] = 1.0 + factor * a[t] * total[t]
        for half in (k // 2, k - k // 2):
            left = half
            for t in range(TILE):
                power[t] = b[t]
            while left > 0:
                if left % 2 == 1:
                    for t in range(TILE):
                        total[t] *= power[t]
                left //= 2
                for t in range(TILE):
                    power[t] *= power[t]
        for t in range(n):
            p[first + t] = total[t] if not total[t] > 1.0 else 1.0  # by rounding


def pooled_p_value(p: Real) -> Real:
    """Combine the p-values of independent lines into one per node by Fisher's method.

    ``-2 sum_k ln p_k`` follows a chi-square law of 2F degrees of freedom if all lines are linear (R. A. Fisher,
    *Statistical Methods for Research Workers*, 4th ed., section 21.1).

    Parameters
    ----------
    p : array, (F, n)

    Returns
    -------
    array, (n,)
        Uniform on [0, 1] if the structure is linear.
    """
    statistic = -2.0 * np.log(np.maximum(p, np.finfo(np.float64).tiny)).sum(axis=0)
    return np.asarray(scipy.special.chdtrc(2.0 * len(p), statistic), dtype=np.float64)


def octaves(frequency: Real) -> tuple[slice, ...]:
    """Split rising lines into bands of an octave, counted down from the highest line.

    Parameters
    ----------
    frequency : array, (F,)
        Hz.

    Returns
    -------
    tuple of slice
        Lines of each band, none empty, rising; together they are all lines.
    """
    above = frequency[frequency > 0]
    if not above.size:
        return (slice(0, len(frequency)),) if len(frequency) else ()
    count = int(np.log2(above[-1] / above[0])) + 1
    edges = frequency[-1] / 2.0 ** np.arange(count, -1, -1)
    # An edge belongs to the band below it, and rounding must not lose the highest line.
    starts = np.searchsorted(frequency, edges * (1 + 1e-9), side="right")
    starts[0] = 0
    return tuple(slice(int(a), int(b)) for a, b in pairwise(starts) if b > a)


def q_values(p: Real, *, dependent: bool = False) -> Real:
    """Smallest rate of false discoveries at which each test is still called significant.

    All lines and nodes are one family. Those with ``q <= Q`` hold at most a share Q of false ones on average
    (Y. Benjamini and Y. Hochberg, *J. Royal Statistical Society B* 57 (1995) 289). That is proved for independent
    and for positively dependent tests, which the nodes at one line are in all measured cases; with `dependent` it
    holds for any dependence at the price of power (Y. Benjamini and D. Yekutieli, *Annals of Statistics* 29 (2001)
    1165).

    Parameters
    ----------
    p : array
        p-values of any shape; NaN is no test.
    dependent : bool

    Returns
    -------
    array
        Of the shape of `p`; NaN where that is.
    """
    tests = np.ascontiguousarray(np.asarray(p).T).ravel()  # in the order of memory
    order = np.argsort(tests)  # NaN last
    count = int(np.isfinite(tests).sum())
    factor = (1.0 / np.arange(1, count + 1)).sum() if dependent else 1.0
    q = np.full(tests.size, np.nan)
    _step_up(tests, order[:count], factor, q)
    return q.reshape(np.shape(p)[::-1]).T


@compiled
def _step_up(tests: Real, order: NDArray[np.intp], factor: float, q: Real) -> None:
    """Smallest of ``p_(i) m factor / i`` over a test's own rank and all above it, at most 1."""
    least = 1.0
    for rank in range(order.size, 0, -1):
        at = order[rank - 1]
        least = min(least, tests[at] * factor * order.size / rank)
        q[at] = least
