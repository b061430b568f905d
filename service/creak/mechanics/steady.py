"""Steady state under periodic inputs, solved for instead of waited for: exact in frequency, all harmonics kept.

The structure acts line by line, ``Y = S U - S B F``; the nonlinear elements act sample by sample on their own
relative motion, which `harmonic` solves for. Nothing is stepped, so there is neither a transient nor the
period error of a time step; what is left is the folding of harmonics above half the sample rate, and for that
the samples are refined until the forces' folded part no longer counts.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from creak.errors import SimulationError
from creak.mechanics import harmonic
from creak.mechanics.electronics import AT_REST
from creak.mechanics.newmark import Stepper
from creak.mechanics.periodic import (
    LinearPart,
    check_stability,
    finer,
    line_grid,
    linear_part,
    resampled,
    samples_of,
)
from creak.mechanics.system import System
from creak.mechanics.tangents import force_change
from creak.records import Complex, Hold, Real

TOLERANCE: Final = 1e-9
FOLDED: Final = 3e-5  # of an element's motion: what folded harmonics may make of it (-90 dB)
MOST_SAMPLES: Final = 32768  # a period: no finer, but for periods that have more to begin with
WAITED: Final = 40  # periods of time stepping that give a last initial guess
GIVEN_UP: Final = 2  # experiments that do not settle, after which no other is tried further
PASSES: Final = 100  # periods within which an actuator's memory repeats itself

# An iterate may run away; it is then found not to be finite.
_UNHEEDED: Final = partial(np.errstate, over="ignore", invalid="ignore", divide="ignore")

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Each(Protocol):
    """Applies a function to every item and gives the results in their order, as `map` and a pool's `map` do."""

    def __call__(self, function: Callable[[_Item], _Result], items: Iterable[_Item], /) -> Iterable[_Result]:
        """Apply."""
        ...


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
    each: Each = map,
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
    each : callable
        What experiments are solved by: `map`, one after the other, or the ``map`` of a pool of threads, whose
        number changes no bit of the result.

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
    acting = acting_inputs(system, u, sample_rate)
    if not system.elements:
        check_stability(system)
        y = samples_of(linear_part(system, acting, sample_rate, hold).y, u.shape[-1])
        none = np.zeros((len(u), 0, u.shape[-1]))
        done = np.zeros(len(u), dtype=np.int64), np.zeros(len(u)), np.ones(len(u), dtype=bool)
        return SteadyState(measured(system, y, sample_rate), none, none, *done, 1, 0.0)
    factor = oversampling or 1
    iterations = np.zeros(len(u), dtype=np.int64)
    while True:
        solved = _solve(system, acting, sample_rate, hold, factor, guess, tolerance, stopped, each)
        iterations += solved.iterations
        solved = replace(solved, iterations=iterations.copy())
        finer = 2 * factor
        enough = solved.folded <= FOLDED or finer * u.shape[-1] > MOST_SAMPLES
        if oversampling is not None or enough or not solved.settled or stopped():
            return replace(solved, y=measured(system, solved.y[..., ::factor], sample_rate))
        factor, guess = finer, solved.motion


def acting_inputs(system: System, u: Real, sample_rate: float) -> Real:
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


def measured(system: System, y: Real, sample_rate: float) -> Real:
    """Responses after the sensors' effects."""
    out = np.array(y)
    for m, effects in enumerate(system.sensors):
        for effect in effects:
            for experiment in out:
                experiment[m], _ = effect.apply(experiment[m], sample_rate)
    return out


def _solve(
    system: System,
    acting: Real,
    sample_rate: float,
    hold: Hold,
    factor: int,
    guess: Real | None,
    tolerance: float,
    stopped: Callable[[], bool],
    each: Each,
) -> SteadyState:
    """Solve at one refinement; responses at the refined samples, without sensors' effects."""
    size = acting.shape[-1] * factor
    fine = resampled(acting, size) if hold == "band-limited" else np.repeat(acting, factor, axis=-1)
    rate = sample_rate * factor
    linear = linear_part(system, fine, rate, hold)
    problem = harmonic.Problem(
        system.elements, size, linear.receptance, line_grid(size, rate)[1], linear.D, linear.rate
    )
    coarse = problem.coarser()
    rough = coarse or problem
    begin = None if guess is None else problem.lines(resampled(np.asarray(guess), size))
    with _UNHEEDED():
        k, c = harmonic.linearised(rough, None if begin is None else begin[..., : rough.size // 2 + 1])
        map_ = harmonic.equivalent(problem, k, c)
        coarse_map = None if coarse is None else harmonic.equivalent(coarse, k, c)
    D = np.array(map_.motion if begin is None else begin)
    experiments = range(len(D))
    residual, iterations = np.empty(len(D)), np.empty(len(D), dtype=np.int64)

    def fixed_point(e: int) -> tuple[Complex, float, int]:
        start, before = D[e], 0
        with _UNHEEDED():
            if coarse is not None and coarse_map is not None:
                L = coarse.size // 2 + 1
                lines, rest, before = harmonic.fixed_point(coarse, coarse_map, start[:, :L], e, tolerance)
                if rest <= tolerance:
                    start = np.concatenate([lines, start[:, L:]], axis=1)
            lines, rest, steps = harmonic.fixed_point(problem, map_, start, e, tolerance)
        return lines, rest, before + steps

    def newton(e: int, start: Complex) -> None:
        with _UNHEEDED():
            D[e], residual[e], steps = harmonic.newton(problem, map_, start, e, tolerance)
        iterations[e] += steps

    def newton_from_stepping(e: int) -> None:
        waited = _waited(system, acting[e], sample_rate, hold, stopped)
        if waited is not None:
            newton(e, problem.lines(resampled(waited, size)))

    for e, (lines, rest, steps) in zip(experiments, each(fixed_point, experiments), strict=True):
        D[e], residual[e], iterations[e] = lines, rest, steps
    failed = 0
    for e in np.flatnonzero(~(residual <= tolerance)).tolist():
        # Where a few do not settle, the others are not worth the wait: the result says so in any case.
        if failed >= GIVEN_UP or stopped():
            break
        newton(e, D[e])
        if not residual[e] <= tolerance:
            newton_from_stepping(e)
            failed += int(not residual[e] <= tolerance)

    def finish(e: int) -> _Finished:
        with _UNHEEDED():
            return _finish(problem, map_, linear, D[e], e)

    finished = list(each(finish, experiments))
    for e in experiments:
        if finished[e].pushed_away:
            # An unstable motion satisfies the equations too; what time stepping from rest comes to counts.
            residual[e] = np.inf
            newton_from_stepping(e)
            finished[e] = finish(e)
            if not residual[e] <= tolerance:
                break
    return SteadyState(
        np.array([part.y for part in finished]),
        np.array([part.motion for part in finished]),
        np.array([part.force for part in finished]),
        iterations,
        residual,
        np.asarray(residual <= tolerance),
        factor,
        max((part.folded for part in finished), default=0.0),
    )


class _Finished(NamedTuple):
    """What follows from the motion of the elements in one experiment."""

    y: Real
    motion: Real
    force: Real
    folded: float
    pushed_away: bool


def _finish(
    problem: harmonic.Problem, map_: harmonic.Equivalent, linear: LinearPart, D: Complex, e: int
) -> _Finished:
    d, v = problem.seen(D, e)
    f = problem.forces(d, v)
    F = problem.lines(f)
    y = samples_of(linear.y[e] - harmonic.apply(linear.response, map_.balanced(D, F, e)), problem.size)
    return _Finished(y, d, f, _folded(problem, map_, D, v, F), _pushed_away(problem, d, v, f))


def _pushed_away(problem: harmonic.Problem, d: Real, v: Real, f: Real) -> bool:
    """True if an element at some time pushes away harder than the structure holds it; all ``(r, N)``."""
    one, none = np.ones(problem.size), np.zeros(problem.size)
    for i, element in enumerate(problem.elements):
        held = problem.receptance[0, i, i].real
        slope = force_change(element.law, *element.constants(), d[i], v[i], f[i], one, none)
        if float(slope.min()) * held < -1.0:
            return True
    return False


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


def _folded(problem: harmonic.Problem, map_: harmonic.Equivalent, D: Complex, velocity: Real, F: Complex) -> float:
    """Estimate what harmonics of the forces above the highest line, folded below it, make of one experiment."""
    size = problem.size
    fine = samples_of(finer(D, size), 2 * size)
    force = problem.forces(fine, resampled(velocity, 2 * size) if problem.of_velocity else fine)
    folded = F - scipy.fft.rfft(force, norm="forward")[..., : size // 2 + 1]
    if size % 2 == 0:
        folded[..., -1] = 0.0
    return harmonic.distance(harmonic.apply(map_.forced, folded), D)
