"""What has changed since a healthy recording: blind cases in which that recording takes the place of the model.

``python tests/bench/bench_reference.py [--cases 30] [--seed 1] [--processes 2] [--json FILE]``
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind import chosen
from blind.effects import LINEAR, NONLINEAR

if __name__ == "__main__":
    chosen.command(__doc__, (*LINEAR, *NONLINEAR), cases=30, healthy=True)
