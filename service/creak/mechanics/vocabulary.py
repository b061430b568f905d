"""Names of all effects: what a model file may say and what a diagnosis may answer."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from creak.mechanics import effects, electronics
from creak.mechanics.effects import Effect

VOCABULARY: Final[Mapping[str, type[Effect]]] = MappingProxyType(
    {
        kind.effect: kind
        for kind in (
            effects.Stiffness,
            effects.Damping,
            effects.Mass,
            effects.CubicStiffness,
            effects.QuadraticStiffness,
            effects.Clearance,
            effects.OneSidedStop,
            effects.CoulombFriction,
            effects.QuadraticDamping,
            effects.Hysteresis,
            effects.Resonator,
            electronics.ActuatorGain,
            electronics.ActuatorDelay,
            electronics.ActuatorSaturation,
            electronics.ActuatorDeadZone,
            electronics.ActuatorHysteresis,
            electronics.SensorGain,
            electronics.SensorDelay,
            electronics.SensorClipping,
            electronics.SensorQuantisation,
        )
    }
)
