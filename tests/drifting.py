"""A machine whose nonlinear distortion is set realisation by realisation, as period frames."""

import numpy as np

from creak.multisine import realisation
from creak.records import Frame


def drifting_frames(run, realisations, distortion, rms=lambda _m: 1.0, noise=lambda _m: 1e-2, seed=0):
    """Frames of ``y = A u + d + e`` with white noise ``e``; ``d`` is the same in all periods of an experiment.

    In every experiment it is another, as stochastic nonlinear distortion is.

    Parameters
    ----------
    run : Run
    realisations : int
    distortion : callable
        Standard deviation of d at the last node, in units of the noise's, by realisation.
    rms, noise : callable
        Of the excitation, and standard deviation of e, by realisation.
    """
    rig = run.rig
    rng = np.random.default_rng(seed)
    A = np.eye(rig.n, rig.q) + 0.3 * rng.standard_normal((rig.n, rig.q))
    count = 0
    for m in range(realisations):
        inputs = realisation(rig, rms(m), seed, m)
        for c in range(rig.q):
            motion = A @ inputs[c]
            motion[-1] += 1e-2 * distortion(m) * rng.standard_normal(rig.period_samples)
            for p in range(run.periods):
                y = motion + noise(m) * rng.standard_normal(motion.shape)
                yield Frame(m, c, p, run.start + round(count * rig.period_ns), inputs[c], y)
                count += 1
