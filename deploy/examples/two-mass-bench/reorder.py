"""Reorder a recording of the two-mass bench into a measurement that ``creak import`` reads.

The file holds one record of 20 periods a variable: ``iq_adx`` is the measured motor current (A), ``omega_max``
and ``omega_may`` are the speeds of motor and load (rad/s). A measurement has ``(experiment, channel, sample)``:
here one experiment, one input and two responses. The first period is transient and stays in; ``rig.toml`` says so.

    python reorder.py MultisineTypeB.mat bench.npz
"""

import argparse
from pathlib import Path

import numpy as np
import scipy.io

INPUTS = ("iq_adx",)
RESPONSES = ("omega_max", "omega_may")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path, help="MAT file of the bench")
    parser.add_argument("output", type=Path, help="NPZ file to write")
    arguments = parser.parse_args()
    variables = scipy.io.loadmat(arguments.recording, squeeze_me=True, variable_names=[*INPUTS, *RESPONSES])
    u, y = (np.stack([variables[name] for name in names])[np.newaxis] for names in (INPUTS, RESPONSES))
    np.savez(arguments.output, u=u, y=y)
    print(f"{arguments.output}: u {u.shape}, y {y.shape}")


if __name__ == "__main__":
    main()
