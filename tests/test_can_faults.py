"""A small sample of the 100,000 injected faults of ``tests/bench/bench_can_faults.py``."""

import importlib.util
from pathlib import Path

import numpy as np

from creak.records import FaultKind

spec = importlib.util.spec_from_file_location(
    "bench_can_faults", Path(__file__).parent / "bench/bench_can_faults.py"
)
bench = importlib.util.module_from_spec(spec)
spec.loader.exec_module(bench)


def test_no_estimate_differs_from_that_of_the_surviving_frames(tmp_path):
    """Kills whatever lets a lost, doubled, late, damaged or misplaced frame touch an estimate."""
    injected, compared, differing, named = bench.session(tmp_path, 11, 60, bench.RATES)
    assert min(injected.values()) > 0, injected
    assert sum(injected.values()) > 1500
    assert compared > 100
    assert differing == 0
    for kind in ("LOST", "DOUBLED", "CORRUPTED", "RESTARTED", "OUT_OF_PLAN"):
        assert named[FaultKind[kind]] > 0, kind


def test_the_judge_can_say_no(tmp_path, monkeypatch):
    """Kills a comparison that would find every stream alike: without checksums damaged samples come in."""
    monkeypatch.setattr(
        "creak.sources.can_pipeline.checksums_agree", lambda signal, data: np.ones(len(data), dtype=np.bool_)
    )
    rates = {**bench.RATES, "corrupted": 0.02}
    *_, differing, _ = bench.session(tmp_path, 11, 20, rates)
    assert differing > 0
