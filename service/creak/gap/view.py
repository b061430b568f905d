"""A model seen through a recording: its receptances at every line, and the whitened motion that it leaves.

Everything is worked in whitened motion ``r = (Y_model - Y)/sigma`` per experiment, line and node: a missing force
F at a place b leaves ``r = (S_b/sigma) F`` with the receptance column ``S_b`` of the place.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft

from creak.errors import ConfigurationError
from creak.gap.layout import settle
from creak.gap.periodic import PeriodicData
from creak.mechanics.effects import GROUND
from creak.mechanics.electronics import AT_REST, Actuator, Sensor
from creak.mechanics.measured import MeasuredSystem
from creak.mechanics.steady import simulate_steady
from creak.mechanics.system import Model, System, assemble
from creak.records import Complex, Real, Rig

_SIGNAL = 4.0  # whitened power beyond which a line of the measured motion enters the laws


@dataclass(frozen=True, eq=False)
class View:
    """One model and one recording.

    Parameters
    ----------
    rig : Rig
    model : Model
    system : System
    s : array, (L,)
        ``j w`` at all lines.
    columns : array, (L, n, n)
        Motion of the nodes per unit of force at each node, in units of the outputs.
    drive : array, (L, n, q)
        Motion per unit of input: S.
    sigma : array, (L, n)
        Standard deviation of the noise of an experiment's mean.
    u : array, (E, q, N)
        Inputs after the model's actuator effects.
    U : array, (E, L, q)
        Their lines, as the hold leaves them.
    d, v : array, (E, n, N)
        Measured displacement and velocity of the nodes, from the lines that stand clear of noise.
    D : array, (E, L, n)
        Lines of that displacement.
    motion : array, (E, n, N)
        Responses of the model's linear part and of its own forces on the measured motion, before its sensors.
    r : array, (E, L, n)
        Whitened motion that the model leaves.
    names : tuple of str
        Names of the nodes; a point that is not measured may follow, with its column and motion in `columns`,
        `d`, `v` and `D`.
    opened : array, (L, n, k), optional
        Orthonormal patterns of forces that are left free: no pattern and no motion along them counts.
    """

    rig: Rig
    model: Model
    system: System
    s: Complex
    columns: Complex
    drive: Complex
    sigma: Real
    u: Real
    U: Complex
    d: Real
    v: Real
    D: Complex
    motion: Real
    r: Complex
    names: tuple[str, ...]
    opened: Complex | None = None

    def __post_init__(self) -> None:
        """Settle the layout."""
        settle(self)

    def weights(self, at: tuple[str, ...]) -> Real:
        """Incidence of an internal place over the names, ``(n,)`` where all are measured."""
        b = np.zeros(len(self.names))
        for name, sign in zip(at, (1.0, -1.0), strict=False):
            if name != GROUND:
                b[self.names.index(name)] = sign
        return b

    def shows_mean(self, at: tuple[str, ...]) -> bool:
        """Whether the mean displacement at an internal place is measured."""
        weights = self.weights(at)
        return not any(w and order for w, order in zip(weights, self.system.derivatives, strict=False))

    def static(self, at: tuple[str, ...]) -> float:
        """Displacement at an internal place per unit of steady force there; 0 for a free structure."""
        if self.system.free:
            return 0.0
        b = self.system.points[at[0]] - self.system.points[at[1]]
        return float((b @ self.system.motion(np.zeros(1), b[:, None])).real.item())

    def pattern(self, at: tuple[str, ...], kind: str) -> Complex:
        """Whitened motion of the nodes per unit of what a place adds, ``(L, n)``.

        Parameters
        ----------
        at : tuple of str
        kind : {"internal", "actuator", "sensor"}
        """
        q = self._pattern(at, kind)
        if self.opened is None:
            return q
        along = np.einsum("lnk,ln->lk", self.opened.conj(), q)
        return np.asarray(q - np.einsum("lnk,lk->ln", self.opened, along))

    def _pattern(self, at: tuple[str, ...], kind: str) -> Complex:
        if kind == "internal":
            return np.asarray((self.columns @ self.weights(at)) / self.sigma)
        i = self.names.index(at[0])
        if kind == "actuator":
            return np.asarray(self.drive[..., self.rig.driven.index(i)] / self.sigma)
        q = np.zeros(self.sigma.shape, dtype=np.complex128)
        q[:, i] = -1.0 / self.sigma[:, i]
        return q


def lines_of(samples: Real) -> Complex:
    """DFT divided by N, ``(E, c, N)`` to ``(E, L, c)``."""
    lines = np.swapaxes(scipy.fft.rfft(samples, axis=-1), -1, -2) / samples.shape[-1]
    return np.ascontiguousarray(lines, dtype=np.complex128)


def samples_of(lines: Complex, size: int) -> Real:
    """Time course ``(E, c, N)`` of lines ``(E, L, c)``."""
    return np.asarray(scipy.fft.irfft(np.swapaxes(lines, -1, -2) * size, n=size, axis=-1))


def through(effects: Sequence[Sequence[Actuator | Sensor]], samples: Real, sample_rate: float) -> Real:
    """Pass periods ``(E, c, N)`` through effects a channel, in steady state."""
    out = np.array(samples)
    for i, chain in enumerate(effects):
        for effect in chain:
            for e in range(len(out)):
                passed, memory = effect.apply(out[e, i], sample_rate, AT_REST)
                if memory != AT_REST:  # a second pass begins where the first has ended
                    passed, _ = effect.apply(out[e, i], sample_rate, memory)
                out[e, i] = passed
    return out


def hold_factor(rig: Rig) -> Complex:
    """What the hold does to the lines of an input, ``(L,)``."""
    half = np.pi * np.arange(rig.period_samples // 2 + 1) / rig.period_samples
    if rig.hold == "band-limited":
        return np.ones(half.shape, dtype=np.complex128)
    return np.asarray(np.exp(-1j * half) * np.sinc(half / np.pi))


def see(rig: Rig, model: Model, data: PeriodicData, top: int | None = None) -> View:
    """Look at a recording through a model.

    Parameters
    ----------
    rig : Rig
    model : Model
    data : PeriodicData
    top : int or None
        Lines that are kept of what is whitened, from DC on; None for all.

    Raises
    ------
    ConfigurationError
        If the model does not fit the rig, or is unstable.
    """
    system = assemble(model, rig)
    check_stable(system)
    size, q = rig.period_samples, rig.q
    s = 2j * np.pi * np.arange(size // 2 + 1) * rig.sample_rate / size
    kept = slice(None, top)
    forces = np.column_stack([system.inputs, system.outputs.T, system.incidence])
    differentiated = s[:, None] ** np.array(system.derivatives)
    motion = system.outputs @ system.motion(np.abs(s) / (2 * np.pi), forces)
    if system.free:
        motion[0] = 0.0  # the mean of a free structure is not determined
    motion = np.asarray(motion * differentiated[..., None], dtype=np.complex128)
    drive, columns, internal = motion[..., :q], motion[..., q : q + rig.n], motion[..., q + rig.n :]
    u = through(system.actuators, data.u, rig.sample_rate)
    U = lines_of(u) * hold_factor(rig)[:, None]
    clear = np.mean(np.abs(data.Y) ** 2, axis=0) > _SIGNAL * data.variance
    clear &= np.abs(differentiated) > 0
    D = np.asarray(np.where(clear, data.Y / np.where(clear, differentiated, 1.0), 0.0), dtype=np.complex128)
    d, v = samples_of(D, size), samples_of(s[:, None] * D, size)
    plain = replace(
        system, elements=(), incidence=system.incidence[:, :0], actuators=((),) * q, sensors=((),) * rig.n
    )
    moved = lines_of(simulate_steady(plain, u, rig.sample_rate, rig.hold).y)
    if system.elements:
        over = np.linalg.lstsq(system.outputs.T, system.incidence, rcond=None)[0]
        between = over.T @ d, over.T @ v
        force = np.stack(
            [e.over_period(between[0][:, i], between[1][:, i]) for i, e in enumerate(system.elements)], 1
        )
        moved -= np.matmul(internal[None], lines_of(force)[..., None])[..., 0]
    samples = samples_of(moved, size)
    if any(system.sensors):
        recorded = lines_of(through(system.sensors, samples, rig.sample_rate))
    else:
        recorded = moved
    sigma = np.sqrt(data.variance)
    return View(
        rig,
        model,
        system,
        np.asarray(s[kept], dtype=np.complex128),
        columns[kept],
        drive[kept],
        sigma[kept],
        u,
        U[:, kept],
        d,
        v,
        D[:, kept],
        samples,
        ((recorded - data.Y) / sigma)[:, kept],
        tuple(node.name for node in rig.nodes),
    )


def check_stable(system: System) -> None:
    """Refuse a model whose linear part grows by itself."""
    if isinstance(system, MeasuredSystem):
        return
    size = len(system.mass)
    low = -np.linalg.solve(system.mass, np.hstack([system.stiffness, system.damping]))
    poles = np.linalg.eigvals(np.vstack([np.hstack([np.zeros((size, size)), np.eye(size)]), low]))
    fastest = poles[np.argmax(poles.real)]
    if fastest.real > 1e-6 * np.max(np.abs(poles)):
        raise ConfigurationError(
            "model", "", f"is unstable: it has a pole at {fastest.real:.4g} {fastest.imag:+.4g}j 1/s"
        )
