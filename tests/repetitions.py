"""The output-error fit repeated over draws of the noise: bias, spread, and whether the stated errors cover."""

from dataclasses import dataclass

import numpy as np

from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.periodic import gather
from creak.gap.refine import conclude, vector, with_vector
from creak.gap.setting import Setting
from creak.mechanics.steady import simulate_steady
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.records import Excitation, Frame, Run
from gap_recordings import CHAIN, RIG


@dataclass(frozen=True)
class Repeated:
    """Deviations from the truth in stated standard errors, and in units, ``(repetitions, parameters)``."""

    names: tuple[str, ...]
    deviates: np.ndarray
    errors: np.ndarray
    stated: np.ndarray

    @property
    def covered(self):
        """Share of 95 % intervals that hold the truth."""
        return float(np.mean(np.abs(self.deviates) < 1.96))

    @property
    def bias(self):
        """Mean error in standard errors, a parameter."""
        return np.mean(self.deviates, axis=0)

    @property
    def spread(self):
        """Standard deviation of the errors over the stated one, a parameter."""
        return np.std(self.errors, axis=0, ddof=1) / np.sqrt(np.mean(self.stated**2, axis=0))


def repeat(effects, count, snr_db, *, linear=(), realisations=4, periods=2, seed=1, rig=RIG, top=260):
    """Fit the true effects anew for every draw of the noise, from parameters that are 2 % off.

    Parameters
    ----------
    effects : sequence of Effect
    count : int
    snr_db : float
    linear : sequence of (key, change)
        Linear numbers in which the recorded structure departs from the model, all of whose own are then free.
    """
    truth = Hypothesis(tuple(effects), tuple(linear))
    u = np.concatenate([realisation(rig, 50.0, seed, m) for m in range(realisations)])
    # As exact as the noise is small: what the solver leaves open would count as bias.
    steady = simulate_steady(
        assemble(apply(CHAIN, truth), rig), u, rig.sample_rate, rig.hold, oversampling=16, tolerance=1e-10
    )
    assert steady.settled
    sigma = np.sqrt(np.mean(steady.y**2, axis=(0, 2)))[:, None] * 10 ** (-snr_db / 20)
    run = Run("repeated", rig, periods, 0, Excitation("multisine", rms=50.0, seed=seed), "simulated")
    values = vector(truth)
    size = len(values)
    deviates, errors, stated = np.empty((3, count, size))
    start = with_vector(truth, values * 1.02)
    for k in range(count):
        rng = np.random.default_rng((seed, k))
        frames = [
            Frame(e // rig.q, e % rig.q, p, 0, u[e], steady.y[e] + sigma * rng.standard_normal(steady.y[e].shape))
            for e in range(len(u))
            for p in range(periods)
        ]
        data = gather(run, frames)
        every = np.arange(len(u))
        fit = conclude(Setting(rig, CHAIN, data, top), start, every, every[:0], whole=len(linear) > 2)
        assert fit.settled
        errors[k] = vector(fit.hypothesis)[:size] - values
        stated[k] = np.sqrt(np.diag(fit.covariance))[:size]
        deviates[k] = errors[k] / stated[k]
    names = [f"{effect.effect} {name}" for effect in effects for name in effect.parameters()]
    names += [f"{key[0]} {'-'.join(key[1])}" if isinstance(key[0], str) else key[0].effect for key, _ in linear]
    return Repeated(tuple(names), deviates, errors, stated)
