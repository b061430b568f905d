"""The simulated rig as a source: order, times, noise, pace, end."""

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.errors import ConfigurationError, SimulationError
from creak.mechanics.effects import CubicStiffness, Damping
from creak.mechanics.structure import Link, Lumped, PointMass
from creak.mechanics.system import assemble
from creak.multisine import realisation
from creak.records import FrameStatus, Node, Rig
from creak.sources.simulated import SimulatedRig

RIG = Rig("pair", 512.0, 256, 3, tuple(range(2, 30)), (Node("1", "m", "N"), Node("2", "m/s", "N")))
PAIR = Lumped(
    (PointMass("1", 1.0), PointMass("2", 2.0)),
    (Link(("1", "ground"), 2e3, 40.0), Link(("1", "2"), 3e3, 40.0), Link(("2", "ground"), 2e3, 40.0)),
)
CUBIC = replace(PAIR, effects=(CubicStiffness(("2", "ground"), 1e7),))
BEAM = Path(__file__).parents[1] / "deploy" / "examples" / "beam"


def make(rig=RIG, model=PAIR, **other):
    parameters = {"steady_periods": 2, "rms": 5.0, "seed": 3, "realisations": 2, **other}
    return SimulatedRig(rig, model, **parameters)


def responses(source):
    return np.array([frame.y for frame in source.frames()])


def test_frames_come_in_order_with_recorded_times():
    """Counted from 0, transients included; times from start and sample count, not from a clock."""
    source = make(start=10**18 + 7)
    frames = list(source.frames())
    assert [(f.realisation, f.experiment, f.period) for f in frames] == [
        (m, c, p) for m in range(2) for c in range(2) for p in range(5)
    ]
    assert [f.time for f in frames] == [10**18 + 7 + round(i * RIG.period_ns) for i in range(20)]
    assert {f.status for f in frames} == {FrameStatus.ACCEPTED}
    assert source.run.periods == 5
    assert source.run.excitation.rms == 5.0
    for frame in frames:
        np.testing.assert_array_equal(frame.u, realisation(RIG, 5.0, 3, frame.realisation)[frame.experiment])
        assert frame.y.shape == (2, 256)


def test_steady_frames_are_the_linear_response():
    """The whole path from multisine to response, against S from the matrices, in two units."""
    system = assemble(PAIR, RIG)
    S = system.response(RIG.frequencies)
    lines = list(RIG.lines)
    source = make(realisations=1)
    for frame in source.frames():
        if frame.period == 4:
            Y = np.einsum("fij,jf->if", S, np.fft.rfft(frame.u)[:, lines])
            found = np.fft.rfft(frame.y)[:, lines]
            error = np.sum(np.abs(found - Y) ** 2, axis=1) / np.sum(np.abs(Y) ** 2, axis=1)
            assert np.max(10 * np.log10(error)) < -65
    assert source.resolution.error_db < -70


def test_a_realisation_does_not_depend_on_what_came_before():
    """A shared random stream would make a run impossible to resume or to repeat in part."""
    long = responses(make(realisations=3, snr_db=40.0))
    short = responses(make(realisations=2, snr_db=40.0))
    changed = responses(make(realisations=3, snr_db=40.0, changes=[(1, CUBIC)]))
    np.testing.assert_array_equal(long[:20], short)
    np.testing.assert_array_equal(long[:10], changed[:10])
    assert np.all(np.abs(long[10:] - changed[10:]).max(axis=(1, 2)) > 0)


def test_the_number_of_threads_changes_no_bit():
    """A sum whose order hung on the threads would make a recording of another machine another recording."""
    runs = [make(realisations=5, snr_db=40.0, changes=[(2, CUBIC)], threads=threads) for threads in (1, 2, 5)]
    one, *others = [responses(source) for source in runs]
    assert len(one) == 5 * 2 * 5
    for other in others:
        np.testing.assert_array_equal(other, one)


def test_what_fails_ahead_comes_in_its_turn():
    """Realisations are simulated ahead: the frames of those before the one that fails are still had."""
    unstable = replace(PAIR, effects=(Damping(("1", "ground"), -500.0),))
    frames = make(realisations=4, changes=[(2, unstable)]).frames()
    assert [next(frames).realisation for _ in range(20)] == [0] * 10 + [1] * 10
    with pytest.raises(SimulationError, match="grows without bound"):
        next(frames)


def test_what_is_ahead_is_given_up_with_the_frames():
    """Who takes no more frames must not wait for realisations that nobody wants."""
    rig = replace(load_rig(BEAM / "rig.toml"), transient_periods=1)
    source = SimulatedRig(
        rig, load_model(BEAM / "model.toml"), steady_periods=40, rms=0.02, seed=1, substeps=1, threads=2
    )
    frames = source.frames()
    next(frames)
    begun = time.monotonic()
    frames.close()
    assert time.monotonic() - begun < 1.0
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("creak-simulation")]


def test_noise_is_white_and_as_strong_as_asked_for():
    """The ratio in power and per node; fixed by the first realisation, also after the model has changed."""
    clean, noisy = (responses(make(realisations=3, snr_db=snr, changes=[(1, CUBIC)])) for snr in (None, 20.0))
    steady = clean.reshape(3, 2, 5, 2, 256)[0, :, 3:]
    sigma = 0.1 * np.sqrt(np.mean(steady**2, axis=(0, 1, 3)))
    noise = (noisy - clean) / sigma[:, None]  # stepping errors of -30 dB re signal lie 10 dB below the noise
    spread = noise.reshape(3, -1, 2, 256)
    np.testing.assert_allclose(np.std(spread, axis=(1, 3)), 1.0, rtol=0.1)
    lag = np.mean(noise[..., 1:] * noise[..., :-1])
    assert abs(lag) < 0.1
    assert abs(np.mean(noise[:, 0] * noise[:, 1])) < 0.1


def test_ends_soon_when_closed_during_a_paced_wait():
    """A period of 4 s must not keep Ctrl-C waiting."""
    rig = replace(RIG, sample_rate=1.0)
    source = make(rig=rig, model=PAIR, pace=1.0)
    threading.Timer(0.3, source.close).start()
    begun = time.monotonic()
    assert list(source.frames()) == []
    assert time.monotonic() - begun < 5.0
    source.close()
    assert list(source.frames()) == []


@pytest.mark.parametrize("delay", [0.02, 0.15, 0.5])
def test_ends_soon_when_closed_during_a_simulation(delay):
    """Neither the choice of the steps nor a realisation of any length may keep Ctrl-C waiting."""
    next(make().frames())  # compiled
    rig = replace(load_rig(BEAM / "rig.toml"), transient_periods=20)
    model = load_model(BEAM / "model-cubic.toml")
    source = SimulatedRig(rig, model, steady_periods=30, rms=0.02, seed=1, snr_db=90.0)
    closed = []

    def close():
        closed.append(time.monotonic())
        source.close()

    threading.Timer(delay, close).start()
    assert list(source.frames()) == []
    assert time.monotonic() - closed[0] < 1.0


def test_pace_is_that_of_the_recorded_time_and_may_change():
    """Real time at 1.0: a frame comes when its last sample would have been taken, not before."""
    source = make(pace=5.0, realisations=1)  # 0.5 s a period: 0.1 s a frame
    frames = source.frames()
    begun = time.monotonic()
    next(frames)
    first = time.monotonic()
    for _ in range(4):
        next(frames)
    waited = time.monotonic() - first
    assert first - begun >= 0.1
    assert 0.25 <= waited <= 1.0
    source.pace = None
    rest = time.monotonic()
    assert len(list(frames)) == 5
    assert time.monotonic() - rest < 0.2


def test_a_failing_simulation_reaches_the_caller():
    """An error in a thread of its own must not be lost, nor leave the iteration waiting."""
    unstable = replace(PAIR, effects=(Damping(("1", "ground"), -500.0),))
    source = make(model=unstable)
    with pytest.raises(SimulationError, match="grows without bound"):
        list(source.frames())


@pytest.mark.parametrize(
    ("key", "value"),
    [("steady_periods", 0), ("rms", 0.0), ("rms", float("nan")), ("seed", -1), ("snr_db", float("inf")),
     ("realisations", 0), ("pace", 0.0), ("threads", 0)],
)  # fmt: skip
def test_refuses_parameters_out_of_range(key, value):
    with pytest.raises(ConfigurationError, match=rf"simulated rig: {key}: {value!r}, must be"):
        make(**{key: value})
