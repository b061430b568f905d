"""An independent judge: the package ``best-linear-approximation`` on the same recordings.

The package needs Python 3.12 or newer, and creak does not, so each runs in its own environment and they meet in a
file::

    python tests/bench/judge.py write judge.npz                  # with creak installed
    python3.12 -m venv judge && judge/bin/pip install best-linear-approximation
    judge/bin/python tests/bench/judge.py compare judge.npz      # exit 1 if anything differs by more than 1e-6

Compared, as the largest difference over the largest value of each line:

* ``S``, the MIMO BLA (28);
* the noise covariance ``C`` of the responses over periods, between all nodes;
* the total covariance of ``Y - S U`` over all experiments, between all nodes;
* the total variance of every entry of ``S`` over realisations (20);
* the noise variance of ``S``, summed over the inputs.

What differs by definition, and is put into the judge's terms before it is compared:

* The judge's spectra are not divided by N.
* Its total covariance starts from ``T``, that of the means over P periods about the mean over experiments; (39) is
  that of single periods about the mean of each period, which is ``T + C (P - 1)/P`` less the scatter of the
  periods' common means: the same on average.
* It cuts the nonlinear part ``T - C/P`` at zero as a matrix, by its eigenvalues, and adds ``C`` again; (41) cuts
  it node by node, and (39) is not cut at all.
* It takes the noise variance of ``S`` from ``S`` of each period, with the chance correlation between the noise of
  a realisation's experiments in it. The streaming sums do not keep that correlation, which is zero on average;
  theirs is ``C`` over the power of the inputs. Summed over the inputs it drops out, as the experiments are
  orthogonal.
"""

import sys
from functools import reduce
from operator import add

import numpy as np

TOLERANCE = 1e-6


def cases():
    """Name, rig, ``u (M, q, q, N)``, ``y (M, q, P, n, N)``: linear, cubic, and more nodes than inputs."""
    from dataclasses import replace

    from creak.mechanics.newmark import Stepper
    from creak.mechanics.system import assemble
    from creak.multisine import realisation
    from creak.paper.studies import three_masses
    from creak.records import Node

    for name, spring, driven, snr_db in (
        ("linear", 0.0, 3, 40.0),
        ("cubic", 1e8, 3, 40.0),
        ("tall", 1e8, 2, 60.0),
    ):
        rig, model = three_masses(spring)
        nodes = tuple(node if i < driven else Node(node.name, "m") for i, node in enumerate(rig.nodes))
        rig = replace(rig, nodes=nodes, network=None)
        stepper = Stepper(assemble(model, rig), rig.sample_rate, 1, rig.hold)
        u = np.stack([realisation(rig, 50.0, 1, m) for m in range(5)])
        y = np.array([[list(stepper.experiment(e, 5))[2:] for e in inputs] for inputs in u])
        rng = np.random.default_rng(7)
        y += 10 ** (-snr_db / 20) * y.std(axis=(0, 1, 2, 4))[:, None] * rng.standard_normal(y.shape)
        yield name, rig, u, y


def write(path):
    """Make recordings, estimate with creak, keep both."""
    from creak.statistics import Sums

    kept = {}
    for name, rig, u, y in cases():
        M, q, P, _, N = y.shape
        lines = np.array(rig.lines)
        U = np.broadcast_to(np.fft.rfft(u)[:, :, None][..., lines], (M, q, P, q, len(lines))) / N
        V = np.concatenate((U, np.fft.rfft(y)[..., lines] / N), axis=3).transpose(0, 1, 2, 4, 3)
        sums = reduce(add, (Sums.of(np.ascontiguousarray(block), q) for block in V))
        E = sums.experiments
        mean = sums.period_sums.mean(axis=0)[:, q:] / E
        noise = sums.within[:, q:, q:] / (E * (P - 1))
        means = (sums.between[:, q:, q:] / P - E * mean[:, :, None] * mean[:, None, :].conj()) / (E - 1)
        powers, turns = np.linalg.eigh(means - noise / P)
        nonlinear = (turns * np.maximum(powers, 0.0)[:, None, :]) @ turns.conj().swapaxes(1, 2)
        inverse = np.linalg.inv(sums.between[:, :q, :q] / P)
        kept |= {
            f"{name}.u": u,
            f"{name}.y": y,
            f"{name}.lines": lines,
            f"{name}.rate": rig.sample_rate,
            f"{name}.S": sums.S,
            f"{name}.noise covariance of Y": noise * N**2,
            f"{name}.total covariance of Y - S U": (nonlinear + noise) * N**2,
            f"{name}.total variance of S": sums.spread / (M * (M - 1)),
            f"{name}.noise variance of S": np.einsum("fii,fjj->fi", noise, inverse).real[:, :, None] / P,
        }
    np.savez(path, **kept)


def compare(path):
    """Estimate with the judge, print the largest differences; how many exceed the tolerance."""
    from best_linear_approximation import robust

    kept = np.load(path)
    failed = 0
    for name in dict.fromkeys(key.split(".")[0] for key in kept):
        u, y = kept[f"{name}.u"], kept[f"{name}.y"]
        judged = robust.known_input(
            np.ascontiguousarray(u.transpose(3, 2, 1, 0)),  # sample, input, experiment, realisation
            np.ascontiguousarray(y.transpose(4, 3, 1, 0, 2)),  # sample, node, experiment, realisation, period
            float(kept[f"{name}.rate"]),
            kept[f"{name}.lines"],
            independent_subexperiments=True,
            show_warnings=False,
        )
        Y, G = judged.spectra.Y, judged.G
        for what, theirs in (
            ("S", G.value),
            ("noise covariance of Y", Y.noise.cov[kept[f"{name}.lines"]]),
            ("total covariance of Y - S U", Y.total.cov),
            ("total variance of S", G.total.var),
            ("noise variance of S", G.noise.var.sum(axis=2)[:, :, None]),
        ):
            ours = kept[f"{name}.{what}"]
            size = np.abs(theirs).max(axis=(1, 2))
            worst = float((np.abs(ours - theirs).max(axis=(1, 2)) / size).max())
            failed += worst > TOLERANCE
            print(f"{name:8s}{what:30s}{worst:.1e} {'DIFFERS' if worst > TOLERANCE else 'agrees'}")
    return failed


def main():
    """Run one half."""
    if len(sys.argv) != 3 or sys.argv[1] not in ("write", "compare"):
        sys.exit(__doc__)
    if sys.argv[1] == "write":
        write(sys.argv[2])
    else:
        sys.exit(min(1, compare(sys.argv[2])))


if __name__ == "__main__":
    main()
