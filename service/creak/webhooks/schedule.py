"""When a message is tried again: pure, the caller has the clock and the dice."""

import re
from dataclasses import dataclass
from datetime import UTC
from email.utils import parsedate_to_datetime

SECOND = 1_000_000_000
HOUR = 3600.0


@dataclass(frozen=True)
class Schedule:
    """How attempts follow each other.

    Parameters
    ----------
    delays : tuple of float
        Seconds after the first failure, the second and so on; after the last one a message is given up.
    jitter : float
        Each delay is made longer or shorter by up to this fraction, so that what failed together does not come
        back together.
    longest_wait : float
        Seconds; a receiver that asks for more with ``Retry-After`` gets this.
    disable_after : float
        Seconds of failure without a success, after which a receiver is disabled.
    """

    delays: tuple[float, ...] = (
        1.0, 5.0, 30.0, 300.0, 1800.0, 2 * HOUR, 5 * HOUR, 10 * HOUR, 14 * HOUR, 20 * HOUR, 24 * HOUR,
    )  # fmt: skip
    jitter: float = 0.2
    longest_wait: float = 24 * HOUR
    disable_after: float = 120 * HOUR

    def next_at(self, now: int, failures: int, dice: float, retry_after: float | None = None) -> int | None:
        """Return when a message is due again, ns; None if it is given up.

        Parameters
        ----------
        now : int
            Wall clock, ns.
        failures : int
            How often it has failed, this time included.
        dice : float
            Uniform on [0, 1).
        retry_after : float or None
            What the receiver asked for, s; the message is not tried before.
        """
        if failures > len(self.delays):
            return None
        delay = self.delays[failures - 1] * (1 + self.jitter * (2 * dice - 1))
        if retry_after is not None:
            delay = max(delay, min(retry_after, self.longest_wait))
        return now + round(delay * SECOND)


def read_retry_after(value: str, now: int) -> float | None:
    """Return the seconds that a ``Retry-After`` header asks for, a number or a date; None if it is neither."""
    text = value.strip()
    if re.fullmatch(r"\d{1,9}", text, re.ASCII):
        return float(text)
    try:
        moment = parsedate_to_datetime(text)
    except ValueError:
        return None
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return max(0.0, moment.timestamp() - now / SECOND)


class RateCap:
    """A token bucket: so many a minute, a few more at once after a quiet time.

    Parameters
    ----------
    per_minute : float
    burst : int
    """

    def __init__(self, per_minute: float, burst: int) -> None:
        self._rate = per_minute / 60
        self._burst = float(burst)
        self._tokens = float(burst)
        self._at: float | None = None

    def take(self, now: float) -> float:
        """Take a token at a monotonic time in seconds; 0, or the seconds until there is one."""
        if self._at is not None:
            self._tokens = min(self._burst, self._tokens + max(0.0, now - self._at) * self._rate)
        self._at = now
        if self._tokens >= 1.0:
            self._tokens -= 1.0
            return 0.0
        return (1.0 - self._tokens) / self._rate
