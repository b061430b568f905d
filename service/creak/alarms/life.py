"""One alarm through its life: state in, state out, and what changed; delays and shelving in recorded time.

What falls due between two calls (a delay that is over, a shelving that ends) happens at its own time, whenever it
is noticed: :func:`advance` gives the same changes for one long step as for many short ones.
"""

import math
import uuid
from dataclasses import dataclass, field, replace

from creak.alarm_records import (
    Action,
    ActionKind,
    AlarmChange,
    AlarmClass,
    AlarmRules,
    AlarmState,
    Conflict,
    Severity,
)
from creak.alarms.guidance import guidance
from creak.alarms.table import Facts, Trigger, follow, in_sight, rule, state

_NAMESPACE = uuid.UUID("6f1d2c0e-8f0b-5a3e-9a57-6372656b0001")

RANK: dict[Severity | None, int] = {None: 0, "warning": 1, "alarm": 2}
"""Severities in rising order; None where no condition stands."""


@dataclass(frozen=True)
class Alarm:
    """An alarm as it stands; the whole of it, so that it can be kept over a restart.

    Parameters
    ----------
    rig, node : str
        An empty node stands for the whole rig.
    class_ : str
    facts : Facts
    id : str
        Of the newest occurrence; empty if there was none.
    since : int
        Recorded time at which that was raised, or else began, ns since the Unix epoch.
    version : int
        Counts its changes.
    severity : str
        What is shown: the highest since it was last acknowledged.
    standing : str or None
        What the condition demands at this moment, delays aside; None if there is none.
    condition : str
        Names of what stands.
    level_db : float
        Of the newest window that was judged, dB; NaN for what has no level.
    raise_at, clear_at, realarm_at, shelved_until : int or None
        Recorded times at which on-delay, off-delay, rest after an acknowledgement and shelving end.
    by, comment : str
        Who shelved, suppressed or retired it, and why.
    never_raised : bool
        The newest occurrence is none yet, only what an operator did.
    """

    rig: str
    node: str
    class_: AlarmClass = "process"
    facts: Facts = field(default_factory=Facts)
    id: str = ""
    since: int = 0
    version: int = 0
    severity: Severity = "warning"
    standing: Severity | None = None
    condition: str = ""
    level_db: float = math.nan
    raise_at: int | None = None
    clear_at: int | None = None
    realarm_at: int | None = None
    shelved_until: int | None = None
    by: str = ""
    comment: str = ""
    never_raised: bool = False

    @property
    def state(self) -> AlarmState:
        """Its name in ISA-18.2."""
        return state(self.facts)


Stepped = tuple[Alarm, tuple[AlarmChange, ...]]


def demand(
    alarm: Alarm,
    wanted: Severity | None,
    time: int,
    rules: AlarmRules,
    run: str,
    condition: str = "",
    level_db: float = math.nan,
) -> Stepped:
    """Tell an alarm what its condition demands now.

    Parameters
    ----------
    alarm : Alarm
    wanted : str or None
        Severity that stands; None if nothing does.
    time : int
        Recorded time, ns since the Unix epoch; not before that of an earlier call.
    rules : AlarmRules
    run : str
        Id of the run; goes into the id of a new occurrence.
    condition : str
        What stands.
    level_db : float
        dB.

    Returns
    -------
    Alarm
        As it stands now.
    tuple of AlarmChange
        What changed, if anything.
    """
    alarm, due = advance(alarm, time, rules, run)
    before = alarm.standing
    alarm = replace(alarm, standing=wanted, level_db=level_db, condition=condition if wanted else alarm.condition)
    changes: tuple[AlarmChange, ...] = ()
    if wanted is None:
        if alarm.facts.pending:
            alarm = replace(alarm, facts=follow(alarm.facts, Trigger.UNPEND), raise_at=None)
        elif alarm.facts.active and alarm.clear_at is None:
            alarm, changes = _later(alarm, Trigger.CLEAR, rules.off_delay_s, time, rules, run)
    else:
        alarm = replace(alarm, clear_at=None)
        if not alarm.facts.active:
            if not alarm.facts.pending:
                alarm, changes = _later(alarm, Trigger.RAISE, rules.on_delay_s, time, rules, run)
        elif RANK[wanted] > (RANK[before] if alarm.facts.latched else RANK[alarm.severity]):
            alarm, changes = _fire(alarm, Trigger.ESCALATE, time, rules, run)
        elif RANK[wanted] < RANK[alarm.severity] and not alarm.facts.latched:
            alarm, changes = _fire(alarm, Trigger.RELAX, time, rules, run)
    return alarm, (*due, *changes)


def advance(alarm: Alarm, time: int, rules: AlarmRules, run: str) -> Stepped:
    """Let happen what falls due until a recorded time, in its order and at its own time."""
    changes: list[AlarmChange] = []
    while True:
        due = [
            (at, order, trigger)
            for order, (trigger, at) in enumerate(
                (
                    (Trigger.EXPIRE, alarm.shelved_until),
                    (Trigger.RAISE, alarm.raise_at),
                    (Trigger.CLEAR, alarm.clear_at),
                    (Trigger.REALARM, alarm.realarm_at if in_sight(alarm.facts) else None),
                )
            )
            if at is not None and at <= time
        ]
        if not due:
            return alarm, tuple(changes)
        at, _, trigger = min(due)
        alarm, more = _fire(alarm, trigger, at, rules, run)
        changes += more


def act(alarm: Alarm, action: Action, time: int, rules: AlarmRules, run: str) -> Stepped | Conflict:
    """Do what an operator asks for.

    Parameters
    ----------
    alarm : Alarm
    action : Action
    time : int
        Recorded time, ns since the Unix epoch.
    rules : AlarmRules
    run : str
        Id of the run.

    Returns
    -------
    Alarm and tuple of AlarmChange, or Conflict
        No change if it is so already: asking twice does no harm.
    """
    if not action.node and (action.alarm != alarm.id or not alarm.id):
        return Conflict("stale", "the occurrence has ended and a newer one has taken its place")
    alarm, due = advance(alarm, time, rules, run)
    trigger = Trigger(action.kind.value)
    found = rule(alarm.facts, trigger)
    if found.refused:
        return Conflict("stale", found.refused)
    if not found.event:
        return alarm, due
    if action.version is not None and action.version != alarm.version:
        return Conflict("stale", f"the alarm has changed: it is at version {alarm.version}, not {action.version}")
    if not action.by:
        return Conflict("not_allowed", "an action needs the name of whoever takes it")
    if trigger is Trigger.SHELVE:
        if action.until is None or action.until <= time:
            return Conflict("not_allowed", "a shelving needs an end that lies ahead of the rig's recorded time")
        if action.until - time > round(rules.shelving_max_s * 1e9):
            return Conflict("not_allowed", f"an alarm can be shelved for at most {rules.shelving_max_s:g} s")
        alarm = replace(alarm, shelved_until=action.until)
    if action.node and (not alarm.id or (alarm.state is AlarmState.NORMAL and not alarm.never_raised)):
        identifier = action.alarm or _identity(alarm, run, time, "action/")
        alarm = replace(alarm, id=identifier, since=time, version=0, severity="warning", never_raised=True)
    alarm, changes = _fire(alarm, trigger, time, rules, run, action.by, action.comment)
    return alarm, (*due, *changes)


def end(alarm: Alarm, time: int, why: str) -> Stepped:
    """End what stands and what hides an alarm whose monitor has gone; one that nobody has seen stays latched."""
    return _fire(alarm, Trigger.END, time, AlarmRules(), "", comment=why)


_OPERATORS = {
    "acknowledged": ActionKind.ACKNOWLEDGE,
    "shelved": ActionKind.SHELVE,
    "unshelved": ActionKind.UNSHELVE,
    "suppressed": ActionKind.SUPPRESS,
    "unsuppressed": ActionKind.UNSUPPRESS,
    "retired": ActionKind.RETIRE,
    "reinstated": ActionKind.REINSTATE,
    "relearning": ActionKind.RELEARN,
}


def action_of(change: AlarmChange) -> Action | None:
    """The operator's action that led to a change, so that a recording can be replayed; None if there was none."""
    kind = _OPERATORS.get(change.event)
    if kind is None:
        return None
    until = change.shelved_until if kind is ActionKind.SHELVE else None
    begun = change.node if change.never_raised and change.version == 1 else ""
    return Action(change.id, kind, change.by, change.comment, until, node=begun)


def of_change(change: AlarmChange) -> Alarm:
    """The alarm as its newest change leaves it, without the timers that only its monitor knows."""
    return Alarm(
        rig=change.rig,
        node=change.node,
        class_=change.class_,
        facts=Facts(
            active=change.active,
            latched=change.latched or not (change.active or change.acknowledged or change.never_raised),
            acknowledged=change.acknowledged,
            shelved=change.shelved,
            suppressed=change.suppressed,
            out_of_service=change.out_of_service,
        ),
        id=change.id,
        since=change.since,
        version=change.version,
        severity=change.severity,
        standing=change.severity if change.active else None,
        condition=change.condition,
        level_db=change.level_db,
        shelved_until=change.shelved_until,
        never_raised=change.never_raised,
    )


def _later(alarm: Alarm, trigger: Trigger, seconds: float, time: int, rules: AlarmRules, run: str) -> Stepped:
    """Raise or clear now, or note when the delay will be over."""
    delay = round(seconds * 1e9)
    if delay <= 0:
        return _fire(alarm, trigger, time, rules, run)
    if trigger is Trigger.RAISE:
        return replace(alarm, facts=follow(alarm.facts, Trigger.PEND), raise_at=time + delay), ()
    return replace(alarm, clear_at=time + delay), ()


def _fire(
    alarm: Alarm, trigger: Trigger, time: int, rules: AlarmRules, run: str, by: str = "", comment: str = ""
) -> Stepped:
    """Go where the table says, with all that belongs to it beyond the facts."""
    found = rule(alarm.facts, trigger)
    before, facts = alarm.facts, follow(alarm.facts, trigger)
    kept: Severity | None = None if alarm.facts.acknowledged else alarm.severity
    severity = alarm.severity
    if trigger is Trigger.RAISE:
        if alarm.state is AlarmState.NORMAL or not alarm.id:
            alarm = replace(alarm, id=_identity(alarm, run, time), since=time, version=0)
        elif alarm.never_raised:
            alarm = replace(alarm, since=time)
        alarm = replace(alarm, never_raised=False)
        if not alarm.facts.latched:
            kept = None
        severity = _higher(kept, alarm.standing)
        facts = replace(facts, latched=RANK[severity] > RANK[alarm.standing])
    elif trigger is Trigger.ESCALATE:
        severity = _higher(kept, alarm.standing)
        facts = replace(facts, latched=RANK[severity] > RANK[alarm.standing])
    elif facts.active and facts.acknowledged and alarm.standing is not None:
        severity = alarm.standing
    alarm = replace(
        alarm,
        facts=facts,
        severity=severity,
        raise_at=None if trigger is Trigger.RAISE else alarm.raise_at,
        clear_at=None if trigger is Trigger.CLEAR else alarm.clear_at,
        realarm_at=alarm.realarm_at if facts.active and facts.acknowledged else None,
        shelved_until=alarm.shelved_until if facts.shelved else None,
    )
    if in_sight(facts) and not in_sight(before) and alarm.realarm_at is not None:
        alarm = replace(alarm, realarm_at=max(alarm.realarm_at, time))  # one that fell due meanwhile comes now
    if trigger is Trigger.REALARM:
        alarm = replace(alarm, realarm_at=None)
    elif trigger is Trigger.ACKNOWLEDGE and facts.active and rules.realarm_s is not None:
        alarm = replace(alarm, realarm_at=time + round(rules.realarm_s * 1e9))
    if not found.event:
        return alarm, ()
    alarm = replace(alarm, version=alarm.version + 1, by=by or alarm.by, comment=comment if by else alarm.comment)
    return alarm, (_change(alarm, found.event, time, by, comment),)


def _change(alarm: Alarm, event: str, time: int, by: str, comment: str) -> AlarmChange:
    facts = alarm.facts
    return AlarmChange(
        id=alarm.id,
        rig=alarm.rig,
        node=alarm.node,
        class_=alarm.class_,
        severity=alarm.severity,
        event=event,
        state=alarm.state,
        active=facts.active,
        acknowledged=facts.acknowledged,
        shelved=facts.shelved,
        since=alarm.since,
        time=time,
        level_db=alarm.level_db,
        version=alarm.version,
        condition=alarm.condition,
        by=by,
        comment=comment,
        shelved_until=alarm.shelved_until,
        suppressed=facts.suppressed,
        out_of_service=facts.out_of_service,
        latched=facts.latched,
        guidance=guidance(alarm.condition),
        never_raised=alarm.never_raised,
    )


def _identity(alarm: Alarm, run: str, time: int, what: str = "") -> str:
    """Id of an occurrence: the same in every replay, and that of no other."""
    of = alarm.node if alarm.class_ == "process" else f"quality/{alarm.condition}/{alarm.node}"
    return str(uuid.uuid5(_NAMESPACE, f"{run}/{what}{of}/{time}"))


def _higher(one: Severity | None, other: Severity | None) -> Severity:
    return "alarm" if "alarm" in {one, other} else "warning"
