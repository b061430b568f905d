"""Steady state under periodic inputs, solved for instead of waited for: exact in frequency, all harmonics kept.

The structure acts line by line, ``Y = S U - S B F``; the nonlinear elements act sample by sample on their own
relative motion, which `harmonic` solves for. Nothing is stepped, so there is neither a transient nor the
period error of a time step; what is left is the folding of harmonics above half the sample rate, and for that
the samples are refined until the forces' folded part no longer counts.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from creak.errors import SimulationError
from creak.mechanics import harmonic
from creak.mechanics.electronics import AT_REST
from creak.mechanics.newmark import Stepper
from creak.mechanics.system import System
from creak.mechanics.tangents import force_change
from creak.records import Complex, Hold, Real

TOLERANCE: Final = 1e-9
FOLDED: Final = 3e-5  # of an element's motion: what folded harmonics may make of it (-90 dB)
MOST_SAMPLES: Final = 32768  # a period: no finer, but for periods that have more to begin with
WAITED: Final = 40  # periods of time stepping that give a last initial guess
GIVEN_UP: Final = 2  # experiments that do not settle, after which no other is tried further
PASSES: Final = 100  # periods within which an actuator's memory repeats itself


@dataclass(frozen=True, eq=False)
class SteadyState:
    """Responses in steady state.

    Parameters
    ----------
    y : array, (E, n, N)
        One period of the responses as they are recorded, without noise.
    motion, force : array, (E, r, oversampling N)
        Relative displacements of the nonlinear elements and their forces, m and N.
    iterations : array of int, (E,)
        Evaluations of the elements, at all refinements.
    residual : array, (E,)
        RMS by which the elements' motion still disagrees, relative to that motion.
    converged : array of bool, (E,)
        Whether the residual fell below the tolerance; if not, ``y`` is no steady state.
    oversampling : int
        Samples of the elements a sample of the rig.
    folded : float
        What folded harmonics make of the elements' motion, relative to it, estimated.
    """

    y: Real
    motion: Real
    force: Real
    iterations: NDArray[np.int64]
    residual: Real
    converged: NDArray[np.bool_]
    oversampling: int
    folded: float

    @property
    def settled(self) -> bool:
        """True if all experiments converged."""
        return bool(np.all(self.converged))


def simulate_steady(
    system: System,
    u: Real,
    sample_rate: float,
    hold: Hold,
    *,
    guess: Real | None = None,
    oversampling: int | None = None,
    tolerance: float = TOLERANCE,
    stopped: Callable[[], bool] = lambda: False,
) -> SteadyState:
    """Solve for the periodic responses of a system to periodic inputs.

    Parameters
    ----------
    system : System
    u : array, (E, q, N)
        One period of the inputs of every experiment.
    sample_rate : float
        Hz.
    hold : str
        What the inputs do between samples, as for `newmark.Stepper`.
    guess : array, (E, r, any number of samples), optional
        Relative displacements to begin with, for instance those of a similar system or measured ones.
    oversampling : int, optional
        Samples of the elements a sample of the rig; by default as many as bring the folded harmonics below
        3e-5 of the motion, at most 32768 a period. Give it where results are to be compared closely.
    tolerance : float
        For the residual.
    stopped : callable
        Asked between experiments whether to give up; what has not converged then counts as such.

    Returns
    -------
    SteadyState
        Also where experiments did not converge: they are marked. The work is bounded: a fixed point of 60
        iterations, 40 Newton steps, and 40 periods of time stepping as another guess for those.

    Raises
    ------
    SimulationError
        If a system without nonlinear elements is unstable, so that it has no steady state.

    Notes
    -----
    With nonlinear elements several periodic motions may exist. The solver begins at the equivalent linear
    system, or at the guess; where an element at some time pushes away harder than the structure holds it, it
    begins at the motion that time stepping from rest comes to.
    """
    u = np.asarray(u, dtype=np.float64)
    acting = _acting(system, u, sample_rate)
    if not system.elements:
        check_stability(system)
        y = _samples(_linear_part(system, acting, sample_rate, hold)[0], u.shape[-1])
        none = np.zeros((len(u), 0, u.shape[-1]))
        done = np.zeros(len(u), dtype=np.int64), np.zeros(len(u)), np.ones(len(u), dtype=bool)
        return SteadyState(_measured(system, y, sample_rate), none, none, *done, 1, 0.0)
    factor = oversampling or 1
    iterations = np.zeros(len(u), dtype=np.int64)
    while True:
        solved = _solve(system, acting, sample_rate, hold, factor, guess, tolerance, stopped)
        iterations += solved.iterations
        solved = replace(solved, iterations=iterations.copy())
        finer = 2 * factor
        enough = solved.folded <= FOLDED or finer * u.shape[-1] > MOST_SAMPLES
        if oversampling is not None or enough or not solved.settled or stopped():
            return replace(solved, y=_measured(system, solved.y[..., ::factor], sample_rate))
        factor, guess = finer, solved.motion


def check_stability(system: System) -> None:
    """Refuse a system whose linear part has a growing motion.

    Raises
    ------
    SimulationError
        Frequency and growth of the fastest growing motion are named.
    """
    states, _ = _state_space(system)
    poles = np.linalg.eigvals(states)
    worst = poles[np.argmax(poles.real)]
    # A free structure drifts: a double pole at 0, which rounding splits by the root of its precision.
    if worst.real > 1e-6 * np.max(np.abs(poles)):
        raise SimulationError(
            f"the structure is unstable: a motion at {abs(worst.imag) / (2 * np.pi):.4g} Hz grows by a factor "
            f"of {np.exp(min(worst.real, 700.0)):.4g} a second"
        )


def resampled(samples: Real, size: int) -> Real:
    """Trigonometric polynomial through periodic samples, at another number of them; time runs last."""
    old = samples.shape[-1]
    if old == size:
        return samples
    lines = np.fft.rfft(samples) / old
    kept = min(old, size) // 2 + 1
    out = np.zeros((*samples.shape[:-1], size // 2 + 1), dtype=np.complex128)
    out[..., :kept] = lines[..., :kept]
    if min(old, size) % 2 == 0:
        out[..., kept - 1] *= 0.5 if old < size else 2.0  # a Nyquist line is shared with its mirror image
    return np.asarray(np.fft.irfft(out * size, n=size))


def _acting(system: System, u: Real, sample_rate: float) -> Real:
    """Inputs after the actuators' effects, their memory in steady state."""
    out = np.array(u)
    for i, effects in enumerate(system.actuators):
        for effect in effects:
            for experiment in out:
                samples, memory = effect.apply(experiment[i], sample_rate, AT_REST)
                for _ in range(PASSES if memory != AT_REST else 0):
                    before = samples
                    samples, memory = effect.apply(experiment[i], sample_rate, memory)
                    if np.abs(samples - before).max() <= 1e-13 * np.abs(samples).max():
                        break
                experiment[i] = samples
    return out


def _measured(system: System, y: Real, sample_rate: float) -> Real:
    """Responses after the sensors' effects."""
    out = np.array(y)
    for m, effects in enumerate(system.sensors):
        for effect in effects:
            for experiment in out:
                experiment[m], _ = effect.apply(experiment[m], sample_rate)
    return out


def _samples(lines: Complex, size: int) -> Real:
    return np.asarray(np.fft.irfft(lines * size, n=size))


def _lines(size: int, sample_rate: float) -> tuple[Real, Complex]:
    """Frequencies of all lines, Hz, and the factor of differentiation there."""
    frequencies = np.asarray(np.arange(size // 2 + 1) * (sample_rate / size), dtype=np.float64)
    jw = np.asarray(2j * np.pi * frequencies, dtype=np.complex128)
    if size % 2 == 0:
        jw[-1] = 0.0
    return frequencies, jw


def _state_space(system: System) -> tuple[Real, Real]:
    dof = len(system.mass)
    below = np.linalg.solve(system.mass, np.hstack([-system.stiffness, -system.damping, system.inputs]))
    states = np.vstack([np.eye(dof, 2 * dof, dof), below[:, : 2 * dof]])
    return states, np.vstack([np.zeros_like(system.inputs), below[:, 2 * dof :]])


def _linear_part(system: System, acting: Real, sample_rate: float, hold: Hold) -> tuple[Complex, Complex, Complex]:
    """Lines of responses, elements' displacements and their velocities without the elements' forces."""
    size = acting.shape[-1]
    U = np.fft.rfft(acting) / size
    frequencies, jw = _lines(size, sample_rate)
    if hold == "band-limited":
        motion = np.einsum("lij,ejl->eil", system.motion(frequencies, system.inputs), U)
        parts = motion, 2j * np.pi * frequencies * motion, (2j * np.pi * frequencies) ** 2 * motion
    else:
        parts = _held(system, U, frequencies, sample_rate)
    y = np.stack([system.outputs[m] @ parts[order] for m, order in enumerate(system.derivatives)], axis=1)
    D, V = (system.incidence.T @ part for part in parts[:2])
    if hold == "band-limited":
        V = jw * D
    return y, D, V


def _held(system: System, U: Complex, frequencies: Real, sample_rate: float) -> tuple[Complex, Complex, Complex]:
    """Displacement, velocity, acceleration at the samples under held inputs, exactly; before they jump."""
    dof, q = system.inputs.shape
    states, inputs = _state_space(system)
    whole = np.zeros((2 * dof + q, 2 * dof + q))
    whole[: 2 * dof] = np.hstack([states, inputs])
    step = expm(whole / sample_rate)
    z = np.exp(2j * np.pi * frequencies / sample_rate)
    moved = z[:, None, None] * np.eye(2 * dof) - step[: 2 * dof, : 2 * dof]
    if np.linalg.cond(moved[0].real) > 1e14:
        moved[0] += 1e-12 * np.eye(2 * dof)  # a free structure has no static response
    state = np.einsum("lij,ejl->eil", np.linalg.solve(moved, step[: 2 * dof, 2 * dof :]), U)
    rate = states[dof:] @ state + inputs[dof:] @ (U / z)
    return state[:, :dof], state[:, dof:], rate


def _solve(
    system: System,
    acting: Real,
    sample_rate: float,
    hold: Hold,
    factor: int,
    guess: Real | None,
    tolerance: float,
    stopped: Callable[[], bool],
) -> SteadyState:
    """Solve at one refinement; responses at the refined samples, without sensors' effects."""
    size = acting.shape[-1] * factor
    fine = resampled(acting, size) if hold == "band-limited" else np.repeat(acting, factor, axis=-1)
    rate = sample_rate * factor
    frequencies, jw = _lines(size, rate)
    y, D, V = _linear_part(system, fine, rate, hold)
    receptance = system.incidence.T @ system.motion(frequencies, system.incidence)
    problem = harmonic.Problem(system.elements, receptance, jw, D, _samples(V - jw * D, size))
    begin = None if guess is None else problem.lines(resampled(np.asarray(guess), size))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        D, map_ = harmonic.linearised(problem, begin)
        D, residual, steps = harmonic.fixed_point(problem, map_, D, tolerance)
        iterations = np.full(len(D), steps)
        failed = 0
        for e in np.flatnonzero(~(residual <= tolerance)):
            # Where a few do not settle, the others are not worth the wait: the result says so in any case.
            if failed >= GIVEN_UP or stopped():
                break
            D[e], residual[e], steps = harmonic.newton(problem, map_, D[e], int(e), tolerance)
            iterations[e] += steps
            if residual[e] <= tolerance:
                continue
            waited = _waited(system, acting[e], sample_rate, hold, stopped)
            if waited is not None:
                start = problem.lines(resampled(waited, size))
                D[e], residual[e], steps = harmonic.newton(problem, map_, start, int(e), tolerance)
                iterations[e] += steps
            failed += int(not residual[e] <= tolerance)
        for e in np.flatnonzero(_pushed_away(problem, D)):
            # An unstable motion satisfies the equations too; what time stepping from rest comes to counts.
            waited = _waited(system, acting[e], sample_rate, hold, stopped)
            residual[e] = np.inf
            if waited is not None:
                start = problem.lines(resampled(waited, size))
                D[e], residual[e], steps = harmonic.newton(problem, map_, start, int(e), tolerance)
                iterations[e] += steps
            if not residual[e] <= tolerance:
                break
        motion, velocity = problem.motion(D)
        force = problem.forces(motion, velocity)
        F = problem.lines(force)
        y = y - np.einsum("lij,ejl->eil", system.receptance(frequencies, system.incidence), F)
        return SteadyState(
            _samples(y, size),
            motion,
            force,
            iterations,
            residual,
            np.asarray(residual <= tolerance),
            factor,
            _folded(problem, map_, motion, velocity, F),
        )


def _pushed_away(problem: harmonic.Problem, D: Complex) -> NDArray[np.bool_]:
    """Experiments in which an element at some time pushes away harder than the structure holds it, ``(E,)``."""
    d, v = problem.motion(D)
    f = problem.forces(d, v)
    found = np.zeros(len(d), dtype=bool)
    for i, element in enumerate(problem.elements):
        held = problem.receptance[0, i, i].real
        one, none = np.ones(problem.size), np.zeros(problem.size)
        for e in range(len(d)):
            slope = force_change(element.law, *element.constants(), d[e, i], v[e, i], f[e, i], one, none)
            found[e] |= float(slope.min()) * held < -1.0
    return found


def _waited(
    system: System, acting: Real, sample_rate: float, hold: Hold, stopped: Callable[[], bool]
) -> Real | None:
    """Relative displacements after some periods of time stepping from rest; None where that fails."""
    r = len(system.elements)
    seen = replace(
        system,
        outputs=system.incidence.T,
        derivatives=(0,) * r,
        actuators=((),) * system.inputs.shape[1],
        sensors=((),) * r,
    )
    last = None
    try:
        for period in Stepper(seen, sample_rate, 1, hold).experiment(acting, WAITED):
            if stopped():
                return None
            last = period
    except SimulationError:
        return None
    return last


def _folded(
    problem: harmonic.Problem, map_: harmonic.Equivalent, motion: Real, velocity: Real, F: Complex
) -> float:
    """Estimate what the forces' harmonics above the highest line, folded below it, make of the motion."""
    size = problem.size
    fine = harmonic.Problem(
        problem.elements, problem.receptance, problem.jw, problem.linear, np.empty((1, 2 * size))
    )
    force = fine.forces(resampled(motion, 2 * size), resampled(velocity, 2 * size))
    folded = F - np.fft.rfft(force)[..., : size // 2 + 1] / (2 * size)
    if size % 2 == 0:
        folded[..., -1] = 0.0
    moved = np.einsum("lij,ejl->eil", map_.forced, folded)
    return float(np.max(harmonic.distance(problem, moved, problem.lines(motion)), initial=0.0))
