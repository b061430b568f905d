"""What belongs to a beam as a whole: modulus, density, damping ratio, as linear parameters that may be off.

They change every mode, so no spring, damper or mass at a station can stand for them. Seen from the stations a beam
is its dynamic stiffness ``Z(w) = S(w)^-1``, the inverse of the receptance between them; a property that is off by
``t`` adds the forces ``t dZ/dt x`` there, exactly to first order, since nothing acts anywhere else.
"""

from dataclasses import replace
from typing import Final, Literal

import numpy as np

from creak.mechanics.beam import Beam
from creak.mechanics.system import Model, assemble
from creak.records import Complex, Rig

Property = Literal["youngs_modulus", "density", "damping_ratio"]

PROPERTIES: Final[tuple[Property, ...]] = ("youngs_modulus", "density", "damping_ratio")

_STEP = 1e-5  # of a property, for difference quotients


def properties_of(model: Model) -> tuple[Property, ...]:
    """Properties that a model has: those of a beam that are not zero."""
    return tuple(name for name in PROPERTIES if getattr(model, name) > 0) if isinstance(model, Beam) else ()


def stiffness_change(rig: Rig, model: Model, name: Property, s: Complex) -> Complex:
    """Derivative of the dynamic stiffness between the rig's nodes to a property.

    Parameters
    ----------
    rig : Rig
    model : Model
        A beam; its effects are left out.
    name : str
    s : array, (L,)
        ``j w``.

    Returns
    -------
    array, (L, n, n)
        N/m per unit of the property; 0 at DC where nothing holds the beam.
    """
    bare = replace(model, effects=())
    value = getattr(bare, name)
    plus, minus = (_receptance(rig, replace(bare, **{name: value * (1 + sign * _STEP)}), s) for sign in (1, -1))
    held = _inverse(rig, bare, s)
    return np.asarray(-held @ ((plus - minus) / (2 * _STEP * value)) @ held)


def _receptance(rig: Rig, model: Model, s: Complex) -> Complex:
    system = assemble(model, rig)
    return np.asarray(system.outputs @ system.motion(np.abs(s) / (2 * np.pi), system.outputs.T))


def _inverse(rig: Rig, model: Model, s: Complex) -> Complex:
    """Dynamic stiffness between the nodes; two at one place share theirs."""
    receptance = _receptance(rig, model, s)
    size = np.linalg.norm(receptance, axis=(1, 2), keepdims=True)
    try:
        inverse = np.linalg.inv(receptance)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(receptance, rcond=1e-12))
    if np.all(np.linalg.norm(inverse, axis=(1, 2), keepdims=True) * size < 1e10):
        return np.asarray(inverse)
    return np.asarray(np.linalg.pinv(receptance, rcond=1e-12))
