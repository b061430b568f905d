"""The paper's batch formulas with loops, slow and obvious: the judge of the streaming sums.

Nothing here is shared with the service. ``U[m][c][p]`` and ``Y[m][c][p]`` are vectors over channels at one line.
"""

import numpy as np


def bla(U, Y):
    """(28): mean over realisations of (mean over p of Y) (mean over p of U)^-1, one line."""
    total = 0
    for Um, Ym in zip(U, Y, strict=True):
        Umat = np.stack([np.mean(Uc, axis=0) for Uc in Um], axis=1)
        Ymat = np.stack([np.mean(Yc, axis=0) for Yc in Ym], axis=1)
        total = total + Ymat @ np.linalg.inv(Umat)
    return total / len(U)


def node_to_node(U, Y, S, i):
    """(31)-(35) for a dense network: the row [G_u,i, G_ij (j != i)] of node i."""
    n = S.shape[0]
    others = [j for j in range(n) if j != i]
    total = 0
    for Um, Ym in zip(U, Y, strict=True):
        Umat = np.stack([np.mean(Uc, axis=0) for Uc in Um], axis=1)
        Ymat = np.stack([np.mean(Yc, axis=0) for Yc in Ym], axis=1)
        simulated = S @ Umat  # (30)
        Z = np.stack([Umat[i], *(simulated[j] for j in others)])
        total = total + Ymat[i] @ np.linalg.inv(Z)
    return total / len(U), others


def variances(e):
    """(37)-(41): total, noise and nonlinear variance of residuals e[experiment][period]."""
    E, P = len(e), len(e[0])
    mean_over_e = [sum(e[x][p] for x in range(E)) / E for p in range(P)]
    mean_over_p = [sum(e[x]) / P for x in range(E)]
    total = sum(abs(e[x][p] - mean_over_e[p]) ** 2 for x in range(E) for p in range(P)) / (P * (E - 1))
    noise = sum(abs(e[x][p] - mean_over_p[x]) ** 2 for x in range(E) for p in range(P)) / (E * (P - 1))
    return total, noise, max(total - noise, 0)


def analysis(spectra, q):
    """All of section 3 and 4 of the method for ``spectra (M, q, P, F, q + n)``.

    Returns a dict of arrays (F, n): signal, and total, noise, nonlinear, networked and classical; and S.
    """
    M, _, P, F, width = spectra.shape
    n = width - q
    out = {
        key: np.zeros((F, n))
        for key in (
            "signal",
            "total",
            "noise",
            "nonlinear",
            "classical_total",
            "classical_noise",
            "classical_nonlinear",
        )
    }
    out["S"] = np.zeros((F, n, q), dtype=complex)
    for f in range(F):
        U = [[[spectra[m, c, p, f, :q] for p in range(P)] for c in range(q)] for m in range(M)]
        Y = [[[spectra[m, c, p, f, q:] for p in range(P)] for c in range(q)] for m in range(M)]
        S = bla(U, Y)
        out["S"][f] = S
        for i in range(n):
            classical, networked, power = [], [], []
            if q == n:
                g, others = node_to_node(U, Y, S, i)
            for m in range(M):
                for c in range(q):
                    classical.append([(S @ U[m][c][p])[i] - Y[m][c][p][i] for p in range(P)])
                    power.append([abs(Y[m][c][p][i]) ** 2 for p in range(P)])
                    if q == n:  # (36): with the measured neighbours
                        networked.append(
                            [
                                g[0] * U[m][c][p][i]
                                + sum(g[1 + k] * Y[m][c][p][j] for k, j in enumerate(others))
                                - Y[m][c][p][i]
                                for p in range(P)
                            ]
                        )
            out["signal"][f, i] = np.mean(power)
            t, s, d = variances(classical)
            out["classical_total"][f, i], out["classical_noise"][f, i], out["classical_nonlinear"][f, i] = t, s, d
            if q == n:
                out["total"][f, i], out["noise"][f, i], out["nonlinear"][f, i] = variances(networked)
    return out
