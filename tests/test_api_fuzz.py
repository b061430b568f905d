"""Requests made from the API's own document; the bench makes ten thousand of them, here are some."""

from bench.bench_fuzz import measure


def test_no_failure_of_ours_and_no_undocumented_answer():
    result = measure(80)
    assert result["failures"] == []
    assert result["requests"] >= 60
    assert result["operations"] > 20
