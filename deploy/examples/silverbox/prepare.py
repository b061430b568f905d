"""Cut the realisations out of the Silverbox file, and fit the linear model with which the diagnosis begins.

Realisation r = 0 ... 9 is the 8192 samples that end at index 49168 + 8692 r (exclusive), odd lines 1 ... 2683.
The first five go into ``train.npz``, the others into ``test.npz``. ``linear.toml`` is the mass, spring and damper
whose response ``1/(k + jw c - w^2 m)`` comes nearest to the output of the five, in least squares over their lines:
the best linear model of second order, the nonlinearity being taken into it as far as it goes.

    python prepare.py SNLS80mV.mat
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares

PERIOD, RATE, TRAINING = 8192, 610.35, 5
LINES = np.arange(1, 2684, 2)


def realisations(path):
    """Inputs and responses ``(realisation, 1, sample)``, V."""
    file = loadmat(path)
    ends = 49168 + 8692 * np.arange(10)
    u, y = (np.array([file[key].ravel()[end - PERIOD : end] for end in ends])[:, None] for key in ("V1", "V2"))
    return u - u.mean(axis=-1, keepdims=True), y  # the multisine has no mean: what there is, is the amplifier's


def best_linear(u, y):
    """Stiffness, damping and mass of least squares in the output."""
    U, Y = (np.fft.rfft(x[:, 0])[:, LINES] for x in (u, y))
    s = 2j * np.pi * LINES * RATE / PERIOD
    terms = np.stack([np.ones(len(s)), s, s**2])
    begin = np.array([1.0, 2e-4, 5e-6])

    def rest(scaled):
        e = U / ((scaled * begin) @ terms) - Y
        return np.concatenate([e.real.ravel(), e.imag.ravel()])

    return least_squares(rest, np.ones(3)).x * begin


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, help="SNLS80mV.mat")
    parser.add_argument("--output", type=Path, default=Path(), help="folder to write into")
    arguments = parser.parse_args()
    u, y = realisations(arguments.file)
    np.savez(arguments.output / "train.npz", u=u[:TRAINING], y=y[:TRAINING])
    np.savez(arguments.output / "test.npz", u=u[TRAINING:], y=y[TRAINING:])
    stiffness, damping, mass = (float(value) for value in best_linear(u[:TRAINING], y[:TRAINING]))
    text = (
        f'kind = "lumped"\n[[masses]]\nname = "1"\nmass = {mass!r}\n'
        f'[[links]]\nbetween = ["ground", "1"]\nstiffness = {stiffness!r}\ndamping = {damping!r}\n'
    )
    (arguments.output / "linear.toml").write_text(text)
    print(f"stiffness {stiffness:.5g} N/m, damping {damping:.5g} N s/m, mass {mass:.5g} kg")


if __name__ == "__main__":
    main()
