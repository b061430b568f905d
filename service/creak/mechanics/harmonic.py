"""Periodic motion of nonlinear elements on a linear structure: fixed point, Anderson's acceleration, Newton.

Unknown are the relative displacements ``d`` of the elements over one period, ``(r, N)``, with lines ``D``.
They obey ``D = D_lin - H F(d)`` with the motion ``D_lin`` that the structure would make without the elements,
their receptance ``H = Bᵀ S B`` and the lines F of their forces. Taking an equivalent linear part
``K_eq = k_eq + jw c_eq`` of the forces to the left side gives the map that is iterated here::

    D = P (D_lin - H (F(d) - K_eq D))        P = (I + H K_eq)⁻¹
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

import numpy as np
import scipy.fft
from scipy.sparse.linalg import LinearOperator, gmres

from creak.compiling import compiled
from creak.mechanics import laws
from creak.mechanics.effects import Restoring
from creak.mechanics.tangents import force_change
from creak.records import Complex, Real

DEPTH: Final = 6  # earlier iterates that Anderson's acceleration combines
FIXED_POINT_STEPS: Final = 60
EQUIVALENT_STEPS: Final = 12
ALIKE: Final = 0.02  # change of an equivalent linear element that makes no better map
NEGLIGIBLE: Final = 1e-3  # share of the strongest line of a motion, below which a line asks for no samples
FEWEST_SAMPLES: Final = 256
FITTED: Final = 4  # experiments that equivalent linear elements are fitted to
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
    size : int
        Samples a period, N.
    receptance : array, (L, r, r)
        H at the lines 0..N/2.
    jw : array, (L,)
        1/s; 0 at the Nyquist line, whose derivative no samples hold.
    linear : array, (E, r, L)
        D_lin, DFT divided by N.
    rate : array, (E, r, N), or None
        What the velocity has beside the derivative of the displacement's lines (held inputs).
    """

    elements: tuple[Restoring, ...]
    size: int
    receptance: Complex
    jw: Complex
    linear: Complex
    rate: Real | None

    def coarser(self) -> "Problem | None":
        """The same on fewer samples, which still hold the third harmonics of the motion without elements.

        None if there are not too many. Held inputs jump between samples, and are left as they are.
        """
        strength = np.abs(self.linear).max(axis=(0, 1))
        highest = int(np.flatnonzero(strength >= NEGLIGIBLE * strength.max())[-1])
        size = self.size
        while size % 2 == 0 and size // 2 >= max(8 * highest, FEWEST_SAMPLES):
            size //= 2
        if size == self.size or self.rate is not None:
            return None
        L = size // 2 + 1
        return Problem(self.elements, size, self.receptance[:L], self.jw[:L], self.linear[..., :L], None)

    def samples(self, lines: Complex) -> Real:
        """Time course of lines."""
        return np.asarray(scipy.fft.irfft(lines, n=self.size, norm="forward"))

    def lines(self, samples: Real) -> Complex:
        """Lines of a time course."""
        return np.asarray(scipy.fft.rfft(samples, norm="forward"))

    def motion(self, D: Complex, which: slice | int = slice(None)) -> tuple[Real, Real]:
        """Displacement and velocity over a period."""
        velocity = self.samples(self.jw * D)
        return self.samples(D), velocity if self.rate is None else velocity + self.rate[which]

    @cached_property
    def _laws(self) -> tuple[tuple[int, float, float], ...]:
        return tuple((element.law, *element.constants()) for element in self.elements)

    def forces(self, d: Real, v: Real) -> Real:
        """Forces of the elements, ``(..., r, N)``."""
        out = np.empty_like(d)
        for e, (law, p, q) in enumerate(self._laws):
            rows = (np.ascontiguousarray(x[..., e, :]).reshape(-1, d.shape[-1]) for x in (d, v))
            out[..., e, :] = laws.force_over_period(law, p, q, *rows).reshape(out[..., e, :].shape)
        return out

    @property
    def of_velocity(self) -> bool:
        """True if a law asks for the velocity."""
        return any(law in laws.OF_VELOCITY for law, _, _ in self._laws)

    def seen(self, D: Complex, which: int) -> tuple[Real, Real]:
        """Displacement and velocity over a period, the latter zero where no law asks for it."""
        if self.of_velocity:
            return self.motion(D, which)
        d = self.samples(D)
        return d, np.zeros_like(d)


@dataclass(frozen=True, eq=False)
class Equivalent:
    """Equivalent linear part and the map that it makes.

    Parameters
    ----------
    law : array, (L, r)
        ``k_eq + jw c_eq``.
    forced : array, (L, r, r)
        P H.
    motion : array, (E, r, L)
        ``P D_lin``, the motion with the equivalent linear elements.
    """

    law: Complex
    forced: Complex
    motion: Complex

    def rest(self, problem: Problem, D: Complex, which: int) -> Complex:
        """By how much one application of the map moves the lines ``(r, L)``."""
        return _rest(
            self.motion[which], self.forced, self.law, D, problem.lines(problem.forces(*problem.seen(D, which)))
        )

    def balanced(self, D: Complex, F: Complex, which: int) -> Complex:
        """Lines of the elements' forces F at a motion D, both ``(r, L)``, corrected by one application of the map.

        Where a structure is held by its elements alone, its mean motion is what tiny forces make of a huge
        receptance: with the corrected ones it is as exact as the elements' motion is, and not as the forces are.
        """
        return F + self.law.T * _rest(self.motion[which], self.forced, self.law, D, F)


@compiled
def _rest(motion: Complex, forced: Complex, law: Complex, D: Complex, F: Complex) -> Complex:
    r, size = D.shape
    rest = motion - D
    for j in range(r):
        for line in range(size):
            beyond = F[j, line] - law[line, j] * D[j, line]
            for i in range(r):
                rest[i, line] -= forced[line, i, j] * beyond
    return rest


def apply(matrix: Complex, lines: Complex) -> Complex:
    """Product of matrices ``(L, i, j)`` with lines ``(..., j, L)``."""
    return np.asarray(np.einsum("lij,...jl->...il", matrix, lines))


def equivalent(problem: Problem, k: Real, c: Real) -> Equivalent:
    """Prepare the map for given equivalent stiffnesses and dampings, ``(r,)`` each."""
    law = np.asarray(k + problem.jw[:, None] * c, dtype=np.complex128)
    whole = np.eye(len(k)) + problem.receptance * law[:, None, :]
    free = np.asarray(np.linalg.inv(whole), dtype=np.complex128)
    return Equivalent(law, np.ascontiguousarray(free @ problem.receptance), apply(free, problem.linear))


def fitted(problem: Problem, D: Complex, which: slice = slice(None)) -> tuple[Real, Real]:
    """Least squares of the forces on displacement and velocity, over experiments; ``(r,)`` each."""
    d, v = problem.motion(D, which)
    f = problem.forces(d, v)
    axes = (0, 2)
    d = d - d.mean(axis=-1, keepdims=True)
    k = np.sum(f * d, axis=axes) / np.maximum(np.sum(d * d, axis=axes), 1e-300)
    c = np.sum(f * v, axis=axes) / np.maximum(np.sum(v * v, axis=axes), 1e-300)
    return k, c


def linearised(problem: Problem, D: Complex | None) -> tuple[Real, Real]:
    """Stiffnesses and dampings of the equivalent linear elements that reproduce themselves, ``(r,)`` each.

    They are fitted to a few of the experiments: they only serve as a start and a map, and all experiments are
    of one kind.

    Parameters
    ----------
    problem : Problem
    D : array, (E, r, L), or None
        Motion to take the elements' linear part from; None to find both, beginning with no elements.
    """
    few = slice(0, None, -(-len(problem.linear) // FITTED))
    if D is not None:
        return fitted(problem, D[few], few)
    # Half a step in the logarithm: a stiff element seen at the motion of a free structure is far too stiff.
    k = np.zeros(len(problem.elements))
    c = np.zeros_like(k)
    rate = None if problem.rate is None else problem.rate[few]
    part = replace(problem, linear=problem.linear[few], rate=rate)
    motion = part.linear
    scale = 1.0 / np.maximum(np.abs(problem.receptance[1:]).max(axis=0).diagonal(), 1e-300)
    for _ in range(EQUIVALENT_STEPS):
        before = k, c
        new_k, new_c = fitted(part, motion)
        k = _between(k, new_k, scale)
        c = _between(c, new_c, scale / np.abs(problem.jw[1]))
        motion = equivalent(part, k, c).motion
        moved = np.maximum(np.abs(k - before[0]), np.abs(problem.jw[1] * (c - before[1])))
        if (moved <= ALIKE * (np.abs(k) + scale)).all():
            break
    return k, c


def _between(old: Real, new: Real, scale: Real) -> Real:
    return np.asarray(scale * np.sinh(0.5 * (np.arcsinh(old / scale) + np.arcsinh(new / scale))))


def distance(rest: Complex, D: Complex) -> float:
    """RMS of a rest ``(r, L)`` relative to that of the motion, at the element where it is largest."""
    return float(np.sqrt(np.max(_power(rest) / np.maximum(_power(D), 1e-300))))


def _power(lines: Complex) -> Real:
    flat = _flat(lines)
    return np.asarray(np.einsum("ix,ix->i", flat, flat))


def _flat(lines: Complex) -> Real:
    """Lines as real vectors whose inner product is that of the time courses, but for a factor; ``(r, 2 L)``."""
    return np.ascontiguousarray(lines).view(np.float64)


def fixed_point(
    problem: Problem, map_: Equivalent, D: Complex, which: int, tolerance: float
) -> tuple[Complex, float, int]:
    """Iterate one experiment with Anderson's acceleration.

    Parameters
    ----------
    problem, map_ : Problem, Equivalent
    D : array, (r, L)
        Where to begin.
    which : int
        Experiment.
    tolerance : float

    Returns
    -------
    D : array, (r, L)
        The best iterate.
    residual : float
    iterations : int
    """
    best, least = D, np.inf
    acceleration = _Acceleration(2 * D.size)
    step = 0
    while step < FIXED_POINT_STEPS:
        step += 1
        rest = map_.rest(problem, D, which)
        residual = distance(rest, D)
        if not np.isfinite(residual):
            break
        if residual < least:
            best, least = D, residual
        if residual <= tolerance:
            break
        if residual > 10 * least:
            # It has run away: begin again at the best iterate, and forget the way there.
            acceleration.forget()
            D = best
        else:
            D = acceleration.next(D, rest)
    return best, least, step


class _Acceleration:
    """Anderson's acceleration: steps that would cancel the rest if rests changed along as they did before.

    Inner products are taken by `einsum`, whose sums, unlike BLAS', do not hang on the number of threads.
    """

    def __init__(self, size: int) -> None:
        self._rests = np.empty((DEPTH, size))  # changes of the rest
        self._ways = np.empty((DEPTH, size))  # the same with the moves that they came from
        self._gram = np.empty((DEPTH, DEPTH))
        self.forget()

    def forget(self) -> None:
        self._known = 0
        self._before: tuple[Complex, Complex] | None = None

    def next(self, D: Complex, rest: Complex) -> Complex:
        """Give the iterate after one with a rest, both ``(r, L)``."""
        if self._before is not None:
            slot = self._known % DEPTH
            self._known += 1
            self._rests[slot] = _flat(rest - self._before[1]).ravel()
            self._ways[slot] = _flat(D - self._before[0]).ravel()
            self._ways[slot] += self._rests[slot]
            held = min(self._known, DEPTH)
            products = np.einsum("kx,x->k", self._rests[:held], self._rests[slot])
            self._gram[slot, :held] = self._gram[:held, slot] = products
        self._before = D, rest
        held = min(self._known, DEPTH)
        if not held:
            return D + rest
        right = np.einsum("kx,x->k", self._rests[:held], _flat(rest).ravel())
        gram = self._gram[:held, :held]
        # A ridge keeps nearly parallel differences from blowing the step up.
        ridge = 1e-14 * np.trace(gram) + 1e-300
        weight = np.linalg.solve(gram + ridge * np.eye(held), right)
        return (
            _advanced(_flat(D).ravel(), _flat(rest).ravel(), self._ways, weight)
            .view(np.complex128)
            .reshape(D.shape)
        )


@compiled
def _advanced(D: Real, rest: Real, ways: Real, weight: Real) -> Real:
    out = D + rest
    for k in range(weight.size):
        for x in range(out.size):
            out[x] -= weight[k] * ways[k, x]
    return out


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
    rest = map_.rest(problem, D, which)
    residual = distance(rest, D)
    past = [residual]
    while residual > tolerance and len(past) <= NEWTON_STEPS:
        if len(past) > PATIENCE and not residual < 0.5 * past[-PATIENCE - 1]:
            break
        direction = _newton_direction(problem, map_, D, which, rest, min(0.1, residual), krylov)
        share = 1.0
        while True:
            trial = D + share * direction
            new_rest = map_.rest(problem, trial, which)
            new = distance(new_rest, D)
            if new < (1 - 1e-3 * share) * residual or share < SHORTEST:
                break
            share /= 2
        if not new < residual:
            break
        D, rest = trial, new_rest
        residual = distance(rest, D)
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
        image = change + apply(map_.forced, problem.lines(df) - map_.law.T * change)
        return np.asarray((problem.samples(image) / scale).ravel())

    operator = LinearOperator((d.size, d.size), matvec=jacobian, dtype=np.float64)
    right = (problem.samples(rest) / scale).ravel()
    solution, _ = gmres(operator, right, rtol=accuracy, restart=krylov, maxiter=1)
    return problem.lines(solution.reshape(shape) * scale)
