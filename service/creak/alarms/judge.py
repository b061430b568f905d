"""From windows to what stands: limits, K of N, and the severities that they ask for."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from creak.alarm_records import AlarmChange, AlarmState, Limits, Severity, Verdict
from creak.alarms.life import RANK, Alarm, demand
from creak.limits import p_threshold
from creak.records import NodeLevel, Run

SEVERITY: Mapping[str, tuple[str, Severity]] = {
    "alarm_level": ("level", "alarm"),
    "warning_level": ("level", "warning"),
    "baseline": ("baseline", "alarm"),
    "trend": ("trend", "warning"),
}
"""Criterion to the condition and the severity that it stands for."""

_AT_ONCE = {"trend"}  # has its own memory, so one window decides


@dataclass(frozen=True)
class Watch:
    """One criterion over the last windows.

    Parameters
    ----------
    recent : tuple of Verdict
        The last N windows, oldest first.
    stands : bool
    """

    recent: tuple[Verdict, ...] = ()
    stands: bool = False


@dataclass(frozen=True)
class NodeAlarm:
    """The process alarm of a node with what its criteria have seen.

    Parameters
    ----------
    alarm : Alarm
    watches : mapping of str to Watch
        By criterion, see `SEVERITY`.
    """

    alarm: Alarm
    watches: Mapping[str, Watch] = field(default_factory=dict)

    @property
    def state(self) -> AlarmState:
        """Its name in ISA-18.2."""
        return self.alarm.state

    @property
    def healthy(self) -> bool:
        """Nothing stands and nothing of the last windows asks for it: a baseline may learn from it."""
        return self.alarm.standing is None and not any(
            watch.stands or Verdict.EXCEEDS in watch.recent for watch in self.watches.values()
        )


def judge(level: NodeLevel, limits: Limits, p_limit: float, ratio_db: float) -> Verdict | None:
    """Where a window lies; None if its data carry no networked ratio.

    A window exceeds if clearance and significance say so together. One without significance lies below however
    large its ratio, for then noise alone explains it.

    Parameters
    ----------
    level : NodeLevel
    limits : Limits
        Gives the dead band.
    p_limit : float
        Largest p-value that is significant.
    ratio_db : float
        Clearance, dB.
    """
    if level.total_to_noise_db is None or level.p_value is None:
        return None
    if level.p_value >= p_limit:
        return Verdict.BELOW
    if level.total_to_noise_db > ratio_db:
        return Verdict.EXCEEDS
    if level.total_to_noise_db < ratio_db - limits.dead_band_db:
        return Verdict.BELOW
    return Verdict.BETWEEN


def step(
    run: Run, node: NodeAlarm, level: NodeLevel, time: int, verdicts: Mapping[str, Verdict] | None = None
) -> tuple[NodeAlarm, tuple[AlarmChange, ...]]:
    """Take one more window of a node.

    Parameters
    ----------
    run : Run
        Gives limits, rules and identity.
    node : NodeAlarm
        As it stood before.
    level : NodeLevel
        Of the window.
    time : int
        Recorded time at the window's end, ns since the Unix epoch.
    verdicts : mapping of str to Verdict
        Of further criteria that could be judged: ``baseline``, ``trend``.

    Returns
    -------
    NodeAlarm
        As it stands now.
    tuple of AlarmChange
        What changed, if anything.
    """
    limits = run.limits
    p_limit = p_threshold(run)
    seen: dict[str, Verdict | None] = {"alarm_level": judge(level, limits, p_limit, limits.total_to_noise_db)}
    if limits.warning_db is not None:
        seen["warning_level"] = judge(level, limits, p_limit, limits.warning_db)
    seen |= verdicts or {}
    known = {name: verdict for name, verdict in seen.items() if verdict is not None}
    if not known:
        return node, ()
    watches = dict(node.watches)
    for name, verdict in known.items():
        watches[name] = watch_on(watches.get(name, Watch()), verdict, limits, name in _AT_ONCE)
    standing = [SEVERITY[name] for name in SEVERITY if name in watches and watches[name].stands]
    wanted = max((severity for _, severity in standing), key=lambda severity: RANK[severity], default=None)
    conditions = "+".join(dict.fromkeys(condition for condition, _ in standing))
    ratio = level.total_to_noise_db if level.total_to_noise_db is not None else node.alarm.level_db
    alarm, changes = demand(node.alarm, wanted, time, run.alarms, run.id, conditions, ratio)
    return replace(node, alarm=alarm, watches=watches), changes


def watch_on(watch: Watch, verdict: Verdict, limits: Limits, at_once: bool = False) -> Watch:
    """K of N, the newest window among the K: else an old window could raise what the newest denies."""
    recent = (*watch.recent, verdict)[-limits.windows :]
    enough = at_once or recent.count(verdict) >= limits.exceeding
    if verdict is Verdict.BETWEEN or not enough:
        return Watch(recent, watch.stands)
    return Watch(recent, verdict is Verdict.EXCEEDS)
