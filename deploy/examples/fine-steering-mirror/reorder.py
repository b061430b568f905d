"""Reorder the arrays of the fine steering mirror into a measurement that ``creak import`` reads.

The two files of one level hold ``(sample, channel, experiment, period)``. A measurement has
``(experiment, channel, sample)`` with the periods of an experiment joined. Experiments are in order already:
realisation by realisation, three experiments each.

    python reorder.py u_300mV_train.npy y_300mV_train.npy mirror-300mV.npz
"""

import argparse
from pathlib import Path

import numpy as np


def reorder(array):
    """Turn ``(sample, channel, experiment, period)`` into ``(experiment, channel, period times sample)``."""
    experiments = array.transpose(2, 1, 3, 0)
    return experiments.reshape(*experiments.shape[:2], -1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("u", type=Path, help="NPY file of the piezo voltages, V")
    parser.add_argument("y", type=Path, help="NPY file of the mirror displacements, m")
    parser.add_argument("output", type=Path, help="NPZ file to write")
    arguments = parser.parse_args()
    u, y = (reorder(np.load(path)) for path in (arguments.u, arguments.y))
    np.savez(arguments.output, u=u, y=y)
    print(f"{arguments.output}: u {u.shape}, y {y.shape}")


if __name__ == "__main__":
    main()
