"""A mode that the model lacks: blind cases of an attached mass, and how near its three numbers are found.

``python tests/bench/bench_resonator.py [--cases 20] [--seed 1] [--processes 2] [--json FILE]``
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind import chosen

if __name__ == "__main__":
    chosen.command(__doc__, ("resonator",), cases=20)
