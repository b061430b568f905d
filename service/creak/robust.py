"""The robust method for one input and one output, equation by equation as the paper has it: (16) to (24).

``M`` realisations of a random-phase multisine with one and the same power spectrum, ``P`` steady-state periods of
each. What changes from period to period is noise; what changes from realisation to realisation is noise and
stochastic nonlinear distortion together, since the distortion depends on the phases and repeats with the period.

The monitor does not call this: for one input :mod:`creak.statistics` gives the same numbers from streaming sums.
It is here to be read beside the paper, and to be used on arrays.
"""

from dataclasses import dataclass

import numpy as np

from creak.errors import MeasurementError
from creak.records import Complex, Real


@dataclass(frozen=True, eq=False)
class RobustBla:
    """Best linear approximation of a system with one input and one output, and what varies about it.

    Parameters
    ----------
    G : array, (F,)
        Best linear approximation, response per input (18).
    total : array, (F,)
        Variance of ``G`` by noise and distortion together (20); NaN for one realisation.
    noise : array, (F,)
        Variance of ``G`` by noise (21); NaN for one period.
    nonlinear : array, (F,)
        Variance of ``G`` by distortion (22): their difference, not below 0.
    output_nonlinear : array, (F,)
        Variance of the stochastic distortion ``y_s`` in one period of the response (23), response unit squared.
    output_noise : array, (F,)
        Variance of the noise ``v`` in one period of the response (24), response unit squared.
    """

    G: Complex
    total: Real
    noise: Real
    nonlinear: Real
    output_nonlinear: Real
    output_noise: Real


def robust_bla(U: Complex, Y: Complex) -> RobustBla:
    """Best linear approximation with its total, noise and nonlinear variance, (16)-(24).

    With realisation ``m`` and period ``p`` in brackets, at every line::

        (16)  G[m,p]    = Y[m,p] / U[m]
        (17)  G[m]      = 1/P  sum_p G[m,p]
        (18)  G         = 1/M  sum_m G[m]
        (19)  s2_n[m]   = 1/(P(P-1))  sum_p |G[m,p] - G[m]|^2
        (20)  s2_t      = 1/(M(M-1))  sum_m |G[m] - G|^2
        (21)  s2_n      = 1/M^2  sum_m s2_n[m]
        (22)  s2_s      = s2_t - s2_n  if that is positive, else 0
        (23)  s2_y_s    = M s2_s |U|^2
        (24)  s2_v      = M P s2_n |U|^2

    Parameters
    ----------
    U : array, (M, F) or (M, P, F)
        DFT of the input at the excited lines. If it was measured in every period, its mean over the periods is
        taken, as the noise of a single one would enter (16) in the denominator.
    Y : array, (M, P, F)
        DFT of the response, scaled as ``U``.

    Returns
    -------
    RobustBla

    Raises
    ------
    MeasurementError
        If the shapes do not fit each other, or the input is zero at a line.

    Notes
    -----
    (21) is the mean over ``m`` of (19), the noise variance of one ``G[m]``, divided by ``M`` once more, as ``G``
    is the mean of ``M`` of them: ``1/(M^2 P (P-1))`` before the sums. So (20) and (21) agree on a linear system.

    Examples
    --------
    Two realisations of two periods at one line; the response differs by 0.2 between the periods of the first:

    >>> import numpy as np
    >>> bla = robust_bla(np.array([[1.0], [1.0]]), np.array([[[1.9], [2.1]], [[2.0], [2.0]]]))
    >>> complex(bla.G[0]), round(float(bla.noise[0]), 6), round(float(bla.output_noise[0]), 6)
    ((2+0j), 0.0025, 0.01)
    """
    U, Y = np.asarray(U, dtype=np.complex128), np.asarray(Y, dtype=np.complex128)
    if Y.ndim != 3 or Y.size == 0:
        raise MeasurementError(f"Y: shape {Y.shape}, expected (realisations, periods, lines), none of them 0")
    M, P, F = Y.shape
    if U.shape not in ((M, F), (M, P, F)):
        raise MeasurementError(f"U: shape {U.shape}, expected {(M, F)} or {(M, P, F)} to go with Y of {Y.shape}")
    if U.ndim == 3:
        U = U.mean(axis=1)
    if not (np.abs(U) > 0).all():
        m, k = (int(i) for i in np.argwhere(~(np.abs(U) > 0))[0])
        raise MeasurementError(
            f"U: zero or not a number at line {k} of realisation {m}, expected it to be excited"
        )

    G_mp = Y / U[:, None, :]  # (16)
    G_m = G_mp.mean(axis=1)  # (17)
    G = G_m.mean(axis=0)  # (18)
    unknown = np.full(F, np.nan)
    noise = unknown
    if P > 1:
        noise_m = (np.abs(G_mp - G_m[:, None]) ** 2).sum(axis=1) / (P * (P - 1))  # (19)
        noise = noise_m.sum(axis=0) / M**2  # (21)
    total = unknown
    if M > 1:
        total = (np.abs(G_m - G) ** 2).sum(axis=0) / (M * (M - 1))  # (20)
    nonlinear = np.maximum(total - noise, 0.0)  # (22); NaN stays NaN
    power = (np.abs(U) ** 2).mean(axis=0)  # the same in every realisation but for what was measured
    return RobustBla(
        G=G,
        total=total,
        noise=noise,
        nonlinear=nonlinear,
        output_nonlinear=M * nonlinear * power,  # (23)
        output_noise=M * P * noise * power,  # (24)
    )
