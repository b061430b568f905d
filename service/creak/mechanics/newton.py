"""Newton's method on the nonlinear elements of one time step, compiled."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from creak.compiling import compiled
from creak.mechanics import laws
from creak.records import Real

TOLERANCE: Final = 1e-12  # of the elements' displacements: Newton goes on until they agree as well as that
ROUNDING: Final = 1e-14  # of them, times what a steep law makes of it: no iteration gets below
ITERATIONS: Final = 100
SEARCHES: Final = 60  # trials along one direction


class Elements(NamedTuple):
    """Nonlinear elements as the compiled code takes them.

    Parameters
    ----------
    codes : array of int, (r,)
        Laws.
    constants : array, (r, 2)
        Their parameters.
    incidence : array, (r, dof)
        Relative displacements per coordinate.
    flexibility : array, (r, r)
        Relative displacements per force of the elements, within one step.
    rate : float
        Relative velocity per relative displacement, within one step.
    """

    codes: NDArray[np.int64]
    constants: Real
    incidence: Real
    flexibility: Real
    rate: float


class Step(NamedTuple):
    """One step as the elements see it, and room to solve it; every array ``(r,)`` but the last.

    Parameters
    ----------
    d_lin, v_lin : array
        Relative displacement and velocity at its end without the elements' forces.
    d0, z0 : array
        Displacement and memory at its beginning.
    f : array
        Force: at its beginning, as a guess, and afterwards at its end.
    w, z : array
        Correction to ``d_lin``, and memory, at its end.
    guess, trial, direction : array
        Forces that the step is solved for.
    slope, rest, moved : array
        Slope of each law, force less guess, and the displacement that this makes.
    jacobian : array, (r, r)
    """

    d_lin: Real
    v_lin: Real
    d0: Real
    z0: Real
    f: Real
    w: Real
    z: Real
    guess: Real
    trial: Real
    direction: Real
    slope: Real
    rest: Real
    moved: Real
    jacobian: Real


@compiled
def evaluate(elements: Elements, step: Step, guess: Real) -> float:
    """Fill in what follows from guessed forces; return by how much the displacements then disagree."""
    r = guess.size
    for i in range(r):
        w = 0.0
        for j in range(r):
            w -= elements.flexibility[i, j] * guess[j]
        step.w[i] = w
        step.f[i], by_d, by_v, step.z[i] = laws.force(
            elements.codes[i],
            elements.constants[i, 0],
            elements.constants[i, 1],
            step.d_lin[i] + w,
            step.v_lin[i] + elements.rate * w,
            step.d0[i],
            step.z0[i],
        )
        step.slope[i] = by_d + elements.rate * by_v
        step.rest[i] = step.f[i] - guess[i]
    total = 0.0
    for i in range(r):
        moved = 0.0
        for j in range(r):
            moved += elements.flexibility[i, j] * step.rest[j]
        step.moved[i] = moved
        total += moved * moved
    return math.sqrt(total)


@compiled
def descent(step: Step) -> float:
    """Slope of the potential along the direction of search, at the forces evaluated last."""
    total = 0.0
    for i in range(step.moved.size):
        total -= step.moved[i] * step.direction[i]
    return total


@compiled
def eliminate(matrix: Real, right: Real) -> bool:
    """Solve in place by elimination with pivoting; False if the matrix is singular."""
    r = right.size
    for k in range(r):
        pivot = k
        for i in range(k + 1, r):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if matrix[pivot, k] == 0.0 or not math.isfinite(matrix[pivot, k]):
            return False
        if pivot != k:
            for j in range(r):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, r):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + 1, r):
                matrix[i, j] -= factor * matrix[k, j]
            right[i] -= factor * right[k]
    for k in range(r - 1, -1, -1):
        for j in range(k + 1, r):
            right[k] -= matrix[k, j] * right[j]
        right[k] /= matrix[k, k]
    return True


@compiled
def solve(elements: Elements, step: Step) -> int:
    """Find the forces at the end of a step by Newton's method with a line search.

    With ``w = -H g`` the guessed forces g are right where ``f(w) = g``. That is the minimum of a potential,
    convex unless an element pushes away, whose slope along a direction e is ``-(f - g)ᵀ H e``. Newton's
    direction leads downhill, and where its full length overshoots (a stop is met, friction turns round) the
    slope's zero on the way is bracketed. So an iteration cannot jump to and fro, not even across the
    kinks of several elements.

    Returns
    -------
    int
        -1 if converged, otherwise the element that is farthest from it.
    """
    guess = step.guess
    r = guess.size
    guess[:] = step.f
    norm = evaluate(elements, step, guess)
    scale = 1e-300
    for i in range(r):
        rate = abs(step.v_lin[i]) / elements.rate
        scale = max(scale, abs(step.d_lin[i]) + abs(step.d0[i]) + abs(step.w[i]) + rate)
    for _ in range(ITERATIONS):
        steepest = 0.0
        runaway = -1
        for i in range(r):
            steepness = step.slope[i] * elements.flexibility[i, i]
            steepest = max(steepest, abs(steepness))
            if steepness <= -1.0:
                runaway = i
        if norm <= (TOLERANCE + ROUNDING * steepest) * scale:
            # An element that pushes away harder than the inertia of a step holds back has left the motion
            # that goes on from the last step: this is a root of the algebra, not a motion.
            return runaway
        for i in range(r):
            for j in range(r):
                step.jacobian[i, j] = step.slope[i] * elements.flexibility[i, j]
            step.jacobian[i, i] += 1.0
            step.direction[i] = step.rest[i]
        if not eliminate(step.jacobian, step.direction):
            break
        begin = descent(step)
        low, high, share = 0.0, 1.0, 1.0
        at_low, at_high = begin, 0.0
        for _ in range(SEARCHES):
            for i in range(r):
                step.trial[i] = guess[i] + share * step.direction[i]
            new = evaluate(elements, step, step.trial)
            at = descent(step)
            if abs(at) <= 0.2 * abs(begin) or (share == 1.0 and at < 0.0):
                break
            if at < 0.0:
                low, at_low = share, at
            else:
                high, at_high = share, at
            # Between the zero of the chord and the middle: neither alone is quick for every law.
            share = 0.5 * (low - at_low * (high - low) / (at_high - at_low)) + 0.25 * (low + high)
        guess[:] = step.trial
        norm = new
    worst = 0
    for i in range(r):
        if not abs(step.moved[i]) <= abs(step.moved[worst]):
            worst = i
    return worst
