"""Estimates at 10 to 20 dB signal-to-noise ratio: bias and spread of the output-error fit."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from creak.mechanics.effects import CubicStiffness, Hysteresis, OneSidedStop, QuadraticDamping
from repetitions import repeat

EFFECTS = (
    CubicStiffness(("3", "ground"), 1e8),
    OneSidedStop(("2", "1"), 4e4, 3e-4),
    QuadraticDamping(("2", "ground"), 30.0),
    Hysteresis(("3", "ground"), 4e4, 3e-4),
)


def main():
    """Print the table."""
    given = options(__doc__.splitlines()[0], repetitions=200)
    rows = []
    for effect in EFFECTS:
        for snr_db in (10.0, 15.0, 20.0):
            found = repeat([effect], given.repetitions, snr_db)
            for i, name in enumerate(found.names):
                rows.append(
                    {
                        "parameter": name,
                        "SNR, dB": snr_db,
                        "repetitions": given.repetitions,
                        "mean error, standard errors": float(found.bias[i]),
                        "spread over stated": float(found.spread[i]),
                        "intervals that hold the truth, %": 100 * float((abs(found.deviates[:, i]) < 1.96).mean()),
                    }
                )
    show("Low signal-to-noise ratio", rows, given.json)


if __name__ == "__main__":
    main()
