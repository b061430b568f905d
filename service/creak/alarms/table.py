"""The life of an alarm as a table: facts, triggers, what follows, and the name that ISA-18.2 gives to it.

An alarm *is* its facts, which are orthogonal: shelving it does not make it less active. Its state is only a name,
derived by :func:`state`, under which operators know it. The first rule of :data:`RULES` whose trigger and facts
match says what follows; the diagram of the README is drawn from the same table.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from itertools import product

from creak.alarm_records import AlarmState


@dataclass(frozen=True)
class Facts:
    """What is true of an alarm.

    Parameters
    ----------
    active : bool
        The condition stands, its on-delay gone by.
    latched : bool
        Something that has gone, the alarm or its higher severity, is kept until it is acknowledged.
    acknowledged : bool
        An operator has seen it since it was last raised or became worse.
    shelved : bool
        An operator wants it out of sight for a time.
    suppressed : bool
        It has no meaning as the plant runs now.
    out_of_service : bool
        Taken out for maintenance.
    pending : bool
        The condition has come and its on-delay runs; nobody is told yet.
    """

    active: bool = False
    latched: bool = False
    acknowledged: bool = False
    shelved: bool = False
    suppressed: bool = False
    out_of_service: bool = False
    pending: bool = False


class Trigger(StrEnum):
    """What can happen to an alarm."""

    PEND = "pend"  # the condition has come, but its on-delay runs
    UNPEND = "unpend"  # it went before the delay was over
    RAISE = "raise"
    ESCALATE = "escalate"  # a higher severity stands than before
    RELAX = "relax"  # a lower one stands, but one stands
    CLEAR = "clear"
    REALARM = "realarm"  # acknowledged long ago, and it still stands
    EXPIRE = "expire"  # the time of a shelving is over
    ACKNOWLEDGE = "acknowledge"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    SUPPRESS = "suppress"
    UNSUPPRESS = "unsuppress"
    RETIRE = "retire"
    REINSTATE = "reinstate"
    RELEARN = "relearn"
    END = "end"  # whoever watched has gone, and nobody takes its place


@dataclass(frozen=True)
class Rule:
    """What follows from a trigger where certain facts hold.

    Parameters
    ----------
    trigger : Trigger
    when : mapping of str to bool
        Facts that must hold; those not named do not matter.
    then : mapping of str to bool
        Facts that hold afterwards; those not named stay.
    event : str
        Name of the change; empty for one that nobody is told of.
    refused : str
        Why an operator cannot have this; empty if it is allowed.
    """

    trigger: Trigger
    when: Mapping[str, bool] = field(default_factory=dict)
    then: Mapping[str, bool] = field(default_factory=dict)
    event: str = ""
    refused: str = ""

    def fits(self, facts: Facts) -> bool:
        """Tell whether the facts are those of the rule."""
        return all(getattr(facts, name) is value for name, value in self.when.items())


def _is(*names: str) -> dict[str, bool]:
    """Facts by name; one that begins with ``not_`` is false."""
    return {name.removeprefix("not_"): not name.startswith("not_") for name in names}


HIDING = ("shelved", "suppressed", "out_of_service")
"""Facts that keep an alarm out of sight."""

_IN_SIGHT = dict.fromkeys(HIDING, False)

RULES: tuple[Rule, ...] = (
    Rule(Trigger.PEND, _is("not_active"), _is("pending")),
    Rule(Trigger.PEND),
    Rule(Trigger.UNPEND, {}, _is("not_pending")),
    Rule(
        Trigger.RAISE,
        _is("not_active"),
        _is("active", "not_latched", "not_acknowledged", "not_pending"),
        "raised",
    ),
    Rule(Trigger.RAISE),
    Rule(Trigger.ESCALATE, _is("active"), _is("not_latched", "not_acknowledged"), "escalated"),
    Rule(Trigger.ESCALATE),
    Rule(Trigger.RELAX, _is("active", "acknowledged"), _is("not_latched"), "relaxed"),
    Rule(Trigger.RELAX, _is("active"), _is("latched"), "relaxed"),
    Rule(Trigger.RELAX),
    Rule(Trigger.CLEAR, _is("active", "acknowledged"), _is("not_active", "not_latched"), "cleared"),
    Rule(Trigger.CLEAR, _is("active"), _is("not_active", "latched"), "cleared"),
    Rule(Trigger.CLEAR),
    Rule(
        Trigger.REALARM,
        _is("active", "acknowledged") | _IN_SIGHT,
        _is("not_acknowledged"),
        "realarmed",
    ),
    Rule(Trigger.REALARM),
    Rule(Trigger.EXPIRE, _is("shelved"), _is("not_shelved"), "shelving_expired"),
    Rule(Trigger.EXPIRE),
    Rule(Trigger.ACKNOWLEDGE, _is("active", "acknowledged")),  # once more does no harm
    Rule(Trigger.ACKNOWLEDGE, _is("active"), _is("acknowledged", "not_latched"), "acknowledged"),
    Rule(Trigger.ACKNOWLEDGE, _is("latched"), _is("acknowledged", "not_latched"), "acknowledged"),
    Rule(Trigger.ACKNOWLEDGE, refused="the alarm has ended already"),
    Rule(Trigger.SHELVE, {}, _is("shelved"), "shelved"),  # again: with another end
    Rule(Trigger.UNSHELVE, _is("shelved"), _is("not_shelved"), "unshelved"),
    Rule(Trigger.UNSHELVE),
    Rule(Trigger.SUPPRESS, _is("not_suppressed"), _is("suppressed"), "suppressed"),
    Rule(Trigger.SUPPRESS),
    Rule(Trigger.UNSUPPRESS, _is("suppressed"), _is("not_suppressed"), "unsuppressed"),
    Rule(Trigger.UNSUPPRESS),
    Rule(Trigger.RETIRE, _is("not_out_of_service"), _is("out_of_service"), "retired"),
    Rule(Trigger.RETIRE),
    Rule(Trigger.REINSTATE, _is("out_of_service"), _is("not_out_of_service"), "reinstated"),
    Rule(Trigger.REINSTATE),
    Rule(Trigger.RELEARN, {}, {}, "relearning"),  # changes the baseline, and is told
    Rule(Trigger.END, _is("active", "acknowledged"), _IN_SIGHT | _is("not_active", "not_latched"), "ended"),
    Rule(Trigger.END, _is("active"), _IN_SIGHT | _is("not_active", "latched"), "ended"),
    *(Rule(Trigger.END, _is(name), _IN_SIGHT | _is("not_pending"), "ended") for name in HIDING),
    Rule(Trigger.END, {}, _is("not_pending")),
)
"""The transition table; a rule without facts to set changes none."""

STATES: tuple[tuple[Mapping[str, bool], AlarmState], ...] = (
    (_is("out_of_service"), AlarmState.OUT_OF_SERVICE),
    (_is("suppressed"), AlarmState.SUPPRESSED),
    (_is("shelved"), AlarmState.SHELVED),
    (_is("active", "acknowledged"), AlarmState.ACKNOWLEDGED),
    (_is("active"), AlarmState.UNACKNOWLEDGED),
    (_is("latched"), AlarmState.RETURNED_UNACKNOWLEDGED),
    ({}, AlarmState.NORMAL),
)
"""Facts and the name of the state; the first row that fits counts."""


def rule(facts: Facts, trigger: Trigger) -> Rule:
    """The rule that holds."""
    return next(rule for rule in RULES if rule.trigger is trigger and rule.fits(facts))


def follow(facts: Facts, trigger: Trigger) -> Facts:
    """The facts after a trigger."""
    return replace(facts, **rule(facts, trigger).then)


def state(facts: Facts) -> AlarmState:
    """The name that ISA-18.2 gives to the facts."""
    return next(name for when, name in STATES if all(getattr(facts, key) is value for key, value in when.items()))


def in_sight(facts: Facts) -> bool:
    """Tell whether nothing keeps an alarm from being shown."""
    return not any(getattr(facts, name) for name in HIDING)


def all_facts() -> Iterator[Facts]:
    """Every combination of facts, also those that no alarm comes to."""
    for values in product((False, True), repeat=len(fields(Facts))):
        yield Facts(*values)


def reachable() -> frozenset[Facts]:
    """The combinations that an alarm can come to."""
    found, edge = {Facts()}, [Facts()]
    while edge:
        facts = edge.pop()
        new = {follow(facts, trigger) for trigger in Trigger} - found
        found |= new
        edge += new
    return frozenset(found)


def diagram() -> str:
    """The table as a Mermaid state diagram of the named states.

    The three ways out of sight lead back to whatever the facts then say, so they are drawn once each.
    """
    ways_out = {AlarmState.SHELVED, AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE}
    arrows: dict[tuple[AlarmState, AlarmState], list[str]] = {}
    for facts in sorted(reachable(), key=repr):
        hidden = [name for name in HIDING if getattr(facts, name)]
        for trigger in Trigger:
            found = rule(facts, trigger)
            after = follow(facts, trigger)
            if not found.event or len(hidden) > 1:
                continue
            before, then = state(facts), state(after)
            if before in ways_out and then in ways_out and before is not then:
                continue  # one after the other; either alone is in the diagram
            if before is not then and found.event not in arrows.setdefault((before, then), []):
                arrows[before, then].append(found.event)
    order = list(AlarmState)
    lines = ["stateDiagram-v2", "    [*] --> normal"]
    for before, then in sorted(arrows, key=lambda pair: (order.index(pair[0]), order.index(pair[1]))):
        lines.append(f"    {before} --> {then}: {', '.join(arrows[before, then])}")
    return "\n".join(lines)
