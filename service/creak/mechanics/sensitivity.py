"""Derivatives of a steady state to parameters, from one linear problem a parameter and none solved anew.

At the solved motion D the equations ``G(D, p) = D - D_lin(p) + H(p) F(D, p) = 0`` are differenced with the motion
held, which costs an evaluation of the laws and is exact also for laws with corners. The change of the motion
follows from the tangent, ``(I + H J) dD = -dG``, that of the responses from both.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from creak.mechanics import harmonic
from creak.mechanics.electronics import SensorQuantisation
from creak.mechanics.measured import MeasuredSystem
from creak.mechanics.periodic import LinearPart, line_grid, linear_part, resampled, samples_of
from creak.mechanics.steady import SteadyState, acting_inputs, measured
from creak.mechanics.system import System
from creak.mechanics.tangents import force_change
from creak.records import Complex, Hold, Real

ACCURACY = 1e-4  # of a solved tangent: a Gauss-Newton step needs no more
MOST_PRODUCTS = 60


@dataclass(frozen=True)
class Neighbours:
    """Two systems on either side of one, and how far apart they lie in the parameter."""

    plus: System
    minus: System
    width: float


def sensitivities(
    system: System,
    steady: SteadyState,
    u: Real,
    sample_rate: float,
    hold: Hold,
    neighbours: Sequence[Neighbours],
    oversampling: int | None = None,
) -> Iterator[Real]:
    """Derivatives of the recorded responses, a parameter at a time.

    Parameters
    ----------
    system : System
    steady : SteadyState
        Solved for it.
    u : array, (E, q, N)
    sample_rate : float
        Hz.
    hold : str
    neighbours : sequence of Neighbours
        One for every parameter; their elements are those of the system, in its order.
    oversampling : int, optional
        Samples of the elements a sample of the rig; by default those of the steady state.

    Yields
    ------
    array, (E, n, N)
        Derivative of the responses. A quantised response is taken before its rounding.
    """
    factor = min(oversampling or steady.oversampling, steady.oversampling)
    size = u.shape[-1] * factor
    fine, base = _linear_part(system, u, sample_rate, hold, factor)
    tangent = _Tangent(system, base, resampled(steady.motion, size), line_grid(size, sample_rate * factor)[1])
    samples = None
    if any(system.sensors):
        samples = samples_of(base.y - harmonic.apply(base.response, tangent.F), size)[..., ::factor]
    moved = _Moved(system, fine, tangent.F, sample_rate * factor, hold)
    for pair in neighbours:
        ends = pair.plus, pair.minus
        if all(_same_coordinates(end, system) for end in ends):
            change, rest = moved.by_matrices(pair)
            parts = [base, base]
        else:
            parts = [_linear_part(end, u, sample_rate, hold, factor)[1] for end in ends]
            change = (parts[0].y - parts[1].y) / pair.width
            rest = (parts[0].D - parts[1].D) / pair.width
        if parts[0] is not base or any(end.elements != system.elements for end in ends):
            for end, own, share in zip(ends, parts, (1 / pair.width, -1 / pair.width), strict=True):
                F = tangent.forces_of(end, own)
                change = change - share * harmonic.apply(own.response, F)
                rest = rest - share * harmonic.apply(own.receptance, F)
        if system.elements and np.any(rest):
            change = change - harmonic.apply(base.response, tangent.force_change(tangent.solve(rest)))
        y = samples_of(change, size)[..., ::factor]
        if samples is not None:
            half = 0.5 * pair.width
            plus, minus = (
                measured(_unrounded(end), samples + sign * half * y, sample_rate)
                for end, sign in zip(ends, (1.0, -1.0), strict=True)
            )
            y = (plus - minus) / pair.width
        yield y


def _unrounded(system: System) -> System:
    if not any(isinstance(effect, SensorQuantisation) for chain in system.sensors for effect in chain):
        return system
    kept = tuple(tuple(e for e in chain if not isinstance(e, SensorQuantisation)) for chain in system.sensors)
    return replace(system, sensors=kept)


def _same_coordinates(one: System, other: System) -> bool:
    """Whether two systems differ in their matrices and elements at most."""
    if isinstance(one, MeasuredSystem):  # it has no matrices, so what hangs on it must be the same
        return one.actuators == other.actuators and (
            isinstance(other, MeasuredSystem) and [e for _, e in one.linear] == [e for _, e in other.linear]
        )
    return one.actuators == other.actuators and all(
        np.array_equal(getattr(one, name), getattr(other, name)) for name in ("inputs", "outputs", "incidence")
    )


class _Moved:
    """Motion of all coordinates, and how it follows a change of the matrices."""

    def __init__(self, system: System, fine: Real, F: Complex, sample_rate: float, hold: Hold) -> None:
        size = fine.shape[-1]
        frequencies, _ = line_grid(size, sample_rate)
        self.system = system
        self.s: Complex = np.asarray(2j * np.pi * frequencies, dtype=np.complex128)
        self.inverse = system.motion(frequencies, np.eye(len(system.inputs)))
        U = np.fft.rfft(fine, norm="forward")
        if hold == "zero-order":
            half = np.pi * np.arange(U.shape[-1]) / size
            U = U * np.exp(-1j * half) * np.sinc(half / np.pi)
        self.x = harmonic.apply(self.inverse @ system.inputs, U)
        self.x -= harmonic.apply(self.inverse @ system.incidence, F)

    def by_matrices(self, pair: Neighbours) -> tuple[Complex, Complex]:
        """Change of the responses and of the elements' displacements, their forces held, ``(E, n or r, L)``."""
        system, s = self.system, self.s
        force = np.zeros(self.x.shape, dtype=np.complex128)
        for order, name in enumerate(("stiffness", "damping", "mass")):
            matrix = getattr(pair.plus, name) - getattr(pair.minus, name)
            if np.any(matrix):
                force -= (matrix / pair.width) @ (s**order * self.x)
        if np.any(force):
            force = harmonic.apply(self.inverse, force)
        seen = s ** np.array(system.derivatives)[:, None] * (system.outputs @ force)
        return np.asarray(seen), np.asarray(system.incidence.T @ force)


def _linear_part(system: System, u: Real, sample_rate: float, hold: Hold, factor: int) -> tuple[Real, LinearPart]:
    """Inputs as they act at the elements' samples, and what the linear part makes of them."""
    acting = acting_inputs(system, u, sample_rate)
    fine = (
        resampled(acting, u.shape[-1] * factor) if hold == "band-limited" else np.repeat(acting, factor, axis=-1)
    )
    return fine, linear_part(system, fine, sample_rate * factor, hold)


class _Tangent:
    """The elements along the solved motion: their forces, and how these follow a change of the motion."""

    def __init__(self, system: System, base: LinearPart, motion: Real, jw: Complex) -> None:
        self.system, self.base = system, base
        self.problem = harmonic.Problem(system.elements, motion.shape[-1], base.receptance, jw, base.D, base.rate)
        self.D = self.problem.lines(motion)
        self.d, self.v = self.problem.motion(self.D)
        self.f = self.problem.forces(self.d, self.v)
        self.F = self.problem.lines(self.f)
        if not system.elements:
            return
        self.map = harmonic.equivalent(self.problem, *harmonic.fitted(self.problem, self.D))
        self.scale = np.maximum(np.sqrt(np.mean(self.d**2, axis=(0, 2))), 1e-300)[:, None]

    def forces_of(self, system: System, linear: LinearPart) -> Complex:
        """Lines of a neighbour's forces along the same motion."""
        v = self.v
        if linear.rate is not None and self.base.rate is not None and linear is not self.base:
            v = v + linear.rate - self.base.rate
        return self.problem.lines(replace(self.problem, elements=system.elements).forces(self.d, v))

    def force_change(self, change: Complex) -> Complex:
        """Lines of the forces' change under a change of the motion, ``(E, r, L)`` both."""
        dd, dv = self.problem.samples(change), self.problem.samples(self.problem.jw * change)
        df = np.empty_like(dd)
        for i, element in enumerate(self.system.elements):
            for e in range(len(df)):
                df[e, i] = force_change(
                    element.law, *element.constants(), self.d[e, i], self.v[e, i], self.f[e, i], dd[e, i], dv[e, i]
                )
        return self.problem.lines(df)

    def solve(self, rest: Complex) -> Complex:
        """Change of the motion with ``(I + H J) dD = rest``, all experiments together."""
        shape = rest.shape

        def product(rows: Real) -> Real:
            change = rows.view(np.complex128).reshape(shape) * self.scale
            law = self.map.law.T
            image = change + harmonic.apply(self.map.forced, self.force_change(change) - law * change)
            return np.ascontiguousarray(image / self.scale).reshape(len(rows), -1).view(np.float64)

        # P rest = rest - P H K_eq rest
        right = rest - harmonic.apply(self.map.forced, self.map.law.T * rest)
        right = np.ascontiguousarray(right / self.scale)
        solved = solve_rows(product, right.reshape(len(rest), -1).view(np.float64), ACCURACY, MOST_PRODUCTS)
        return np.asarray(np.ascontiguousarray(solved).view(np.complex128).reshape(shape) * self.scale)


def solve_rows(product: Callable[[Real], Real], right: Real, accuracy: float, most: int) -> Real:
    """Generalised minimal residuals for many independent systems at once, a row each.

    Parameters
    ----------
    product : callable
        Rows ``(R, X)`` times their matrices.
    right : array, (R, X)
    accuracy : float
        Of the residual, relative to the right side.
    most : int
        Products.

    Returns
    -------
    array, (R, X)
    """
    size = np.linalg.norm(right, axis=1)
    basis = [right / np.maximum(size, 1e-300)[:, None]]
    upper = np.zeros((len(right), most + 1, most))
    weights = np.zeros((len(right), 0))
    for j in range(most):
        new = product(basis[j])
        for i, q in enumerate(basis):
            upper[:, i, j] = np.einsum("rx,rx->r", q, new)
            new -= upper[:, i, j, None] * q
        length = np.linalg.norm(new, axis=1)
        upper[:, j + 1, j] = length
        basis.append(new / np.maximum(length, 1e-300)[:, None])
        head = upper[:, : j + 2, : j + 1]
        first = np.zeros((len(right), j + 2, 1))
        first[:, 0, 0] = size
        weights = (np.linalg.pinv(head) @ first)[..., 0]
        rest = np.linalg.norm(first[..., 0] - np.einsum("rij,rj->ri", head, weights), axis=1)
        if np.all(rest <= accuracy * size):
            break
    return np.asarray(np.einsum("rj,jrx->rx", weights, np.stack(basis[: weights.shape[1]])))
