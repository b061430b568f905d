"""Stated standard errors of a diagnosis' parameters against their spread over new draws of the noise."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from creak.gap.hypothesis import own_elements
from creak.mechanics.effects import (
    Clearance,
    CoulombFriction,
    CubicStiffness,
    Hysteresis,
    OneSidedStop,
    QuadraticDamping,
    Resonator,
    Stiffness,
)
from creak.mechanics.electronics import ActuatorSaturation, SensorClipping, SensorDelay, SensorQuantisation
from gap_recordings import CHAIN
from repetitions import repeat

EFFECTS = (
    Stiffness(("1", "3"), 800.0),
    CubicStiffness(("3", "ground"), 1e8),
    Clearance(("2", "3"), 5e4, 2e-4),
    OneSidedStop(("2", "1"), 4e4, 3e-4),
    CoulombFriction(("3", "ground"), 5.0, 0.02),
    QuadraticDamping(("2", "ground"), 30.0),
    Hysteresis(("3", "ground"), 4e4, 3e-4),
    Resonator(("2",), 0.05, 40.0, 0.02),
    ActuatorSaturation(("1",), 90.0),
    SensorDelay(("2",), 2e-4),
    SensorClipping(("1",), 1e-3),
    SensorQuantisation(("3",), 2e-4),
)


def off():
    """All numbers of the model off by a few per cent, to and fro."""
    shares = (0.05, -0.04, 0.03, -0.06, 0.02)
    return tuple((own.key, own.value * shares[i % 5]) for i, own in enumerate(own_elements(CHAIN)))


def row(name, found):
    """One line of the table."""
    return {
        "effect": name,
        "repetitions": len(found.deviates),
        "intervals that hold the truth, %": 100 * found.covered,
        "greatest mean error, standard errors": float(abs(found.bias).max()),
        "spread over stated": " ".join(f"{value:.2f}" for value in found.spread[:3]),
    }


def main():
    """Print the table."""
    given = options(__doc__.splitlines()[0], repetitions=100, snr_db=40.0)
    rows = [row(effect.effect, repeat([effect], given.repetitions, given.snr_db)) for effect in EFFECTS]
    both = repeat([EFFECTS[1]], given.repetitions, given.snr_db, linear=off())
    rows.append(row("cubic_stiffness, linear part off", both))
    show("Coverage", rows, given.json)


if __name__ == "__main__":
    main()
