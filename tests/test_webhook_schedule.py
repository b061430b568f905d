"""When messages are tried again, and how many go at once: bounds that hold for any dice and any clock."""

from datetime import UTC, datetime
from email.utils import format_datetime

from hypothesis import given
from hypothesis import strategies as st

from creak.webhooks.schedule import SECOND, RateCap, Schedule, read_retry_after
from store_records import START


@given(st.integers(1, 20), st.floats(0, 1, exclude_max=True), st.none() | st.floats(0, 1e9))
def test_schedule_keeps_its_bounds(failures, dice, asked):
    schedule, now = Schedule(), START
    due = schedule.next_at(now, failures, dice, asked)
    if failures > len(schedule.delays):
        assert due is None
        return
    seconds = (due - now) / SECOND
    delay = schedule.delays[failures - 1]
    low, high = 0.8 * delay, 1.2 * delay
    if asked is not None:
        low, high = max(low, min(asked, 86400)), max(high, min(asked, 86400))
    assert low - 1e-6 <= seconds <= high + 1e-6


def test_retry_after_is_read_as_number_and_as_date():
    later = datetime.fromtimestamp(START / SECOND + 90, UTC)
    assert read_retry_after("120", START) == 120
    assert read_retry_after(format_datetime(later, usegmt=True), START) == 90
    assert read_retry_after("Wed, 21 Oct 2015 07:28:00 GMT", START) == 0
    for nonsense in ("", "soon", "-5", "1e3", "9" * 30):
        assert read_retry_after(nonsense, START) is None


@given(st.lists(st.floats(0, 5), min_size=1, max_size=200))
def test_rate_cap_never_lets_more_through(pauses):
    """Kills a bucket that overflows after a quiet time."""
    cap, now, taken = RateCap(per_minute=60, burst=3), 0.0, []
    for pause in pauses:
        now += pause
        if cap.take(now) == 0:
            taken.append(now)
    for i, first in enumerate(taken):
        for j in range(i, len(taken)):
            assert j - i + 1 <= 3 + (taken[j] - first) + 1e-6
