"""Effects that no data of a rig can tell from those that were named: said, whatever the search has tried."""

from collections.abc import Sequence
from dataclasses import replace

from creak.gap.records import Cause
from creak.mechanics.effects import Restoring
from creak.mechanics.system import Model
from creak.records import Rig

_PARTNERS = {
    "actuator_gain": "sensor_gain",
    "sensor_gain": "actuator_gain",
    "actuator_delay": "sensor_delay",
    "sensor_delay": "actuator_delay",
}


def equivalents(
    rig: Rig, corrected: Model, causes: Sequence[Cause], alternatives: Sequence[Cause]
) -> tuple[Cause, ...]:
    """Add to the alternatives what is the same in the data by its nature.

    With one input and one response, a delay of either is a delay of both, and so is a gain where the structure is
    linear.

    Parameters
    ----------
    rig : Rig
    corrected : Model
        With the causes in it.
    causes, alternatives : sequence of Cause

    Returns
    -------
    tuple of Cause
        The alternatives, and those that were missing.
    """
    if rig.n > 1:
        return tuple(alternatives)
    bent = any(isinstance(effect, Restoring) for effect in corrected.effects)
    found = list(alternatives)
    for i, cause in enumerate(causes):
        partner = _PARTNERS.get(cause.effect)
        if partner is None or (bent and "gain" in partner):
            continue
        if not any((other.effect, other.instead_of) == (partner, i) for other in found):
            found.append(replace(cause, effect=partner, before=None, instead_of=i))
    return tuple(found)


def cannot_tell(rig: Rig, causes: Sequence[Cause]) -> list[str]:
    """What else a gain may be, a sentence each: a change of all that hangs on its coordinate.

    A node that is not driven can be measured in other units without another trace: its mass then changes by
    ``1/g^2`` and the springs and dampers to it by ``1/g``. With one node all three change by ``1/g``.
    """
    found = []
    driven = {rig.nodes[i].name for i in rig.driven}
    for cause in causes:
        if cause.effect in ("actuator_gain", "sensor_gain") and (rig.n == 1 or cause.at[0] not in driven):
            kind = cause.effect.replace("_", " ")
            found.append(
                f"the {kind} at {cause.at[0]} is the same, in these data, as a change of all masses, springs and "
                "dampers that hang on that node together"
            )
    return found
