"""The linear part of a structure under periodic inputs, line by line, and whether it is stable."""

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.linalg import expm

from creak.errors import SimulationError
from creak.mechanics import harmonic
from creak.mechanics.system import System
from creak.records import Complex, Hold, Real


@dataclass(frozen=True, eq=False)
class LinearPart:
    """What the linear part makes of the inputs, and of the elements' forces, at the lines 0..N/2.

    Parameters
    ----------
    y : array, (E, n, L)
        Responses to the inputs.
    D : array, (E, r, L)
        Relative displacements of the elements under the inputs.
    rate : array, (E, r, N), or None
        What their velocity has beside the derivative of these lines.
    receptance, response : array, (L, r, r), (L, n, r)
        Relative displacements, and responses, per force of the elements.
    """

    y: Complex
    D: Complex
    rate: Real | None
    receptance: Complex
    response: Complex


def linear_part(system: System, acting: Real, sample_rate: float, hold: Hold) -> LinearPart:
    """Solve for the linear part at the lines of a period.

    Parameters
    ----------
    system : System
    acting : array, (E, q, N)
        One period of the inputs, actuators' effects in them.
    sample_rate : float
        Hz.
    hold : str
    """
    size = acting.shape[-1]
    U = scipy.fft.rfft(acting, norm="forward")
    frequencies, jw = line_grid(size, sample_rate)
    s = 2j * np.pi * frequencies[:, None, None]
    q = system.inputs.shape[1]
    # One factorisation of the dynamic stiffness serves inputs and elements.
    motion = system.motion(frequencies, np.hstack([system.inputs, system.incidence]))
    relative = system.incidence.T @ motion
    response = s ** np.array(system.derivatives)[:, None] * (system.outputs @ motion)
    rate = None
    if hold == "band-limited":
        y, D = (harmonic.apply(paths[..., :q], U) for paths in (response, relative))
    else:
        parts = _held(system, U, frequencies, sample_rate)
        y = np.stack([system.outputs[m] @ parts[order] for m, order in enumerate(system.derivatives)], axis=1)
        D, V = (system.incidence.T @ part for part in parts[:2])
        rate = samples_of(V - jw * D, size)
    return LinearPart(y, D, rate, np.ascontiguousarray(relative[..., q:]), np.ascontiguousarray(response[..., q:]))


def check_stability(system: System) -> None:
    """Refuse a system whose linear part has a growing motion.

    Raises
    ------
    SimulationError
        Frequency and growth of the fastest growing motion are named.
    """
    if not len(system.mass):
        return  # a measured structure: it was there to be measured
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
    lines = scipy.fft.rfft(samples, norm="forward")
    kept = min(old, size) // 2 + 1
    out = np.zeros((*samples.shape[:-1], size // 2 + 1), dtype=np.complex128)
    out[..., :kept] = lines[..., :kept]
    if min(old, size) % 2 == 0:
        out[..., kept - 1] *= 0.5 if old < size else 2.0  # a Nyquist line is shared with its mirror image
    return samples_of(out, size)


def finer(lines: Complex, size: int) -> Complex:
    """Lines of `size` samples as those of twice as many, whose Nyquist line and its mirror image are two."""
    out = np.zeros((*lines.shape[:-1], size + 1), dtype=np.complex128)
    out[..., : size // 2 + 1] = lines
    if size % 2 == 0:
        out[..., size // 2] *= 0.5
    return out


def samples_of(lines: Complex, size: int) -> Real:
    """Time course of lines, which are a DFT divided by the number of samples."""
    return np.asarray(scipy.fft.irfft(lines, n=size, norm="forward"))


def line_grid(size: int, sample_rate: float) -> tuple[Real, Complex]:
    """Frequencies of all lines, Hz, and the factor of differentiation there."""
    frequencies = np.asarray(np.arange(size // 2 + 1) * (sample_rate / size), dtype=np.float64)
    jw = np.asarray(2j * np.pi * frequencies, dtype=np.complex128)
    if size % 2 == 0:
        jw[-1] = 0.0
    return frequencies, jw


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


def _state_space(system: System) -> tuple[Real, Real]:
    dof = len(system.mass)
    below = np.linalg.solve(system.mass, np.hstack([-system.stiffness, -system.damping, system.inputs]))
    states = np.vstack([np.eye(dof, 2 * dof, dof), below[:, : 2 * dof]])
    return states, np.vstack([np.zeros_like(system.inputs), below[:, 2 * dof :]])
