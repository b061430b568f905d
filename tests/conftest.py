"""What several tests share: a small linear rig with white sensor noise, frames of it, and stores of every kind."""

import numpy as np
import pytest

from creak.multisine import realisation
from creak.records import Excitation, Frame, Limits, Node, Rig, Run
from creak.sinks.database import open_store
from store_places import PLACES, place


def make_rig(n=3, q=None, lines=range(2, 14), samples=64, transient=1, network=None, name="law"):
    """A rig of n nodes of which the first q are driven."""
    q = n if q is None else q
    nodes = tuple(Node(name=str(i + 1), output="m", input="N" if i < q else None) for i in range(n))
    return Rig(
        name=name,
        sample_rate=64.0,
        period_samples=samples,
        transient_periods=transient,
        lines=tuple(lines),
        nodes=nodes,
        network=network,
    )


def random_spectra(rng, rig, realisations, periods, noise=1e-2, distortion=0.0):
    """Spectra (M, q, P, F, q + n) of a linear structure, white noise a period, distortion an experiment."""
    q, n, F = rig.q, rig.n, len(rig.lines)

    def gauss(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    S = gauss(F, n, q)
    rotation = np.exp(-2j * np.pi * np.outer(np.arange(q), np.arange(q)) / q)
    phase = np.exp(2j * np.pi * rng.random((realisations, 1, 1, F, q)))
    U = np.broadcast_to(phase * rotation[None, :, None, None, :], (realisations, q, periods, F, q))
    Y = np.einsum("fij,mcpfj->mcpfi", S, U)
    Y = Y + noise * gauss(realisations, q, periods, F, n) + distortion * gauss(realisations, q, 1, F, n)
    return np.concatenate((U, Y), axis=-1)


def pytest_collection_modifyitems(items):
    """Tests of whole systems take longest: they go first, so that no core is idle at the end."""
    items.sort(key=lambda item: "system" not in item.path.parts)


@pytest.fixture
def rng():
    return np.random.default_rng(20261121)


def make_run(rig, steady=2, window=4, limits=None, start=0, run_id="run"):
    """The opening of a run of the rig."""
    return Run(
        id=run_id,
        rig=rig,
        steady_periods=steady,
        start=start,
        excitation=Excitation("measured", rms=1.0),  # of whatever seed the frames have
        source="simulated",
        window=window,
        limits=limits or Limits(),
    )


def make_frames(run, realisations, seed=0, noise=1e-2, cubic=None):
    """Frames of a static structure ``y = A u`` with white sensor noise.

    From realisation ``cubic`` on, a cubic spring holds the last driven node: ``y = A (u - 0.05 y_last^3 e_last)``.
    """
    rig = run.rig
    rng = np.random.default_rng(seed)
    A = np.eye(rig.n, rig.q) + 0.3 * rng.standard_normal((rig.n, rig.q))
    frames = []
    count = 0
    for m in range(realisations):
        inputs = realisation(rig, 1.0, seed, m)
        for c in range(rig.q):
            motion = A @ inputs[c]
            if cubic is not None and m >= cubic:
                for _ in range(60):  # the fixed point of a weak spring
                    held = inputs[c].copy()
                    held[-1] -= 0.05 * motion[-1] ** 3
                    motion = 0.5 * motion + 0.5 * (A @ held)
            for p in range(run.periods):
                y = motion + noise * rng.standard_normal(motion.shape)
                time = run.start + round(count * run.rig.period_ns)
                frames.append(Frame(m, c, p, time, inputs[c].copy(), y))
                count += 1
    return frames


@pytest.fixture(params=PLACES)
def url(request, tmp_path):
    """URL of an empty database."""
    with place(request.param, tmp_path) as found:
        yield found


@pytest.fixture
def store(url):
    """An empty store."""
    made = open_store(url)
    yield made
    made.close()
