"""Estimates at 10 to 20 dB signal-to-noise ratio: bias and spread of the output-error fit."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from figures import options, show

from creak.mechanics.effects import CubicStiffness, Hysteresis, OneSidedStop, QuadraticDamping, Stiffness
from repetitions import repeat

EFFECTS = (
    Stiffness(("1", "3"), 800.0),  # nothing is bent here: what deviates is owed to the weights
    QuadraticDamping(("2", "ground"), 30.0),
    CubicStiffness(("3", "ground"), 1e8),
    OneSidedStop(("2", "1"), 4e4, 3e-4),
    Hysteresis(("3", "ground"), 4e4, 3e-4),
)
LEVELS_DB = (10.0, 15.0, 20.0)


def rows_of(snr_db, found):
    """One line of the table a parameter."""
    return [
        {
            "parameter": name,
            "SNR, dB": snr_db,
            "repetitions": len(found.deviates),
            "mean error, standard errors": float(found.bias[i]),
            "spread over stated": float(found.spread[i]),
            "intervals that hold the truth, %": 100 * float((abs(found.deviates[:, i]) < 1.96).mean()),
        }
        for i, name in enumerate(found.names)
    ]


def main():
    """Print the table, and every line of it on stderr as it comes."""
    given = options(__doc__.splitlines()[0], repetitions=200, realisations=2, first=0, effects=len(EFFECTS))
    rows = []
    for i in range(given.first, min(given.first + given.effects, len(EFFECTS))):
        for j, snr_db in enumerate(LEVELS_DB):
            # Draws of their own, so that one unlucky noise does not show in all lines of the table.
            seed = 1 + i * len(LEVELS_DB) + j
            found = repeat([EFFECTS[i]], given.repetitions, snr_db, realisations=given.realisations, seed=seed)
            for row in rows_of(snr_db, found):
                print(*row.values(), sep=", ", file=sys.stderr, flush=True)
                rows.append(row)
    show("Low signal-to-noise ratio", rows, given.json)


if __name__ == "__main__":
    main()
