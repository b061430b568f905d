"""Time stepping: Newmark's average acceleration, with Newton to convergence at every step.

A step of length h from (x, v, a) at forces p, for ``M a + C v + K x + B f(Bᵀx, Bᵀv) = p``::

    x' = x + h v + h²/4 a + h²/4 a'        v' = v + h/2 a + h/2 a'
    a' = E⁻¹ (p' - C (v + h/2 a) - K (x + h v + h²/4 a)) - E⁻¹ B f'        E = M + h/2 C + h²/4 K

Without ``f'`` that is a product with prepared matrices. The nonlinear elements only see their own relative
motion, so Newton runs on as many unknowns as there are elements, their forces::

    f' = f(d_linear + w, v_linear + 2/h w)        w = -H f'        H = h²/4 Bᵀ E⁻¹ B
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from creak.compiling import compiled
from creak.errors import SimulationError
from creak.mechanics import newton
from creak.mechanics.electronics import AT_REST
from creak.mechanics.newton import Elements, Step
from creak.mechanics.system import System
from creak.records import Hold, Real

CONVERGED: Final = 0
NOT_CONVERGED: Final = 1
GROWN: Final = 2

BOUND: Final = 1e6  # m; a structure that moves a thousand kilometres is none
MOST_SUBSTEPS: Final = 64
QUIET_DB: Final = -60.0  # noise level that time stepping is to undercut where there is no noise


class Scheme(NamedTuple):
    """One system at one step length, prepared; matrices are stored so that inner loops run along rows.

    Parameters
    ----------
    h : float
        Step, s.
    by_x, by_v : array, (dof, dof)
        Transposes of ``-E⁻¹ K`` and ``-E⁻¹ C``.
    by_u, by_f, by_jump : array, (q, dof), (r, dof), (q, dof)
        Transposes of ``E⁻¹`` times inputs, of ``E⁻¹ B``, and of ``M⁻¹`` times inputs.
    outputs : array, (n, dof)
    derivatives : array of int, (n,)
    elements : Elements
    """

    h: float
    by_x: Real
    by_v: Real
    by_u: Real
    by_f: Real
    by_jump: Real
    outputs: Real
    derivatives: NDArray[np.int64]
    elements: Elements


class State(NamedTuple):
    """Where the system is: coordinates and their derivatives, ``(dof,)``; the elements', ``(r,)``."""

    x: Real
    v: Real
    a: Real
    d: Real
    z: Real
    f: Real


@compiled
def _march(scheme: Scheme, state: State, drive: Real, jumps: Real, first: int, y: Real) -> tuple[int, int, int]:
    """Step through one period of samples.

    Parameters
    ----------
    scheme : Scheme
    state : State
        At the sample before `first`; it becomes that at the last sample.
    drive : array, (N, substeps, q)
        Inputs at the end of each sub-step; the last one of a sample lies on it.
    jumps : array, (N, q)
        Change of held inputs just after the sample before; empty if they do not jump.
    first : int
        Sample to begin with.
    y : array, (n, N)
        Filled with the responses from sample `first` on.

    Returns
    -------
    status, sample, element : int
    """
    h, by_x, by_v, by_u, by_f, by_jump, outputs, derivatives, elements = scheme
    x, v, a, d, z, f = state
    dof = x.size
    r = d.size
    quarter = 0.25 * h * h
    half = 0.5 * h
    xp = np.empty(dof)
    vp = np.empty(dof)
    an = np.empty(dof)
    spare = np.zeros((10, r))
    step = Step(
        d_lin=spare[0],
        v_lin=spare[1],
        d0=d,
        z0=z,
        f=f,
        w=spare[2],
        z=spare[3],
        guess=spare[4],
        trial=spare[5],
        direction=spare[6],
        slope=spare[7],
        rest=spare[8],
        moved=spare[9],
        jacobian=np.zeros((r, r)),
    )
    for n in range(first, drive.shape[0]):
        if jumps.size:
            for j in range(by_jump.shape[0]):
                for i in range(dof):
                    a[i] += by_jump[j, i] * jumps[n, j]
        for s in range(drive.shape[1]):
            for i in range(dof):
                xp[i] = x[i] + h * v[i] + quarter * a[i]
                vp[i] = v[i] + half * a[i]
                an[i] = 0.0
            for j in range(dof):
                for i in range(dof):
                    an[i] += by_x[j, i] * xp[j] + by_v[j, i] * vp[j]
            for j in range(by_u.shape[0]):
                for i in range(dof):
                    an[i] += by_u[j, i] * drive[n, s, j]
            if r:
                for e in range(r):
                    step.d_lin[e] = 0.0
                    step.v_lin[e] = 0.0
                    for i in range(dof):
                        step.d_lin[e] += elements.incidence[e, i] * (xp[i] + quarter * an[i])
                        step.v_lin[e] += elements.incidence[e, i] * (vp[i] + half * an[i])
                worst = newton.solve(elements, step)
                if worst >= 0:
                    return NOT_CONVERGED, n, worst
                for e in range(r):
                    d[e] = step.d_lin[e] + step.w[e]
                    z[e] = step.z[e]
                    for i in range(dof):
                        an[i] -= by_f[e, i] * f[e]
            for i in range(dof):
                x[i] = xp[i] + quarter * an[i]
                v[i] = vp[i] + half * an[i]
                a[i] = an[i]
        bounded = True
        for i in range(dof):
            bounded = bounded and abs(x[i]) < BOUND
        if not bounded:
            worst = 0
            for e in range(r):
                if not abs(d[e]) <= abs(d[worst]):
                    worst = e
            return GROWN, n, worst
        for m in range(outputs.shape[0]):
            total = 0.0
            for i in range(dof):
                motion = x[i] if derivatives[m] == 0 else v[i] if derivatives[m] == 1 else a[i]
                total += outputs[m, i] * motion
            y[m, n] = total
    return CONVERGED, 0, 0


class Stepper:
    """Time stepping of one system at one step length.

    Parameters
    ----------
    system : System
    sample_rate : float
        Hz.
    substeps : int
        Steps a sample.
    hold : str
        What the inputs do between samples: ``band-limited`` (the trigonometric polynomial through a period's
        samples) or ``zero-order`` (held; a response that jumps with them is sampled just before the jump).
    """

    def __init__(self, system: System, sample_rate: float, substeps: int, hold: Hold) -> None:
        self.system = system
        self.sample_rate = sample_rate
        self.substeps = substeps
        self.hold = hold
        h = 1.0 / (sample_rate * substeps)
        effective = system.mass + h / 2 * system.damping + h**2 / 4 * system.stiffness
        columns = np.linalg.solve(
            effective,
            np.column_stack([-system.stiffness, -system.damping, system.inputs, system.incidence]),
        )
        dof, q = system.inputs.shape
        by_x, by_v, by_u, by_f = (
            np.ascontiguousarray(part.T) for part in np.split(columns, [dof, 2 * dof, 2 * dof + q], axis=1)
        )
        incidence = np.ascontiguousarray(system.incidence.T)
        elements = Elements(
            codes=np.array([element.law for element in system.elements], dtype=np.int64),
            constants=np.array([element.constants() for element in system.elements]).reshape(-1, 2),
            incidence=incidence,
            flexibility=np.ascontiguousarray(h**2 / 4 * incidence @ by_f.T),
            rate=2 / h,
        )
        self._scheme = Scheme(
            h=h,
            by_x=by_x,
            by_v=by_v,
            by_u=by_u,
            by_f=by_f,
            by_jump=np.ascontiguousarray(np.linalg.solve(system.mass, system.inputs).T),
            outputs=np.ascontiguousarray(system.outputs),
            derivatives=np.array(system.derivatives, dtype=np.int64),
            elements=elements,
        )

    def experiment(self, u: Real, periods: int) -> Iterator[Real]:
        """Simulate one experiment from rest, period by period.

        Parameters
        ----------
        u : array, (q, N)
            One period of the inputs, which repeats.
        periods : int

        Yields
        ------
        array, (n, N)
            Responses, without noise.

        Raises
        ------
        SimulationError
            If a step does not converge or the motion grows without bound; time and element are named.
        """
        system = self.system
        size = u.shape[-1]
        state = State(*np.zeros((3, len(system.mass))), *np.zeros((3, len(system.elements))))
        memories = [[AT_REST] * len(effects) for effects in system.actuators]
        past = np.zeros((len(u), 2))  # the last two samples before the period
        acting = np.empty_like(u)
        for period in range(periods):
            if period == 0 or any(memory != AT_REST for input_ in memories for memory in input_):
                acting = np.array(u, dtype=np.float64)
                for i, effects in enumerate(system.actuators):
                    for j, effect in enumerate(effects):
                        acting[i], memories[i][j] = effect.apply(acting[i], self.sample_rate, memories[i][j])
            drive, jumps = self._between_samples(acting, past)
            y = np.empty((len(system.outputs), size))
            if period == 0:
                y[:, 0] = self._begin(state, acting[:, 0] if self.hold == "band-limited" else past[:, 1])
            status, sample, element = _march(self._scheme, state, drive, jumps, int(period == 0), y)
            if status != CONVERGED:
                self._fail(status, (period * size + sample) / self.sample_rate, element)
            past = acting[:, -2:].copy()
            for m, sensors in enumerate(system.sensors):
                for sensor in sensors:
                    y[m], _ = sensor.apply(y[m], self.sample_rate)
            yield y

    def _begin(self, state: State, u: Real) -> Real:
        """Set acceleration and forces at rest under the first inputs ``(q,)``; return the responses ``(n,)``."""
        system = self.system
        state.f[:] = [element.over_period([0.0], [0.0])[0] for element in system.elements]
        state.a[:] = np.linalg.solve(system.mass, system.inputs @ u - system.incidence @ state.f)
        motion = np.array([state.x, state.v, state.a])[list(system.derivatives)]
        return np.asarray(np.sum(system.outputs * motion, axis=1))

    def _between_samples(self, u: Real, past: Real) -> tuple[Real, Real]:
        """Give inputs at the end of every sub-step, ``(N, substeps, q)``, and jumps after the sample before."""
        q, size = u.shape
        if self.hold == "zero-order":
            held = np.column_stack([past, u])[:, :-1]
            drive = np.repeat(held[:, 1:].T[:, None, :], self.substeps, axis=1)
            return drive, np.ascontiguousarray(np.diff(held).T)
        if self.substeps == 1:
            return np.ascontiguousarray(u.T)[:, None, :], np.empty((0, q))
        spectrum = np.fft.rfft(u) * self.substeps
        if size % 2 == 0:
            spectrum[:, -1] /= 2  # the Nyquist line of the samples is shared with its mirror image
        fine = np.fft.irfft(spectrum, n=size * self.substeps)
        fine = np.roll(fine, self.substeps - 1, axis=1)
        return np.ascontiguousarray(fine.T).reshape(size, self.substeps, q), np.empty((0, q))

    def _fail(self, status: int, time: float, element: int) -> None:
        where = f", {self.system.elements[element]}" if self.system.elements else ""
        what = "the time step does not converge" if status == NOT_CONVERGED else "the motion grows without bound"
        raise SimulationError(f"{what} at {time:.6g} s{where} ({self.substeps} steps a sample)")


@dataclass(frozen=True)
class Resolution:
    """Steps a sample, and the error of the responses that they leave, dB re each response at the worst node."""

    substeps: int
    error_db: float


def choose_substeps(
    system: System,
    sample_rate: float,
    hold: Hold,
    u: Real,
    periods: int,
    noise_db: float | None,
    stopped: Callable[[], bool] = lambda: False,
) -> Resolution | None:
    """Find the number of steps a sample whose error lies 10 dB below the noise.

    The method is of second order, so the error at step h is 4/3 of the difference to the result at h/2; it
    is taken over the last of the periods of one experiment, before sensor effects.

    Parameters
    ----------
    system : System
    sample_rate : float
        Hz.
    hold : str
    u : array, (q, N)
        One period of the inputs.
    periods : int
        Periods to simulate, at best the transient ones and one more.
    noise_db : float or None
        Noise relative to the responses, dB; None where there is none, then -60 dB stand in.
    stopped : callable
        Asked after every period whether to give up.

    Returns
    -------
    Resolution or None
        At most 64 steps a sample, also if their error is larger than asked for; None if stopped.

    Raises
    ------
    SimulationError
        As `Stepper.experiment`.
    """
    system = replace(system, sensors=())
    limit = (QUIET_DB if noise_db is None else noise_db) - 10.0
    substeps, coarse = 0, np.empty(0)
    while True:
        finer = max(1, 2 * substeps)
        fine = np.empty(0)
        for period in Stepper(system, sample_rate, finer, hold).experiment(u, periods):
            if stopped():
                return None
            fine = period
        if substeps:
            power = np.sum(fine**2, axis=1)
            error = 16 / 9 * np.sum((coarse - fine) ** 2, axis=1)
            moving = power > 0
            error_db = 10 * math.log10(float(np.max(error[moving] / power[moving], initial=1e-30)))
            if error_db <= limit or finer > MOST_SUBSTEPS:
                return Resolution(substeps, error_db)
        substeps, coarse = finer, fine
