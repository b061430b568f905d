"""Points of a model that have no sensor: how forces there show, what they leave, and how the points move.

By reciprocity what the sensors show of a force at x is what x shows of forces at the sensors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from creak.gap.regression import Indices
from creak.gap.setting import Setting
from creak.gap.view import View, lines_of, samples_of, see
from creak.mechanics.beam import Beam, Station
from creak.mechanics.effects import GROUND
from creak.mechanics.steady import simulate_steady
from creak.mechanics.structure import Lumped
from creak.mechanics.system import Model, assemble
from creak.records import Complex, Real, Rig

Place = tuple[str, str]

_FEWEST_ELEMENTS = 48  # of a beam along which a position is sought
_CLEAR = 4.0  # power over noise beyond which a line of the force counts as known
_SURE = 3.84  # in twice the log likelihood: what a single number may cost within its 95 % interval
_CURVED = 2e-3  # of the beam's length, from where its curvature is taken
_FINE = 1e-4  # of the beam's length, to which a position is sought


@dataclass(frozen=True, eq=False)
class Profile:
    """What a free force leaves at places, not measured ones and measured ones.

    Parameters
    ----------
    places : tuple of (str, str)
    rest : array, (K,)
        Whitened power relative to noise; 1 at the right place.
    likelihood : array, (K,)
        Twice the log likelihood that the place loses to the best one.
    positions : array, (K,), or None
        Along a beam, m; NaN for places that are no point of it.
    """

    places: tuple[Place, ...]
    rest: Real
    likelihood: Real
    positions: Real | None


def hidden_points(model: Model, rig: Rig) -> tuple[str, ...]:
    """Points that a model names and the rig does not measure; those of a beam are found by position instead."""
    measured = {node.name for node in rig.nodes}
    if isinstance(model, Lumped):
        return tuple(mass.name for mass in model.masses if mass.name not in measured)
    if isinstance(model, Beam):
        return ()
    known = {*getattr(model, "inputs", ()), *getattr(model, "outputs", ())}
    return tuple(sorted(known - measured))


def with_station(beam: Beam, position: float) -> tuple[Beam, str]:
    """Beam with a bare point at a position, and the point's name: that of a station which is there already."""
    for station in beam.stations:
        if abs(station.position - position) <= 1e-6 * beam.length:
            return beam, station.name
    name = f"x={position:.6g}"
    return replace(beam, stations=(*beam.stations, Station(name, position))), name


def profile(setting: Setting, view: View, experiments: Indices) -> Profile | None:
    """See what a free force leaves at every place that can be told from others.

    Parameters
    ----------
    setting : Setting
    view : View
        The recording through the model.
    experiments : array of int

    Returns
    -------
    Profile or None
        None where no point is hidden, or one node alone is measured.
    """
    rig, model = setting.rig, setting.model
    if rig.n < 2:
        return None
    positions: Real | None = None
    if isinstance(model, Beam):
        positions, spline = _patterns_along(setting, view)
        patterns = spline(positions)
        places = tuple((f"x={position:.6g}", GROUND) for position in positions)
    else:
        hidden = hidden_points(model, rig)
        if not hidden:
            return None
        nodes = [node.name for node in rig.nodes]
        pairs = [(p, q) for i, p in enumerate(hidden) for q in (*nodes, *hidden[i + 1 :])]
        places = (*((p, GROUND) for p in hidden), *pairs)
        patterns = _patterns(model, rig, view, places)
    rest, power = _left(view, patterns, experiments)
    scale = max(1.0, float(rest.min()))
    return Profile(places, rest, 2 * (power - power.min()) / scale, positions)


def _left(view: View, patterns: Complex, experiments: Indices) -> tuple[Real, Real]:
    """Whitened power, per sample and in all, that free forces of patterns ``(K, L, n)`` leave."""
    r = view.r[experiments]
    total = float(np.sum(np.abs(r) ** 2))
    size = np.maximum(np.sum(np.abs(patterns) ** 2, axis=-1), 1e-300)
    taken = np.array(
        [
            np.sum(np.abs(np.einsum("ln,eln->el", q.conj(), r)) ** 2 / s)
            for q, s in zip(patterns, size, strict=True)
        ]
    )
    n = r.shape[-1]
    left = total - taken
    return left / (r.size * (n - 1) / n), left


def see_beyond(setting: Setting, places: Sequence[tuple[str, ...]]) -> View:
    """View with the points of places in it that are not measured, their motion as free forces there make it.

    Parameters
    ----------
    setting : Setting
        Its model has the points.
    places : sequence of tuple of str
    """
    view = see(setting.rig, setting.model, setting.data, setting.top)
    for at in places:
        if len(at) == 2 and not {*at} <= {*view.names, GROUND}:
            view = extended(view, (at[0], at[1]))
    return view


def extended(view: View, at: Place) -> View:
    """View with the hidden points of a place in it, their motion as a free force at the place makes it.

    Parameters
    ----------
    view : View
        Its model has the points.
    at : tuple of str
    """
    rig = view.rig
    nodes = view.names
    hidden = tuple(name for name in at if name not in (*nodes, GROUND))
    system = view.system
    frequencies = np.abs(view.s) / (2 * np.pi)
    rows = np.array([system.points[name] for name in hidden])
    b = system.points[at[0]] - system.points[at[1]]
    loads = np.column_stack([*rows, b])
    seen = system.receptance(frequencies, loads)
    pattern = seen[..., -1] / view.sigma
    power = np.maximum(np.sum(np.abs(pattern) ** 2, axis=1), 1e-300)
    force = np.einsum("ln,eln->el", pattern.conj(), view.r) / power
    force = np.where(np.mean(np.abs(force) ** 2, axis=0) * power > _CLEAR, force, 0.0)
    alone = replace(
        system,
        outputs=rows,
        derivatives=(0,) * len(hidden),
        actuators=((),) * system.inputs.shape[1],
        sensors=((),) * len(hidden),
    )
    size = rig.period_samples
    simulated = lines_of(simulate_steady(alone, view.u, rig.sample_rate, rig.hold).y)
    D = (
        simulated[:, : len(view.s)]
        - np.einsum("ph,lh->lp", rows, system.motion(frequencies, b[:, None])[..., 0])[None] * force[..., None]
    )
    whole = np.zeros((len(D), size // 2 + 1, len(hidden)), dtype=np.complex128)
    whole[:, : len(view.s)] = D
    s = 2j * np.pi * np.arange(size // 2 + 1) * rig.sample_rate / size
    return replace(
        view,
        names=(*nodes, *hidden),
        columns=np.concatenate([view.columns, seen[..., :-1]], axis=-1),
        d=np.concatenate([view.d, samples_of(whole, size)], axis=1),
        v=np.concatenate([view.v, samples_of(s[:, None] * whole, size)], axis=1),
        D=np.concatenate([view.D, D], axis=-1),
    )


def intervals(seen: Profile) -> tuple[tuple[float, float], ...]:
    """Stretches of a beam in which a free force costs no more than chance allows beyond the best position."""
    assert seen.positions is not None
    near = seen.likelihood <= _SURE
    step = float(np.max(np.diff(seen.positions)))
    found: list[tuple[float, float]] = []
    for x in seen.positions[near]:
        if found and x - found[-1][1] <= 1.5 * step:
            found[-1] = (found[-1][0], float(x))
        else:
            found.append((float(x), float(x)))
    return tuple(found)


def finest(setting: Setting, view: View, seen: Profile, experiments: Indices) -> tuple[float, float, float]:
    """Position at which a free force leaves least, its standard error, and what it leaves there."""
    mesh, spline = _patterns_along(setting, view)
    best = int(np.argmin(seen.rest))
    low, high = mesh[max(best - 1, 0)], mesh[min(best + 1, len(mesh) - 1)]
    found = minimize_scalar(
        lambda x: float(_left(view, spline(np.array([x])), experiments)[0][0]),
        bounds=(low, high),
        method="bounded",
        options={"xatol": _FINE * mesh[-1]},
    )
    step = _CURVED * mesh[-1]
    around = np.clip(found.x + step * np.array([-1.0, 0.0, 1.0]), 0.0, mesh[-1])
    rests, power = _left(view, spline(around), experiments)
    # Twice the log likelihood falls by (x - x0)^2/deviation^2.
    curvature = float(np.polyfit(around - found.x, 2 * power / max(float(rests.min()), 1.0), 2)[0])
    return float(found.x), 1 / np.sqrt(curvature) if curvature > 0 else np.nan, float(found.fun)


def _patterns_along(setting: Setting, view: View) -> tuple[Real, CubicSpline]:
    """Mesh of a beam, m, and over it the whitened motion of the sensors per force, ``(K, L, n)``."""
    model = setting.model
    assert isinstance(model, Beam)
    model = replace(model, elements=max(model.elements, _FEWEST_ELEMENTS))
    mesh = model.mesh()
    names = []
    for position in mesh:
        model, name = with_station(model, float(position))
        names.append(name)
    patterns = _patterns(model, setting.rig, view, [(name, GROUND) for name in names])
    return mesh, CubicSpline(mesh, patterns)


def _patterns(model: Model, rig: Rig, view: View, places: Sequence[Place]) -> Complex:
    """Whitened motion of the sensors per force at places, ``(K, L, n)``.

    By reciprocity what the sensors show of a force at x is what x shows of forces at the sensors.
    """
    system = assemble(model, rig)
    motion = system.motion(np.abs(view.s) / (2 * np.pi), system.outputs.T)
    motion = motion * view.s[:, None, None] ** np.array(system.derivatives)
    rows = np.array([system.points[a] - system.points[b] for a, b in places])
    return np.asarray(np.einsum("kd,ldn->kln", rows, motion, optimize=True) / view.sigma)
