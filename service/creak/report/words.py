"""What a diagnosis says, in plain words; shared by the terminal and the page."""

import math
from collections.abc import Iterable, Iterator, Mapping

from creak.gap.records import Cause, Diagnosis, GapLevels, LinearCorrection, MissingForce, NodeGap, Verdict
from creak.mechanics.effects import GROUND

_PHRASES: Mapping[str, str] = {
    "stiffness": "a linear spring",
    "damping": "a linear damper",
    "mass": "a mass",
    "cubic_stiffness": "a cubic spring",
    "quadratic_stiffness": "a quadratic spring",
    "clearance": "a clearance with contact on both sides",
    "one_sided_stop": "a one-sided stop",
    "coulomb_friction": "Coulomb friction",
    "quadratic_damping": "quadratic damping",
    "hysteresis": "hysteresis (Bouc-Wen)",
    "resonator": "a resonating mass",
    "actuator_gain": "a wrong gain",
    "actuator_delay": "a delay",
    "actuator_saturation": "saturation",
    "actuator_dead_zone": "a dead zone",
    "actuator_hysteresis": "hysteresis (Bouc-Wen)",
    "sensor_gain": "a wrong gain",
    "sensor_delay": "a delay",
    "sensor_clipping": "clipping",
    "sensor_quantisation": "quantisation",
}

_UNITS: Mapping[tuple[str, str], str] = {
    ("stiffness", "coefficient"): "N/m",
    ("damping", "coefficient"): "N s/m",
    ("mass", "coefficient"): "kg",
    ("cubic_stiffness", "coefficient"): "N/m³",
    ("quadratic_stiffness", "coefficient"): "N/m²",
    ("clearance", "stiffness"): "N/m",
    ("clearance", "gap"): "m",
    ("one_sided_stop", "stiffness"): "N/m",
    ("one_sided_stop", "gap"): "m",
    ("coulomb_friction", "force"): "N",
    ("coulomb_friction", "velocity"): "m/s",
    ("quadratic_damping", "coefficient"): "N s²/m²",
    ("hysteresis", "stiffness"): "N/m",
    ("hysteresis", "yield_displacement"): "m",
    ("resonator", "mass"): "kg",
    ("resonator", "frequency_hz"): "Hz",
    ("actuator_delay", "delay"): "s",
    ("sensor_delay", "delay"): "s",
}

_LINEAR_UNITS: Mapping[str, str] = {"mass": "kg", "stiffness": "N/m", "damping": "N s/m"}


def verdict(diagnosis: Diagnosis) -> str:
    """The verdict in two or three words, for a heading."""
    return {
        Verdict.NO_GAP: "no gap",
        Verdict.EXPLAINED: "explained",
        Verdict.PARTLY_EXPLAINED: "partly explained",
        Verdict.UNKNOWN: "unknown",
    }[diagnosis.verdict]


def summary(diagnosis: Diagnosis) -> list[str]:
    """The verdict and what it rests on, a sentence each."""
    gap = diagnosis.gap
    if diagnosis.verdict is Verdict.NO_GAP:
        return [
            f"The model and the recording agree within noise: their gap is {gap.before_db:.1f} dB, "
            f"noise alone leaves {gap.noise_db:.1f} dB."
        ]
    sentences = [
        f"The model misses part of what was measured: the gap is {gap.before_db:.1f} dB of the response, "
        f"{gap.before_db - gap.noise_db:.1f} dB above noise."
    ]
    if diagnosis.where:
        sentences.append(f"The missing force acts {_places(diagnosis.where)}.")
    match diagnosis.verdict:
        case Verdict.EXPLAINED:
            sentences.append(
                f"{_listed(_named(diagnosis))} {_verb(diagnosis)} it: "
                f"the gap shrinks to {gap.after_db:.1f} dB, noise is {gap.noise_db:.1f} dB."
            )
        case Verdict.PARTLY_EXPLAINED:
            sentences.append(
                f"{_listed(_named(diagnosis))} {'closes' if _single(diagnosis) else 'close'} "
                f"{percent(gap.closed)} of it, down to {gap.after_db:.1f} dB; "
                f"noise is {gap.noise_db:.1f} dB, {_reservation(gap)}."
            )
        case Verdict.UNKNOWN:
            sentences.append("No effect of the vocabulary explains it, so none is named.")
    return sentences


def _reservation(gap: GapLevels) -> str:
    """Why a gap is not called explained."""
    if gap.closes:
        return "but more than three effects, or two at one place, may stand for others: it is not called explained"
    return "so something else is missing, or it is not quite this"


def effect_phrase(effect: str, at: tuple[str, ...]) -> str:
    """For instance ``a cubic spring between node 3 and ground``."""
    return f"{_PHRASES.get(effect, effect)} {place(at, effect)}"


def place(at: tuple[str, ...], effect: str = "") -> str:
    """Where something acts, in words."""
    if len(at) == 1:
        kind = effect.partition("_")[0]
        return f"at the {kind} of node {at[0]}" if kind in {"actuator", "sensor"} else f"at node {at[0]}"
    if GROUND in at:
        node = at[0] if at[1] == GROUND else at[1]
        return f"at {_point(node)}" if effect == "mass" else f"between {_point(node)} and {GROUND}"
    return f"between nodes {at[0]} and {at[1]}"


def _point(name: str) -> str:
    """A node, or a point of a beam that has no sensor and is named after its position in m."""
    return f"{name.removeprefix('x=')} m along the beam" if name.startswith("x=") else f"node {name}"


def where(at: tuple[str, ...]) -> str:
    """A place as short as can be, for instance ``3-ground``."""
    return "-".join(at)


def missing_place(force: MissingForce) -> str:
    """Where a missing force acts, in words."""
    if force.position is not None and force.position_error is not None:
        return f"at {quantity(force.position, force.position_error, 'm')} along the beam"
    return place(force.at, force.pattern if force.pattern in {"actuator", "sensor"} else "")


def parameters(cause: Cause) -> Iterator[str]:
    """Parameters of an effect with their 95 % intervals, one a string."""
    for name, value in cause.parameters.items():
        unit = _UNITS.get((cause.effect, name), "")
        text = f"{name} {quantity(value, cause.standard_errors.get(name, math.nan), unit)}"
        if cause.before is not None and name in cause.before:
            text += f" (the model says {cause.before[name]:.6g})"
        yield text


def correction(moved: LinearCorrection) -> str:
    """For instance ``stiffness of 1-2: 35000 -> 36120 ± 90 N/m``."""
    unit = _LINEAR_UNITS.get(moved.parameter, "")
    return (
        f"{moved.parameter} of {moved.element}: {moved.before:.6g} → "
        f"{quantity(moved.after, moved.standard_error, unit)}"
    )


def quantity(value: float, standard_error: float, unit: str) -> str:
    """A value with its 95 % interval, rounded to what the interval allows."""
    tail = f" {unit}" if unit else ""
    half = 1.96 * standard_error
    if not math.isfinite(half) or half <= 0 or value == 0:
        return f"{value:.4g}{tail}"
    digits = max(2, min(10, 2 + math.floor(math.log10(abs(value))) - math.floor(math.log10(half))))
    return f"{f'{value:#.{digits}g}'.rstrip('.')} ± {half:.2g}{tail}"


def split(node: NodeGap) -> str:
    """How the gap of a node divides, in words."""
    shares = {
        "linear part": node.linear_share,
        "nonlinear distortion": node.nonlinear_share,
        "noise": node.noise_share,
    }
    return ", ".join(f"{percent(share)} {name}" for name, share in shares.items())


def _named(diagnosis: Diagnosis) -> list[str]:
    named = [effect_phrase(cause.effect, cause.at) for cause in diagnosis.causes]
    if diagnosis.linear_corrections:
        named.append("masses, stiffnesses and dampings that are a little off")
    named = named or ["a correction of the model"]
    return [named[0][0].upper() + named[0][1:], *named[1:]]


def _single(diagnosis: Diagnosis) -> bool:
    return len(diagnosis.causes) == 1 and not diagnosis.linear_corrections


def _verb(diagnosis: Diagnosis) -> str:
    return "explains" if _single(diagnosis) else "together explain"


def _places(where: Iterable[MissingForce]) -> str:
    return _listed([f"{missing_place(force)} ({percent(force.share)})" for force in where])


def _listed(items: list[str]) -> str:
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"


def percent(share: float | None) -> str:
    """A share with as many digits as show what it lacks, or how little it is."""
    if share is None or not math.isfinite(share):
        return "an unknown share"
    if 0.99 < share < 1:
        return f"{min(100 * share, 99.99):.2f} %"
    return f"{100 * share:.{0 if share >= 0.095 or share == 0 else 1}f} %"
