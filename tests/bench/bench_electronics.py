"""Actuators and sensors told from mechanical effects: blind cases of every electronic effect, and what is said.

``python tests/bench/bench_electronics.py [--cases 36] [--seed 1] [--processes 2] [--json FILE]``
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind import chosen
from blind.effects import ACTUATOR, SENSOR

if __name__ == "__main__":
    chosen.command(__doc__, (*ACTUATOR, *SENSOR), cases=36)
