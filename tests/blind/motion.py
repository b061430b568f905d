"""Equations of motion of the blind cases and their integration: nothing here comes from the service.

``a = by_x x + by_v v + by_u u - by_f f`` with forces f of elements between points, by Runge and Kutta's classical
rule of fourth order at steps far finer than the samples, until a period repeats the one before. The laws are
written anew from the table of effects, and beside them stand laws that the table does not have.
"""

import math

import numba
import numpy as np
from scipy.signal import cont2discrete

LAWS = (
    "cubic_stiffness",
    "quadratic_stiffness",
    "clearance",
    "one_sided_stop",
    "coulomb_friction",
    "quadratic_damping",
    "hysteresis",
    "tanh_spring",
    "magnetic_detent",
    "nonlinear_inertia",
    "velocity_stiffness",
)
OUTSIDE = LAWS[7:]
"""Laws that the vocabulary lacks."""


@numba.njit(cache=True, nogil=True)
def element_force(law, a, b, d, v, z):
    """Force of every law but the inertia's, from displacement, velocity and memory."""
    if law == 0:
        return a * d**3
    if law == 1:
        return a * d**2
    if law == 2:
        return a * (max(d - b, 0.0) + min(d + b, 0.0))
    if law == 3:
        return a * max(d - b, 0.0)
    if law == 4:
        return a * math.tanh(v / b)
    if law == 5:
        return a * v * abs(v)
    if law == 6:
        return a * z
    if law == 7:
        return a * b * math.tanh(d / b)
    if law == 8:
        return a * math.sin(2.0 * math.pi * d / b)
    return a * d * abs(v) / b


@numba.njit(cache=True, nogil=True)
def rate(x, v, z, u, system, laws, constants, out_a, out_z):
    """Accelerations and rates of the memories."""
    by_x, by_v, by_u, by_f, incidence = system
    dof = x.size
    for i in range(dof):
        total = 0.0
        for j in range(dof):
            total += by_x[i, j] * x[j] + by_v[i, j] * v[j]
        for j in range(u.size):
            total += by_u[i, j] * u[j]
        out_a[i] = total
    inertia = -1
    for e in range(laws.size):
        d = 0.0
        s = 0.0
        for i in range(dof):
            d += incidence[e, i] * x[i]
            s += incidence[e, i] * v[i]
        if laws[e] == 9:
            inertia = e
            continue
        if laws[e] == 6:
            bound = constants[e, 1]
            out_z[e] = s * (1.0 - 0.5 * (1.0 + np.sign(s * z[e])) * (z[e] / bound) ** 2)
        f = element_force(laws[e], constants[e, 0], constants[e, 1], d, s, z[e])
        for i in range(dof):
            out_a[i] -= by_f[i, e] * f
    if inertia >= 0:  # m (d² a + d v²): the element's own acceleration depends on its force
        e = inertia
        d = 0.0
        s = 0.0
        acceleration = 0.0
        flexibility = 0.0
        for i in range(dof):
            d += incidence[e, i] * x[i]
            s += incidence[e, i] * v[i]
            acceleration += incidence[e, i] * out_a[i]
            flexibility += incidence[e, i] * by_f[i, e]
        m = constants[e, 0]
        f = m * (d * d * acceleration + d * s * s) / (1.0 + m * d * d * flexibility)
        for i in range(dof):
            out_a[i] -= by_f[i, e] * f


@numba.njit(cache=True, nogil=True)
def one_period(state, u, substeps, held, h, system, laws, constants, outputs, orders, y):
    """Step through a period from sample 0 to the next period's; y holds the samples 0 to N-1.

    u (2 substeps N, q) are the inputs at all half steps; held inputs stand still within a sample, and a
    response that jumps with them is taken just before: `state[3]` keeps the inputs of the sample before.
    """
    x, v, z, before = state
    dof, r = x.size, z.size
    a = np.empty((4, dof))
    w = np.empty((4, dof))
    c = np.zeros((4, r))
    xs = np.empty(dof)
    zs = np.empty(r)
    samples = u.shape[0] // (2 * substeps)
    for n in range(samples):
        first = 2 * substeps * n
        rate(x, v, z, before if held else u[first], system, laws, constants, a[0], c[0])
        for m in range(orders.size):
            total = 0.0
            for i in range(dof):
                total += outputs[m, i] * (x[i] if orders[m] == 0 else v[i] if orders[m] == 1 else a[0, i])
            y[m, n] = total
        for s in range(substeps):
            at = first + 2 * s
            for stage in range(4):
                move = 0.0 if stage == 0 else 0.5 * h if stage < 3 else h
                last = max(stage - 1, 0)
                for i in range(dof):
                    xs[i] = x[i] + move * w[last, i] if stage else x[i]
                    w[stage, i] = v[i] + move * a[last, i] if stage else v[i]
                for e in range(r):
                    zs[e] = z[e] + move * c[last, e] if stage else z[e]
                when = first if held else at + (0 if stage == 0 else 1 if stage < 3 else 2)
                rate(xs, w[stage], zs, u[when % u.shape[0]], system, laws, constants, a[stage], c[stage])
            for i in range(dof):
                x[i] += h / 6.0 * (w[0, i] + 2.0 * w[1, i] + 2.0 * w[2, i] + w[3, i])
                v[i] += h / 6.0 * (a[0, i] + 2.0 * a[1, i] + 2.0 * a[2, i] + a[3, i])
            for e in range(r):
                z[e] += h / 6.0 * (c[0, e] + 2.0 * c[1, e] + 2.0 * c[2, e] + c[3, e])
        for j in range(before.size):
            before[j] = u[first, j]


class NotPeriodicError(RuntimeError):
    """The motion does not come to repeat itself: such a case is drawn again."""


class Structure:
    """A linear structure with points, as matrices.

    Parameters
    ----------
    mass, damping, stiffness : array, (dof, dof)
    points : dict of name to row, (dof,)
    nodes : list of str
        Driven and measured, in this order.
    force_constant : float
        Newton per unit of input.
    """

    def __init__(self, mass, damping, stiffness, points, nodes, force_constant=1.0):
        self.mass, self.damping, self.stiffness = mass, damping, stiffness
        self.points = {**points, "ground": np.zeros(len(mass))}
        self.nodes = nodes
        self.force_constant = force_constant

    def row(self, at):
        """Relative displacement of a place as a row."""
        return self.points[at[0]] - (self.points[at[1]] if len(at) > 1 else 0.0)

    def rows(self):
        return np.array([self.points[name] for name in self.nodes])

    def poles(self):
        dof = len(self.mass)
        below = np.linalg.solve(self.mass, np.hstack([-self.stiffness, -self.damping]))
        return np.linalg.eigvals(np.vstack([np.eye(dof, 2 * dof, dof), below]))

    def linear(self, u, fs, order, held=False):
        """Steady responses of the structure alone, ``(E, n, N)``."""
        lines = np.fft.rfft(u)
        rows, size = self.rows(), u.shape[-1]
        drive = self.force_constant * np.array([self.points[name] for name in self.nodes]).T
        s = 2j * np.pi * np.fft.rfftfreq(size, 1 / fs)[:, None, None]
        if not held:
            x = np.linalg.solve(self.stiffness + s * self.damping + s**2 * self.mass, drive)
            return np.fft.irfft(np.einsum("fij,ejf->eif", s**order * (rows @ x), lines), n=size)
        dof = len(self.mass)
        below = np.linalg.solve(self.mass, np.hstack([-self.stiffness, -self.damping, drive]))
        A = np.vstack([np.eye(dof, 2 * dof, dof), below[:, : 2 * dof]])
        B = np.vstack([np.zeros_like(drive), below[:, 2 * dof :]])
        Ad, Bd, *_ = cont2discrete((A, B, np.eye(2 * dof), np.zeros_like(B)), 1 / fs)
        z = np.exp(s / fs)
        state = np.einsum("fij,ejf->eif", np.linalg.solve(z * np.eye(2 * dof) - Ad, Bd), lines)
        rates = A @ state + B @ (lines / z[:, 0, 0])
        motion = (state[:, :dof], state[:, dof:], rates[:, dof:])[order]
        return np.fft.irfft(rows @ motion, n=size)


def steady(structure, elements, u, fs, order, held=False, fineness=1, tolerance=1e-6, most=80):
    """Steady responses with nonlinear elements.

    Parameters
    ----------
    structure : Structure
    elements : list of (law name, place, two constants)
    u : array, (E, n, N)
        One period of the inputs as they act.
    fs : float
        Hz.
    order : int
        0, 1, 2 for displacement, velocity, acceleration.
    held : bool
        Whether inputs are held between samples.
    fineness : int
        Multiplies the number of steps.
    tolerance : float
        Change from one period to the next, relative to the response.
    most : int
        Periods to wait for that.

    Returns
    -------
    array, (E, n, N)
    """
    poles = np.abs(structure.poles())
    slow = poles[poles < 2 * np.pi * fs / 4].max()
    substeps = fineness * max(8, math.ceil(max(slow / 0.12, poles.max() / 1.6) / fs))
    rows = structure.rows()
    inverse = np.linalg.inv(structure.mass)
    incidence = np.array([structure.row(at) for _, at, _ in elements]).reshape(len(elements), len(inverse))
    system = tuple(
        np.ascontiguousarray(part)
        for part in (
            -inverse @ structure.stiffness,
            -inverse @ structure.damping,
            structure.force_constant * inverse @ rows.T,
            inverse @ incidence.T,
            incidence,
        )
    )
    laws = np.array([LAWS.index(law) for law, _, _ in elements], dtype=np.int64)
    constants = np.array([values for _, _, values in elements], dtype=float).reshape(-1, 2)
    experiments, _, size = u.shape
    out = np.empty((experiments, len(rows), size))
    orders = np.full(len(rows), order)
    for e in range(experiments):
        factor = 2 * substeps
        if held:
            fine = np.repeat(u[e], factor, axis=-1)
        else:
            lines = np.zeros((len(u[e]), size * factor // 2 + 1), dtype=complex)
            lines[:, : size // 2] = np.fft.rfft(u[e])[:, : size // 2] * factor
            fine = np.fft.irfft(lines, n=size * factor)
        fine = np.ascontiguousarray(fine.T)
        dof = len(inverse)
        state = (np.zeros(dof), np.zeros(dof), np.zeros(len(elements)), np.ascontiguousarray(u[e, :, -1]))
        last = np.full((len(rows), size), np.inf)
        h = 1.0 / (fs * substeps)
        for _ in range(most):
            y = np.empty((len(rows), size))
            one_period(state, fine, substeps, held, h, system, laws, constants, rows, orders, y)
            if not np.isfinite(y).all():
                raise NotPeriodicError
            change = np.sqrt(np.max(np.sum((y - last) ** 2, axis=1) / np.sum(y**2, axis=1)))
            last = y
            if change < tolerance:
                break
        else:
            raise NotPeriodicError
        out[e] = last
    return out
