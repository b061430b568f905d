"""Rates of false alarms are kept: the bound, the CUSUM's run length, and what a healthy monitor really does."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from conftest import make_rig, make_run, random_spectra
from creak import alarms, limits, trend
from creak.alarm_records import BaselineRules, Limits, Verdict
from creak.network import estimate
from creak.records import Scope
from creak.statistics import Sums

RIG = make_rig(3)
RUN = make_run(RIG, limits=Limits(false_alarms_per_year=1.0))


def test_a_rate_becomes_a_threshold():
    """Three nodes, three experiments of three periods of one second: one window in 9 s."""
    assert limits.update_interval_s(RUN) == pytest.approx(9.0)
    assert limits.p_threshold(RUN) == pytest.approx(9.0 / (365.25 * 86400) / 3)
    assert limits.p_threshold(replace(RUN, limits=Limits(p_value=0.02))) == 0.02
    with_baseline = replace(RUN, baseline=BaselineRules(realisations=40))
    assert limits.p_threshold(with_baseline) == pytest.approx(limits.p_threshold(RUN) / 2)


@given(st.floats(0.01, 1000.0), st.integers(1, 4), st.integers(1, 12))
def test_the_bound_is_the_rate(rate, steady, window):
    """Windows a year x tests x p is the rate that was asked for: kills a factor lost on the way."""
    run = make_run(RIG, steady=steady, window=window, limits=Limits(false_alarms_per_year=rate))
    p = limits.p_threshold(run)
    assert limits.windows_per_year(run) * run.rig.n * p == pytest.approx(rate)


@pytest.mark.parametrize("exceeding", [1, 2])
def test_a_healthy_rig_alarms_no_more_often_than_asked(rng, exceeding):
    """The whole path on 2,500 overlapping windows of noise, the rate set to 20 false alarms in that time.

    The bound holds for any K, N and overlap. Of a Poisson count with mean 20 or less, 35 or more come with
    probability 1e-3; none at all (a test that cannot alarm) with 2e-9 where nothing is lost to clusters.
    """
    windows, wanted = 2500, 20.0
    year = limits.YEAR_S / limits.update_interval_s(RUN)
    run = replace(
        RUN,
        limits=Limits(
            total_to_noise_db=-100.0,  # significance alone
            dead_band_db=0.0,
            windows=3,
            exceeding=exceeding,
            false_alarms_per_year=wanted / windows * year,
        ),
    )
    spectra = random_spectra(rng, RIG, windows + run.window, 2)
    blocks = [Sums.of(s, RIG.q) for s in spectra]
    nodes = [alarms.NodeAlarm(alarms.Alarm("law", node.name)) for node in RIG.nodes]
    raised = 0
    for m in range(run.window, len(blocks)):
        summed = blocks[m - 3] + blocks[m - 2] + blocks[m - 1] + blocks[m]
        levels = estimate(RIG, summed, Scope.WINDOW, m, m).nodes
        for i, level in enumerate(levels):
            nodes[i], changes = alarms.step(run, nodes[i], level, m)
            raised += sum(change.event == "raised" for change in changes)
    assert raised < 35
    if exceeding == 1:
        assert raised >= 3


@pytest.mark.parametrize(
    ("threshold", "allowance", "exact"), [(4.0, 0.5, 168.0), (5.0, 0.5, 465.0), (8.01, 0.25, 370.0)]
)
def test_run_lengths_are_those_of_the_tables(threshold, allowance, exact):
    """D. C. Montgomery, *Introduction to Statistical Quality Control*, tables 9.3 and 9.4 (two-sided: half)."""
    assert limits.cusum_run_length(threshold, allowance) == pytest.approx(exact * 2, rel=0.03)
    assert limits.cusum_threshold(2 * exact, allowance) == pytest.approx(threshold, rel=0.03)


def first_false_trend(rng, run_length, count):
    """Windows until each of `count` unchanged machines, of any level and spread, has a false trend."""
    threshold = limits.cusum_threshold(run_length, trend.ALLOWANCE)
    lengths = []
    for _ in range(count):
        mean, spread = rng.uniform(-5, 20), rng.uniform(0.01, 2.0)
        state, n = trend.Trend(), 0
        while n < 20 * run_length:
            state, verdict = trend.take(state, mean + spread * rng.standard_normal(), threshold)
            n += 1
            if verdict is Verdict.EXCEEDS:
                break
        lengths.append(n)
    return np.array(lengths)


def test_the_trend_keeps_its_rate_whatever_level_and_spread_are(rng):
    """Mean run length 200 asked for, 150 machines that never change: the mean of 150 nearly exponential lengths
    lies within 3 standard errors (25 %); cutting at 3 and starting up only lengthen it, by at most a third."""
    lengths = first_false_trend(rng, 200.0, 150)
    assert 150 < lengths.mean() < 340


def test_a_trend_against_a_mean_learnt_once_would_not_keep_it(rng):
    """Why it is self-starting: the same CUSUM against mean and spread of 10 windows alarms much sooner."""
    threshold = limits.cusum_threshold(200.0, trend.ALLOWANCE)
    lengths = []
    for _ in range(150):
        learnt = rng.standard_normal(10)
        c = n = 0
        while c <= threshold and n < 4000:
            c = max(0.0, c + (rng.standard_normal() - learnt.mean()) / learnt.std(ddof=1) - trend.ALLOWANCE)
            n += 1
        lengths.append(n)
    assert np.median(lengths) < 0.7 * np.median(first_false_trend(rng, 200.0, 150))


def test_growth_stands_until_it_is_gone():
    """Kills a trend that learns the wear and then calls it healthy."""
    rng = np.random.default_rng(3)
    threshold = limits.cusum_threshold(1e4, trend.ALLOWANCE)
    state, verdicts = trend.Trend(), []
    for n in range(400):
        grown = 0.0 if n < 100 else min(0.02 * (n - 100), 2.0)
        state, verdict = trend.take(state, grown + 0.3 * rng.standard_normal(), threshold)
        verdicts.append(verdict)
    first = verdicts.index(Verdict.EXCEEDS)
    assert 100 < first < 150
    assert set(verdicts[first:]) == {Verdict.EXCEEDS}


def test_one_outlier_is_no_trend():
    rng = np.random.default_rng(4)
    threshold = limits.cusum_threshold(1e4, trend.ALLOWANCE)
    state = trend.Trend()
    for n in range(60):
        state, verdict = trend.take(state, 50.0 if n == 40 else rng.standard_normal(), threshold)
        assert verdict is not Verdict.EXCEEDS


@given(st.lists(st.floats(-50, 50), min_size=2, max_size=30))
def test_the_reference_is_mean_and_spread(levels):
    state = trend.Trend()
    for level in levels:
        state = trend.add(state, level)
    assert state.mean == pytest.approx(np.mean(levels), abs=1e-9)
    assert state.deviation == pytest.approx(np.std(levels, ddof=1), abs=1e-6)
