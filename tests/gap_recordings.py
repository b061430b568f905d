"""Recordings for the tests of the diagnosis: three masses, short periods, steady state and white noise."""

import functools

import numpy as np

from creak.gap.hypothesis import Hypothesis, apply
from creak.gap.periodic import gather
from creak.mechanics.steady import simulate_steady
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.records import Excitation, Frame, Node, Rig, Run

CHAIN = Lumped(
    (PointMass("1", 1.0), PointMass("2", 0.8), PointMass("3", 1.2)),
    (
        Link(("ground", "1"), 2e4, 8.0),
        Link(("1", "2"), 3.5e4, 8.0),
        Link(("2", "3"), 5e4, 8.0),
        Link(("3", "ground"), 8e4, 8.0),
    ),
)


def rig_of(output="m", hold="band-limited"):
    return Rig(
        name="three-mass",
        sample_rate=1000.0,
        period_samples=2048,
        transient_periods=0,
        lines=tuple(range(10, 205)),
        nodes=tuple(Node(name, output, "N") for name in "123"),
        hold=hold,
    )


RIG = rig_of()


@functools.lru_cache(maxsize=64)
def _recording(effects, linear, realisations, periods, rms, snr_db, seed, rig):
    system = assemble(apply(CHAIN, Hypothesis(effects, linear)), rig)
    u = np.concatenate([realisation(rig, rms, seed, m) for m in range(realisations)])
    steady = simulate_steady(system, u, rig.sample_rate, rig.hold)
    assert steady.settled
    rng = np.random.default_rng(seed)
    sigma = np.sqrt(np.mean(steady.y**2, axis=(0, 2)))[:, None] * 10 ** (-snr_db / 20)
    run = Run("gap", rig, periods, 0, Excitation("multisine", rms=rms, seed=seed), "simulated")
    frames = [
        Frame(
            e // rig.q,
            e % rig.q,
            p,
            0,
            u[e],
            steady.y[e] + sigma * rng.standard_normal(sigma.shape[:1] + u.shape[-1:]),
        )
        for e in range(len(u))
        for p in range(periods)
    ]
    return gather(run, frames)


def recording(effects=(), *, linear=(), realisations=5, periods=2, rms=50.0, snr_db=40.0, seed=1, rig=RIG):
    """Data of the chain with effects in it and linear elements changed."""
    return _recording(tuple(effects), tuple(linear), realisations, periods, rms, snr_db, seed, rig)
