"""Local polynomial method: settled records give the plain estimate, records with a transient give it as well."""

import json
from dataclasses import replace
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

import two_masses
from conftest import make_frames, make_rig, make_run
from creak.cli import run
from creak.config.model import load_model
from creak.config.rig import load_rig
from creak.errors import MeasurementError
from creak.localpolynomial import settled
from creak.mechanics.system import assemble
from creak.monitor import Monitor
from creak.network import estimate
from creak.records import Estimate, Fault, FaultKind, Scope
from creak.sources.settled import SettledSource
from creak.sources.simulated import SimulatedRig
from creak.statistics import Sums
from test_network import chain_stiffness

BEAM = Path(__file__).parents[1] / "service" / "creak" / "examples" / "beam"
N = 128
LINES = tuple(range(4, 40))


def periodic(rng, q, channels, P):
    """Records (q, channels, P N) of periodic signals with power at all lines of a period."""
    one = np.fft.irfft(
        np.exp(2j * np.pi * rng.random((q, channels, N // 2 + 1))) * (np.arange(N // 2 + 1) > 0), n=N
    )
    return np.tile(one, P)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 6), st.integers(1, 3), st.integers(0, 2**31), st.floats(1e-3, 1e3))
def test_a_periodic_record_without_noise_is_its_own_steady_state(P, q, seed, scale):
    """Kills a wrong line, a wrong 1/N, a transient that is read off where there is none."""
    records = scale * periodic(np.random.default_rng(seed), q, 2, P)
    got = settled(records, P, LINES)
    plain = np.fft.rfft(records.reshape(q, 2, P, N))[..., LINES] / N
    np.testing.assert_allclose(got, plain.transpose(0, 2, 3, 1), rtol=0, atol=1e-9 * scale)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 6), st.floats(0.02, 0.5), st.floats(3.2, 40.7), st.integers(0, 2**31), st.floats(-0.9, 0.9))
def test_a_decaying_mode_is_taken_off(P, decay, line, seed, level):
    """A mode of a width of 2 % of a line and more, anywhere between lines, in all channels: at least 40 dB go."""
    rng = np.random.default_rng(seed)
    records = periodic(rng, 2, 2, P)
    t = np.arange(P * N) / N
    ring = np.exp(-2 * np.pi * decay * t) * np.exp(2j * np.pi * line * t)
    shape = np.exp(2j * np.pi * rng.random((2, 2, 1))) * 10**level
    before = (shape * ring).real
    got = settled(records + before, P, LINES).mean(axis=1)
    plain = np.fft.rfft(records.reshape(2, 2, P, N))[..., LINES].mean(axis=2).swapaxes(1, 2) / N
    spoilt = np.fft.rfft(before.reshape(2, 2, P, N))[..., LINES].mean(axis=2) / N
    assert (np.abs(got - plain) ** 2).sum() < 1e-4 * (np.abs(spoilt) ** 2).sum()


@pytest.mark.parametrize("P", [2, 4, 7])
def test_scatter_and_mean_have_the_same_noise(P):
    """Noise in, and the F test's two variances agree: kills a scale that forgets what the fit takes or adds."""
    rng = np.random.default_rng(5)
    between, within, plain = [], [], []
    for _ in range(60):
        noise = rng.standard_normal((2, 2, P * N))
        got = settled(noise, P, LINES)
        mean = got.mean(axis=1)
        between.append(P * (np.abs(mean) ** 2).mean())
        within.append((np.abs(got - mean[:, None]) ** 2).sum(axis=1).mean() / (P - 1))
        plain.append(1 / N)
    assert abs(np.mean(between) / np.mean(within) - 1) < 0.05  # for P = 2 8,640 numbers stand behind each: 1.5 %
    assert 1.0 < np.mean(within) / np.mean(plain) < 1.2


@pytest.mark.parametrize("snr_db", [40.0, 60.0])
def test_levels_of_a_settled_record_are_the_exact_ones_but_for_the_transients_uncertainty(snr_db):
    """Three masses, linear, white sensor noise of a known variance: the noise of a node's residual is that
    variance times 1 + |G|^2. Plain levels lie there, these 0.39 dB higher: 1 + 9/4 / 24, what a parabola through
    24 lines adds at their middle. Kills a wrong degree of freedom or a rational fit that pays for noise.
    """
    rng = np.random.default_rng(3)
    P, samples, lines = 4, 2048, tuple(range(8, 160))
    example = Path(__file__).parents[1] / "deploy" / "examples" / "three-mass"
    rig = replace(load_rig(example / "rig.toml"), period_samples=samples, lines=lines, transient_periods=0)
    rig = replace(rig, sample_rate=rig.sample_rate / 4, network=None)
    S = assemble(load_model(example / "model-linear.toml"), rig).response(rig.frequencies)
    Z = np.linalg.inv(S)
    G = Z / np.einsum("fii->fi", Z)[:, :, None]  # 1 on the diagonal: the node's own noise
    turn = np.exp(-2j * np.pi * np.outer(np.arange(3), np.arange(3)) / 3)
    above = []
    for _ in range(6):
        sums = {"plain": [], "local": []}
        for _ in range(5):
            U = np.exp(2j * np.pi * rng.random((len(lines), 3)))[None] * turn[:, None, :]
            full = np.zeros((3, 6, samples // 2 + 1), dtype=complex)
            full[:, :3, lines] = U.swapaxes(1, 2)
            full[:, 3:, lines] = np.einsum("fij,cfj->cif", S, U)
            records = np.tile(np.fft.irfft(full * samples, n=samples), P)
            sigma = np.sqrt((records[:, 3:] ** 2).mean()) * 10 ** (-snr_db / 20)
            records[:, 3:] += sigma * rng.standard_normal(records[:, 3:].shape)
            plain = np.fft.rfft(records.reshape(3, 6, P, samples))[..., lines].transpose(0, 2, 3, 1) / samples
            sums["plain"].append(Sums.of(plain, 3))
            sums["local"].append(Sums.of(settled(records, P, lines), 3))
        exact = 10 * np.log10((np.abs(G) ** 2).sum(axis=(0, 2)) * sigma**2 / samples)
        got = {name: estimate(rig, reduce(add, each), Scope.RUN, 0, 2) for name, each in sums.items()}
        levels = {name: np.array([node.noise_db for node in one.nodes]) for name, one in got.items()}
        above.append([levels["plain"] - exact, levels["local"] - exact])
    plain, local = np.mean(above, axis=0)  # of six recordings: a level spreads by 0.2 dB, the mean by 0.08
    np.testing.assert_allclose(plain, 0.0, atol=0.33)
    np.testing.assert_allclose(local - plain, 10 * np.log10(1 + 9 / 4 / 24), atol=0.1)


def test_p_values_stay_uniform_with_a_transient():
    """120 linear recordings of a chain with noise, P = 3, that begin with ringing modes."""
    rng = np.random.default_rng(3)
    lines = tuple(range(6, 30, 2))
    rig = make_rig(3, samples=N, lines=lines, transient=0)
    Z = chain_stiffness(len(lines), rng)
    S = np.linalg.inv(Z)
    t = np.arange(3 * N) / N
    p = []
    for _ in range(120):
        sums = []
        for _ in range(3):
            phase = np.exp(2j * np.pi * rng.random((len(lines), 3)))
            turn = np.exp(-2j * np.pi * np.outer(np.arange(3), np.arange(3)) / 3)
            U = phase[None] * turn[:, None, :]
            full = np.zeros((3, 6, N // 2 + 1), dtype=complex)
            full[:, :3, lines] = U.swapaxes(1, 2)
            full[:, 3:, lines] = np.einsum("fij,cfj->cif", S, U)
            records = np.tile(np.fft.irfft(full * N, n=N), 3)
            ring = np.exp((-2 * np.pi * 0.1 + 2j * np.pi * 12.4) * t)
            records[:, 3:] += (3 * rng.standard_normal((3, 3, 1)) * ring).real
            records[:, 3:] += 0.05 * rng.standard_normal((3, 3, 3 * N))
            sums.append(Sums.of(settled(records, 3, lines), 3))
        got = estimate(rig, reduce(add, sums), Scope.RUN, 0, 2)
        p.append([node.p_value for node in got.nodes])
    p = np.array(p)
    for i in range(3):
        share = (p[:, i] < 0.05).mean()
        assert share < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 120)
        assert scipy.stats.kstest(p[:, i], "uniform").statistic < 0.2


def lightly_damped(z):
    """The example's beam with suspension and own modes damped by about ``z``."""
    model = load_model(BEAM / "model.toml")
    stations = tuple(replace(s, suspension_damping=s.suspension_damping * z / 0.06) for s in model.stations)
    return replace(model, damping_ratio=z, stations=stations)


def levels(model, rig, transient, keep, draw=0):
    """Networked noise and total, and classical noise; five realisations of four periods, 3 um of noise: the same
    for the same draw."""
    rig = replace(rig, transient_periods=transient)
    source = SimulatedRig(rig, model, steady_periods=4, rms=0.02, seed=3, realisations=5, substeps=4)

    def noise(f):
        kept = f.period - transient if f.period >= transient else 99
        rng = np.random.default_rng((draw, f.realisation, f.experiment, kept))
        return 3e-6 * rng.standard_normal(f.y.shape)

    class Noisy:
        live, run, close = False, source.run, source.close

        def frames(self):
            return (replace(f, y=f.y + noise(f)) for f in source.frames())

    feed = keep(Noisy())
    monitor = Monitor(feed.run)
    outcomes = [o for frame in feed.frames() for o in monitor.take(frame)]
    last = [o for o in outcomes if getattr(o, "scope", None) is Scope.RUN][-1]
    return np.array([[node.noise_db, node.total_db, node.classical_noise_db] for node in last.nodes])


def test_the_beam_with_suspension_modes_of_one_per_cent():
    """Periods of 2 s, first period included: plain averaging is wrong by more than 10 dB, this by less than 1.

    With the same noise: another draw moves even settled networked levels, which hang on the few lines where
    ``|G|`` is large, by 1 dB (0.5 to 1.3 dB between six draws), and the classical ones, a sum of equals, by 0.1.
    """
    rig = replace(load_rig(BEAM / "rig.toml"), period_samples=8192, lines=tuple(range(2, 200)))
    model = lightly_damped(0.01)
    truth = levels(model, rig, 16, lambda source: source)
    plain = levels(model, rig, 0, lambda source: source)
    local = levels(model, rig, 0, SettledSource)
    another = levels(model, rig, 16, lambda source: source, draw=1)
    assert (plain - truth)[:, :2].min() > 10
    assert np.abs(local - truth)[:, :2].max() < 1
    assert np.abs(another - truth)[:, :2].max() < 3
    assert np.abs(another - truth)[:, 2].max() < 0.3


class Listed:
    """A source of given frames."""

    live = False

    def __init__(self, run, items):
        self.run, self._items = run, items

    def frames(self):
        return iter(self._items)

    def close(self):
        pass


def test_incomplete_and_damaged_realisations_are_named_and_the_rest_is_whole():
    """Kills a record that is joined over a missing frame, and a frame that vanishes without being named."""
    plan = make_run(make_rig(2, samples=64, lines=range(2, 28)), steady=2)
    frames = make_frames(plan, 4, seed=1)
    broken = [f for f in frames if (f.realisation, f.experiment, f.period) != (1, 0, 0)]
    broken = [
        replace(f, y=f.y * np.nan) if (f.realisation, f.experiment, f.period) == (2, 1, 2) else f for f in broken
    ]

    source = SettledSource(Listed(plan, broken))
    assert (source.run.rig.transient_periods, source.run.steady_periods) == (0, 3)
    monitor = Monitor(source.run)
    outcomes = [o for item in source.frames() for o in monitor.take(item)] + monitor.finish()
    found = [o.kind for o in outcomes if isinstance(o, Fault)]
    assert found == [FaultKind.INCOMPLETE, FaultKind.NOT_FINITE, FaultKind.INCOMPLETE]
    assert monitor.counts.realisations == 2
    assert monitor.counts.frames + monitor.counts.rejected_frames == len(broken)


def test_late_frames_and_frames_of_no_plan_are_named_and_enter_nothing():
    """Kills a realisation that a late frame cuts in two: its raw periods, transient ones included, would count."""
    plan = make_run(make_rig(2, samples=64, lines=range(2, 28)), steady=2)
    frames = make_frames(plan, 4, seed=1)
    lost = frames[7]  # of realisation 1, which comes during realisation 2
    wild = replace(frames[14], realisation=10**9, experiment=7)
    late = [f for f in frames if f is not lost]
    late[14:14] = [frames[2], lost, wild]
    outcomes = {}
    for name, items in (("without", [f for f in frames if f is not lost]), ("with", late)):
        source = SettledSource(Listed(plan, items))
        monitor = Monitor(source.run)
        outcomes[name] = [o for item in source.frames() for o in monitor.take(item)] + monitor.finish()
        assert monitor.counts.realisations == 3
    named = [o.kind for o in outcomes["with"] if isinstance(o, Fault)]
    assert sorted(named) == sorted([FaultKind.INCOMPLETE, FaultKind.OUT_OF_PLAN, FaultKind.LATE, FaultKind.LATE])
    levels_of = [[o.nodes for o in each if isinstance(o, Estimate)] for each in outcomes.values()]
    assert levels_of[0] == levels_of[1]


@pytest.mark.parametrize(("shape", "P"), [((2, 2, 128), 1), ((2, 2, 130), 4), ((1, 1, 16), 2)])
def test_records_that_cannot_be_used_are_named(shape, P):
    with pytest.raises(MeasurementError, match=str(shape[2])):
        settled(np.zeros(shape), P, (1,))


def test_replay_by_the_local_polynomial_method(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(two_masses.rig(rate=256.0, transient=1, band=(2.0, 60.0)))
    (tmp_path / "model.toml").write_text(two_masses.model(1.0))
    base = ["simulate", "--model", "model.toml", "--rig", "rig.toml", "--snr-db", "60", "--realisations", "4"]
    assert run([*base, "--steady-periods", "3", "--output", "a.mcap"]) == 0
    documents = {}
    for method in ("plain", "lpm"):
        capsys.readouterr()
        assert run(["replay", "--json", "--method", method, "a.mcap"]) == 0
        documents[method] = json.loads(capsys.readouterr().out)
    assert [flaw["kind"] for flaw in documents["plain"]["quality"]] == ["transient"]
    assert documents["lpm"]["quality"] == []
    assert documents["lpm"]["frames"] == 4 * 2 * 4
    for plain, local in zip(documents["plain"]["nodes"], documents["lpm"]["nodes"], strict=True):
        assert abs(local["signal_db"] - local["noise_db"] - 60) < 20
        assert plain["noise_db"] > local["noise_db"] + 10
    assert run(["replay", "--method", "lmp", "a.mcap"]) == 2
