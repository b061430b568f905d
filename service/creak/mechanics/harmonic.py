"""Periodic motion of nonlinear elements on a linear structure: fixed point, Anderson's acceleration, Newton.

Unknown are the relative displacements ``d`` of the elements over one period, ``(r, N)``, with lines ``D``.
They obey ``D = D_lin - H F(d)`` with the motion ``D_lin`` that the structure would make without the elements,
their receptance ``H = Bᵀ S B`` and the lines F of their forces. Taking an equivalent linear part
``K_eq = k_eq + jw c_eq`` of the forces to the left side gives the map that is iterated here::

    D = P (D_lin - H (F(d) - K_eq D))        P = (I + H K_eq)⁻¹
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from creak.mechanics.effects import Restoring
from creak.mechanics.tangents import force_change
from creak.records import Complex, Real

DEPTH: Final = 6  # earlier iterates that Anderson's acceleration combines
FIXED_POINT_STEPS: Final = 60
EQUIVALENT_STEPS: Final = 12
NEWTON_STEPS: Final = 40
KRYLOV_STEPS: Final = 80
PATIENCE: Final = 6  # Newton steps that must at least halve the residual
SHORTEST: Final = 1 / 128  # of a Newton step that is still tried


@dataclass(frozen=True, eq=False)
class Problem:
    """What the elements' motion is to satisfy.

    Parameters
    ----------
    elements : tuple of Restoring, (r,)
    receptance : array, (L, r, r)
        H at the lines 0..N/2.
    jw : array, (L,)
        1/s; 0 at the Nyquist line, whose derivative no samples hold.
    linear : array, (E, r, L)
        D_lin, DFT divided by N.
    rate : array, (E, r, N)
        What the velocity has beside the derivative of the displacement's lines (held inputs).
    """

    elements: tuple[Restoring, ...]
    receptance: Complex
    jw: Complex
    linear: Complex
    rate: Real

    @property
    def size(self) -> int:
        """Samples a period."""
        return int(self.rate.shape[-1])

    def samples(self, lines: Complex) -> Real:
        """Time course of lines."""
        return np.asarray(np.fft.irfft(lines * self.size, n=self.size))

    def lines(self, samples: Real) -> Complex:
        """Lines of a time course."""
        return np.fft.rfft(samples) / self.size

    def motion(self, D: Complex, which: slice | int = slice(None)) -> tuple[Real, Real]:
        """Displacement and velocity over a period."""
        return self.samples(D), self.samples(self.jw * D) + self.rate[which]

    def forces(self, d: Real, v: Real) -> Real:
        """Forces of the elements, ``(..., r, N)``."""
        out = np.empty_like(d)
        for e, element in enumerate(self.elements):
            out[..., e, :] = element.over_period(d[..., e, :], v[..., e, :])
        return out


@dataclass(frozen=True, eq=False)
class Equivalent:
    """Equivalent linear part and the map that it makes.

    Parameters
    ----------
    law : array, (L, r)
        ``k_eq + jw c_eq``.
    free : array, (L, r, r)
        P.
    forced : array, (L, r, r)
        P H.
    """

    law: Complex
    free: Complex
    forced: Complex

    def image(self, problem: Problem, D: Complex, which: slice | int = slice(None)) -> Complex:
        """One application of the map to lines ``(..., r, L)``."""
        F = problem.lines(problem.forces(*problem.motion(D, which)))
        law = self.law.T
        return _apply(self.free, problem.linear[which]) - _apply(self.forced, F - law * D)


def _apply(matrix: Complex, lines: Complex) -> Complex:
    return np.asarray(np.einsum("lij,...jl->...il", matrix, lines))


def equivalent(problem: Problem, k: Real, c: Real) -> Equivalent:
    """Prepare the map for given equivalent stiffnesses and dampings, ``(r,)`` each."""
    law = np.asarray(k + problem.jw[:, None] * c, dtype=np.complex128)
    free = np.linalg.inv(np.eye(len(k)) + problem.receptance * law[:, None, :])
    return Equivalent(law, np.asarray(free, dtype=np.complex128), free @ problem.receptance)


def fitted(problem: Problem, D: Complex) -> tuple[Real, Real]:
    """Least squares of the forces on displacement and velocity, over all experiments; ``(r,)`` each."""
    d, v = problem.motion(D)
    f = problem.forces(d, v)
    axes = (0, 2)
    d = d - d.mean(axis=-1, keepdims=True)
    k = np.sum(f * d, axis=axes) / np.maximum(np.sum(d * d, axis=axes), 1e-300)
    c = np.sum(f * v, axis=axes) / np.maximum(np.sum(v * v, axis=axes), 1e-300)
    return k, c


def linearised(problem: Problem, D: Complex | None) -> tuple[Complex, Equivalent]:
    """Motion and map of the equivalent linear elements that reproduce themselves.

    Parameters
    ----------
    problem : Problem
    D : array, (E, r, L), or None
        Motion to take the elements' linear part from; None to find both, beginning with no elements.
    """
    if D is not None:
        return D, equivalent(problem, *fitted(problem, D))
    # Half a step in the logarithm: a stiff element seen at the motion of a free structure is far too stiff.
    k = np.zeros(len(problem.elements))
    c = np.zeros_like(k)
    D = problem.linear
    scale = 1.0 / np.maximum(np.abs(problem.receptance[1:]).max(axis=0).diagonal(), 1e-300)
    for _ in range(EQUIVALENT_STEPS):
        new_k, new_c = fitted(problem, D)
        k = _between(k, new_k, scale)
        c = _between(c, new_c, scale / np.abs(problem.jw[1]))
        map_ = equivalent(problem, k, c)
        D = _apply(map_.free, problem.linear)
    return D, map_


def _between(old: Real, new: Real, scale: Real) -> Real:
    return np.asarray(scale * np.sinh(0.5 * (np.arcsinh(old / scale) + np.arcsinh(new / scale))))


def distance(problem: Problem, rest: Complex, D: Complex) -> Real:
    """RMS of a rest relative to that of the motion, at the element where it is largest; ``(...)``."""
    power = np.sum(np.abs(D) ** 2, axis=-1)
    return np.asarray(np.sqrt(np.max(np.sum(np.abs(rest) ** 2, axis=-1) / np.maximum(power, 1e-300), axis=-1)))


def fixed_point(problem: Problem, map_: Equivalent, D: Complex, tolerance: float) -> tuple[Complex, Real, int]:
    """Iterate all experiments together, each with its own Anderson acceleration.

    Returns
    -------
    D : array, (E, r, L)
        The best iterate of every experiment.
    residual : array, (E,)
    iterations : int
    """
    best, best_residual = D.copy(), np.full(len(D), np.inf)
    moves: list[Real] = []
    rests: list[Real] = []
    before: tuple[Complex, Complex] | None = None
    begun = np.ones((len(D), 1, 1), dtype=bool)
    step = 0
    while step < FIXED_POINT_STEPS:
        step += 1
        rest = map_.image(problem, D) - D
        residual = distance(problem, rest, D)
        residual[~np.isfinite(residual)] = np.inf
        better = residual < best_residual
        best[better], best_residual[better] = D[better], residual[better]
        if (best_residual <= tolerance).all() or not np.isfinite(residual).any():
            break
        if before is not None:
            moves = [*moves[1 - DEPTH :], _flat(np.where(begun, D - before[0], 0.0))]
            rests = [*rests[1 - DEPTH :], _flat(np.where(begun, rest - before[1], 0.0))]
        before = (D, rest)
        D = D + _accelerated(rest, moves, rests)
        # An experiment that has run away begins again at its best iterate, and forgets the way there.
        lost = residual > 10 * best_residual
        begun = ~lost[:, None, None]
        for past in (*moves, *rests):
            past[lost] = 0.0
        settled = best_residual <= tolerance
        D[lost | settled] = best[lost | settled]
    return best, best_residual, step


def _accelerated(rest: Complex, moves: list[Real], rests: list[Real]) -> Complex:
    """Step of every experiment that would cancel its rest, if rests changed along as they did before."""
    if not rests:
        return rest
    flat = _flat(rest)
    A = np.stack(rests, axis=-1)
    gram = A.swapaxes(1, 2) @ A
    # A ridge keeps nearly parallel differences from blowing the step up.
    ridge = 1e-14 * np.trace(gram, axis1=1, axis2=2) + 1e-300
    gram += ridge[:, None, None] * np.eye(len(rests))
    weight = np.linalg.solve(gram, A.swapaxes(1, 2) @ flat[..., None])
    step = flat[..., None] - (np.stack(moves, axis=-1) + A) @ weight
    return np.ascontiguousarray(step[..., 0]).view(np.complex128).reshape(rest.shape)


def _flat(lines: Complex) -> Real:
    """Lines as real vectors whose inner product is that of the time courses, but for a factor; ``(E, r L 2)``."""
    return np.ascontiguousarray(lines).reshape(len(lines), -1).view(np.float64)


def newton(
    problem: Problem, map_: Equivalent, D: Complex, which: int, tolerance: float, krylov: int = KRYLOV_STEPS
) -> tuple[Complex, float, int]:
    """Newton's method on one experiment, its steps solved by GMRES with the laws' own slopes.

    Parameters
    ----------
    problem, map_ : Problem, Equivalent
    D : array, (r, L)
        Where to begin.
    which : int
        Experiment.
    tolerance : float
    krylov : int
        Most products with the Jacobian a step.

    Returns
    -------
    D, residual, iterations
    """
    rest = map_.image(problem, D, which) - D
    residual = float(distance(problem, rest, D))
    past = [residual]
    while residual > tolerance and len(past) <= NEWTON_STEPS:
        if len(past) > PATIENCE and not residual < 0.5 * past[-PATIENCE - 1]:
            break
        direction = _newton_direction(problem, map_, D, which, rest, min(0.1, residual), krylov)
        share = 1.0
        while True:
            trial = D + share * direction
            new_rest = map_.image(problem, trial, which) - trial
            new = float(distance(problem, new_rest, D))
            if new < (1 - 1e-3 * share) * residual or share < SHORTEST:
                break
            share /= 2
        if not new < residual:
            break
        D, rest = trial, new_rest
        residual = float(distance(problem, rest, D))
        past.append(residual)
    return D, residual, len(past)


def _newton_direction(
    problem: Problem, map_: Equivalent, D: Complex, which: int, rest: Complex, accuracy: float, krylov: int
) -> Complex:
    d, v = problem.motion(D, which)
    f = problem.forces(d, v)
    shape = d.shape
    # Elements of unlike size count alike.
    scale = np.maximum(np.sqrt(np.mean(d**2, axis=-1, keepdims=True)), 1e-300)

    def jacobian(flat: Real) -> Real:
        change = problem.lines(flat.reshape(shape) * scale)
        dd, dv = problem.samples(change), problem.samples(problem.jw * change)
        df = np.empty(shape)
        for e, element in enumerate(problem.elements):
            df[e] = force_change(element.law, *element.constants(), d[e], v[e], f[e], dd[e], dv[e])
        image = change + _apply(map_.forced, problem.lines(df) - map_.law.T * change)
        return np.asarray((problem.samples(image) / scale).ravel())

    operator = LinearOperator((d.size, d.size), matvec=jacobian, dtype=np.float64)
    right = (problem.samples(rest) / scale).ravel()
    solution, _ = gmres(operator, right, rtol=accuracy, restart=krylov, maxiter=1)
    return problem.lines(solution.reshape(shape) * scale)
