"""Blind cases, all drawn from a seed; what the diagnosis may see is kept apart from the truth."""

from dataclasses import dataclass

import numpy as np

from blind import effects, structures
from blind.motion import OUTSIDE, NotPeriodicError

STRATA = 20
"""Of as many cases three have no gap, three an effect outside the vocabulary."""


@dataclass
class Case:
    """One blind case.

    Parameters
    ----------
    rig, model : str
        Texts of the files that the diagnosis is given.
    u, y : array
        The measurement, (experiment, channel, sample), transient period included.
    truth : dict
        What it is not given.
    healthy : tuple of array, optional
        Inputs and responses from before the effect was there; given in place of the model.
    """

    rig: str
    model: str
    u: np.ndarray
    y: np.ndarray
    truth: dict
    healthy: tuple[np.ndarray, np.ndarray] | None = None


def draw(seed, index):
    """Draw case `index` of a set.

    Parameters
    ----------
    seed : int
        Of the set.
    index : int
        Of the case; a third of the cases with a gap have all masses, stiffnesses and dampings off as well.

    Returns
    -------
    Case
    """
    rng = np.random.default_rng((seed, index))
    turn = np.random.default_rng(seed).permutation(STRATA)[index % STRATA]
    kind = "none" if turn < 3 else "outside" if turn < 6 else "vocabulary"
    for _ in range(20):
        try:
            return _attempt(rng, kind, off=bool(rng.random() < 1 / 3))
        except NotPeriodicError:
            continue
    raise RuntimeError(f"no periodic motion found for case {index} of set {seed}")


def draw_of(seed, index, chosen, off=False, healthy=False):
    """Draw a case with one of some effects, in turn.

    Parameters
    ----------
    seed, index : int
    chosen : sequence of str
    off : bool
        All masses, stiffnesses and dampings are off as well.
    healthy : bool
        A recording from before takes the place of the model.

    Returns
    -------
    Case
    """
    rng = np.random.default_rng((seed, index))
    for _ in range(20):
        try:
            return _attempt(rng, "vocabulary", off, chosen[index % len(chosen)], healthy)
        except NotPeriodicError:
            continue
    raise RuntimeError(f"no periodic motion found for case {index} of set {seed}")


def _attempt(rng, kind, off, chosen=None, healthy=False):
    spec = structures.draw_beam(rng) if rng.random() < 0.15 else structures.draw_lumped(rng)
    structure = structures.assemble(spec)
    effect = {
        "none": None,
        "outside": str(rng.choice(OUTSIDE)),
        "vocabulary": chosen or str(rng.choice(effects.VOCABULARY)),
    }[kind]
    off = off and effect is not None and effect not in effects.HARMLESS_BESIDE_ERRORS
    beam = spec["kind"] == "beam"
    fs, size = float(rng.choice([1000.0, 1280.0, 1600.0])), int(rng.choice([2048, 4096], p=[0.7, 0.3]))
    order = int(rng.choice(3, p=[0.6, 0.2, 0.2]))
    held = bool(rng.random() < 0.15)
    periods, realisations = int(rng.integers(2, 5)), int(rng.integers(4, 7))
    frequencies = np.abs(structure.poles()) / (2 * np.pi)
    band = (0.6 * frequencies.min(), 150.0 if beam else 1.15 * frequencies.max())
    band = tuple(float(f) for f in np.round(band, 2))
    u = multisines(rng, len(structure.nodes), realisations, fs, size, band, 1.0 if beam else 20.0)
    at, values = (), {}
    if effect is not None:
        at = effects.draw_place(rng, spec, structure.nodes, effect)
        values = effects.draw_strength(rng, effect, at, structure, u, fs)
        if effect.startswith("sensor") and ("limit" in values or "step" in values):
            node = structure.nodes.index(at[0])
            measured, moved = (effects.rms(structure.linear(u, fs, o)[:, node]) for o in (order, 0))
            values = {key: value * measured / moved for key, value in values.items()}
    y = effects.responses(structure, effect, at, values, u, fs, order, held)
    believed = structures.perturbed(spec, rng, 0.1) if off else spec
    snr_db = float(rng.uniform(30.0, 60.0))
    power = np.mean(y**2, axis=(0, 2))
    sigma = np.sqrt(power) * 10 ** (-snr_db / 20)
    noise = np.mean(sigma**2 / periods / power)
    plain = effects.responses(structure, None, (), {}, u, fs, order, held)
    simulated = effects.responses(structures.assemble(believed), None, (), {}, u, fs, order, held)
    repeated = np.tile(y, periods + 1)
    repeated = repeated + sigma[:, None] * rng.standard_normal(repeated.shape)
    before = None
    if healthy:
        other = multisines(rng, len(structure.nodes), realisations, fs, size, band, 1.0 if beam else 20.0)
        still = np.tile(effects.responses(structure, None, (), {}, other, fs, order, held), periods + 1)
        still = still + sigma[:, None] * rng.standard_normal(still.shape)
        before = np.tile(other, periods + 1), still
    there = [(effect, at, values)] if effect else []
    truth = {
        "kind": kind,
        "effect": effect,
        "at": list(at),
        "parameters": values,
        "linear_error": off,
        "structure": spec["shape"],
        "nodes": len(structure.nodes),
        "output": ("m", "m/s", "m/s^2")[order],
        "hold": "zero-order" if held else "band-limited",
        "realisations": realisations,
        "periods": periods,
        "snr_db": snr_db,
        "model": None if kind == "outside" else structures.model_text(spec, there),
        "effect_to_noise_db": _ratio_db(y - plain, power, noise),
        "gap_to_noise_db": _ratio_db(y - simulated, power, noise),
    }
    rig = rig_text(structure.nodes, fs, size, band, truth["hold"], truth["output"])
    return Case(rig, structures.model_text(believed), np.tile(u, periods + 1), repeated, truth, before)


def _ratio_db(difference, power, noise):
    return float(10 * np.log10(np.mean(np.mean(difference**2, axis=(0, 2)) / power) / noise + 1e-30))


def multisines(rng, inputs, realisations, fs, size, band, level):
    """Random-phase multisines, flat in a band; a realisation's experiments rotated into orthogonality."""
    frequencies = np.fft.rfftfreq(size, 1 / fs)
    lines = np.flatnonzero((frequencies >= band[0]) & (frequencies <= band[1]))
    u = np.empty((realisations, inputs, inputs, size))
    for m in range(realisations):
        phase = rng.uniform(0, 2 * np.pi, (inputs, len(lines)))
        for c in range(inputs):
            spectrum = np.zeros((inputs, size // 2 + 1), dtype=complex)
            turned = phase - 2 * np.pi * c * np.arange(inputs)[:, None] / inputs
            spectrum[:, lines] = np.exp(1j * turned)
            u[m, c] = np.fft.irfft(spectrum, n=size)
    u = u.reshape(-1, inputs, size)
    return u * (level / np.sqrt(np.mean(u[0, 0] ** 2)))


def rig_text(nodes, fs, size, band, hold, output):
    """Rig file: all nodes driven and measured."""
    rows = [
        'name = "blind"',
        f"sample_rate = {fs!r}",
        f"period_samples = {size}",
        "transient_periods = 1",
        f"band = [{band[0]!r}, {band[1]!r}]",
        f'hold = "{hold}"',
    ]
    for name in nodes:
        rows += ["[[nodes]]", f'name = "{name}"', 'input = "N"', f'output = "{output}"']
    return "\n".join(rows) + "\n"
