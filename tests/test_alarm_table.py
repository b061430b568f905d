"""The life of an alarm: a total table, derived names, operators who get what they ask for or are told why not."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from creak import alarms
from creak.alarm_records import Action, ActionKind, AlarmRules, AlarmState, Conflict
from creak.alarms.guidance import GUIDANCE, guidance
from creak.alarms.life import RANK
from creak.alarms.table import RULES, Facts, Trigger, all_facts, diagram, follow, reachable, rule, state

S = 1_000_000_000
PLAIN = AlarmRules()


@pytest.mark.parametrize("trigger", Trigger)
def test_every_trigger_has_an_answer_to_every_combination_of_facts(trigger):
    """Totality: kills a gap in the table, which would be an exception at three in the morning."""
    for facts in all_facts():
        assert rule(facts, trigger).trigger is trigger
        assert isinstance(state(follow(facts, trigger)), AlarmState)


def test_every_rule_is_the_one_that_holds_somewhere():
    """Kills a dead row: one that an earlier row hides, or that no alarm comes to."""
    used = {id(rule(facts, trigger)) for facts in reachable() for trigger in Trigger}
    assert [row for row in RULES if id(row) not in used] == []


def test_what_facts_an_alarm_can_come_to():
    """Kills an acknowledgement that leaves something waiting for it, and a raised alarm that is still pending."""
    for facts in reachable():
        assert not (facts.latched and facts.acknowledged)
        assert not (facts.active and facts.pending)
    assert {state(facts) for facts in reachable()} == set(AlarmState)


def test_shelving_suppressing_and_service_touch_nothing_else():
    """Orthogonality: kills a shelving that acknowledges or clears."""
    own = {
        Trigger.SHELVE: "shelved",
        Trigger.UNSHELVE: "shelved",
        Trigger.EXPIRE: "shelved",
        Trigger.SUPPRESS: "suppressed",
        Trigger.UNSUPPRESS: "suppressed",
        Trigger.RETIRE: "out_of_service",
        Trigger.REINSTATE: "out_of_service",
    }
    for facts in all_facts():
        for trigger, name in own.items():
            after = follow(facts, trigger)
            assert replace(after, **{name: getattr(facts, name)}) == facts


def test_no_rig_acknowledges():
    """Kills a table in which the condition's coming and going acknowledges."""
    for facts in all_facts():
        for trigger in set(Trigger) - {Trigger.ACKNOWLEDGE}:
            assert not follow(facts, trigger).acknowledged or facts.acknowledged


def test_the_names_are_those_of_the_standard():
    names = {
        Facts(): "normal",
        Facts(pending=True): "normal",
        Facts(active=True): "unacknowledged",
        Facts(active=True, acknowledged=True): "acknowledged",
        Facts(latched=True): "returned_unacknowledged",
        Facts(acknowledged=True): "normal",
        Facts(active=True, shelved=True): "shelved",
        Facts(active=True, shelved=True, suppressed=True): "suppressed",
        Facts(active=True, shelved=True, suppressed=True, out_of_service=True): "out_of_service",
    }
    assert {facts: state(facts).value for facts in names} == names


def test_the_diagram_has_every_state_and_every_event():
    text = diagram()
    for name in [*AlarmState, *(row.event for row in RULES if row.event not in {"", "relaxed", "relearning"})]:
        assert name in text


def test_the_readme_has_the_diagram_of_this_table():
    """Kills a picture that was true once: paste what `diagram()` gives."""
    readme = (Path(__file__).parents[1] / "README.md").read_text()
    assert f"```mermaid\n{diagram()}\n```" in readme


# -- one alarm through its life


def alarm(node="1"):
    return alarms.Alarm("law", node)


def tell(a, *demands, rules=PLAIN):
    """Tell an alarm what stands at times in seconds; the changes as (second, event, state, severity)."""
    log = []
    for at, wanted in demands:
        a, changes = alarms.demand(a, wanted, at * S, rules, "run", "level", 6.0)
        log += [(c.time / S, c.event, c.state.value, c.severity) for c in changes]
    return a, log


def do(a, kind, at, rules=PLAIN, **more):
    action = Action(more.pop("alarm", a.id), kind, more.pop("by", "ada"), **more)
    return alarms.act(a, action, at * S, rules, "run")


def test_on_and_off_delay_run_in_recorded_time_and_an_interruption_begins_anew():
    rules = AlarmRules(on_delay_s=10, off_delay_s=20)
    a, log = tell(
        alarm(), (0, "alarm"), (5, None), (6, "alarm"), (15, "alarm"), (40, None), (50, "alarm"), rules=rules
    )
    assert log == [(16, "raised", "unacknowledged", "alarm")]  # not at 10, not at 40
    _, log = tell(a, (60, None), (100, None), rules=rules)
    assert log == [(80, "cleared", "returned_unacknowledged", "alarm")]


def test_a_pending_alarm_is_no_alarm_yet():
    a, log = tell(alarm(), (0, "alarm"), rules=AlarmRules(on_delay_s=10))
    assert (a.facts.pending, a.state, log) == (True, AlarmState.NORMAL, [])


def test_the_highest_severity_is_kept_until_it_is_acknowledged():
    a, log = tell(alarm(), (0, "warning"), (1, "alarm"), (2, "warning"), (3, None))
    assert log == [
        (0, "raised", "unacknowledged", "warning"),
        (1, "escalated", "unacknowledged", "alarm"),
        (2, "relaxed", "unacknowledged", "alarm"),
        (3, "cleared", "returned_unacknowledged", "alarm"),
    ]
    again, log = tell(a, (4, "warning"))
    assert log == [(4, "raised", "unacknowledged", "alarm")]
    assert again.id == a.id
    known, changes = do(again, ActionKind.ACKNOWLEDGE, 5)
    assert (known.severity, changes[0].state) == ("warning", AlarmState.ACKNOWLEDGED)


def test_an_acknowledged_alarm_that_becomes_worse_has_to_be_seen_again():
    a, _ = tell(alarm(), (0, "warning"))
    a, _ = do(a, ActionKind.ACKNOWLEDGE, 1)
    a, log = tell(a, (2, "warning"), (3, "alarm"))
    assert log == [(3, "escalated", "unacknowledged", "alarm")]


def test_an_acknowledged_alarm_ends_when_it_clears_and_the_next_one_is_another():
    a, _ = tell(alarm(), (0, "alarm"))
    first = a.id
    a, _ = do(a, ActionKind.ACKNOWLEDGE, 1)
    a, log = tell(a, (2, None), (3, "alarm"))
    assert [entry[2] for entry in log] == ["normal", "unacknowledged"]
    assert a.id != first
    stale = do(a, ActionKind.ACKNOWLEDGE, 4, alarm=first)
    assert isinstance(stale, Conflict)
    assert stale.kind == "stale"


def test_acknowledging_twice_does_no_harm_and_names_the_first():
    a, _ = tell(alarm(), (0, "alarm"))
    a, changes = do(a, ActionKind.ACKNOWLEDGE, 1, comment="on my way", version=1)
    assert [(c.by, c.comment, c.version, c.time) for c in changes] == [("ada", "on my way", 2, S)]
    assert do(a, ActionKind.ACKNOWLEDGE, 2, by="bob", version=1) == (a, ())


def test_an_acknowledgement_of_what_is_gone_or_has_changed_since_is_stale():
    a, _ = tell(alarm(), (0, "warning"), (1, "alarm"))
    old = do(a, ActionKind.ACKNOWLEDGE, 2, version=1)
    assert isinstance(old, Conflict)
    assert (old.kind, "version 2" in old.reason) == ("stale", True)
    a, _ = do(a, ActionKind.ACKNOWLEDGE, 2, version=2)
    a, _ = tell(a, (3, None))
    ended = do(a, ActionKind.ACKNOWLEDGE, 4)
    assert isinstance(ended, Conflict)
    assert ended.kind == "stale"


HIDE = [
    (ActionKind.SHELVE, ActionKind.UNSHELVE),
    (ActionKind.SUPPRESS, ActionKind.UNSUPPRESS),
    (ActionKind.RETIRE, ActionKind.REINSTATE),
]


@pytest.mark.parametrize(("hide", "show"), HIDE)
def test_realarm_comes_once_after_its_rest_or_when_the_alarm_is_in_sight_again(hide, show):
    """Kills one that is dropped because it fell due out of sight: what stands is to be announced again."""
    rules = AlarmRules(realarm_s=60)
    a, _ = tell(alarm(), (0, "alarm"), rules=rules)
    a, _ = do(a, ActionKind.ACKNOWLEDGE, 10, rules)
    hidden, _ = do(a, hide, 20, rules, until=3600 * S)
    hidden, changes = alarms.advance(hidden, 200 * S, rules, "run")
    assert changes == ()
    shown, _ = do(hidden, show, 300, rules)
    _, changes = alarms.advance(shown, 301 * S, rules, "run")
    assert [(c.event, c.time, c.state.value) for c in changes] == [("realarmed", 300 * S, "unacknowledged")]
    early, _ = do(hidden, show, 30, rules)
    _, changes = alarms.advance(early, 301 * S, rules, "run")
    assert [(c.event, c.time) for c in changes] == [("realarmed", 70 * S)]
    a, changes = alarms.advance(a, 200 * S, rules, "run")
    assert [(c.event, c.time) for c in changes] == [("realarmed", 70 * S)]
    assert a.state is AlarmState.UNACKNOWLEDGED


def test_shelving_ends_at_its_time_and_the_alarm_behind_it_is_as_it_was():
    a, _ = tell(alarm(), (0, "alarm"))
    a, changes = do(a, ActionKind.SHELVE, 1, until=100 * S, comment="known")
    assert (changes[0].state, changes[0].active, changes[0].shelved_until) == ("shelved", True, 100 * S)
    a, log = tell(a, (150, "alarm"))
    assert log == [(100, "shelving_expired", "unacknowledged", "alarm")]
    assert a.shelved_until is None


@pytest.mark.parametrize(("until", "why"), [(None, "end"), (1, "ahead"), (5000, "at most")])
def test_shelving_without_end_or_beyond_the_maximum_is_not_allowed(until, why):
    a, _ = tell(alarm(), (0, "alarm"))
    rules = AlarmRules(shelving_max_s=3600)
    refused = do(a, ActionKind.SHELVE, 2, rules, until=None if until is None else until * S)
    assert isinstance(refused, Conflict)
    assert (refused.kind, why in refused.reason) == ("not_allowed", True)


def test_realarm_and_the_end_of_a_shelving_come_in_their_order():
    rules = AlarmRules(realarm_s=60)
    a, _ = tell(alarm(), (0, "alarm"), rules=rules)
    a, _ = do(a, ActionKind.ACKNOWLEDGE, 10, rules)
    a, _ = do(a, ActionKind.SHELVE, 20, rules, until=100 * S)
    _, changes = alarms.advance(a, 200 * S, rules, "run")
    assert [(c.event, c.time) for c in changes] == [("shelving_expired", 100 * S), ("realarmed", 100 * S)]


def test_the_end_of_whoever_watched_leaves_nothing_active_hidden_or_unseen():
    """Whatever the facts: kills an alarm that stands for ever, and one that was never seen and disappears."""
    for facts in reachable():
        a = replace(alarm(), facts=facts, id="x", version=3)
        after, changes = alarms.end(a, 9 * S, "its run has ended")
        assert after.state.value == ("returned_unacknowledged" if after.facts.latched else "normal")
        assert after.facts.latched == ((facts.latched or facts.active) and not facts.acknowledged)
        assert bool(changes) == (facts.active or state(facts).value in {"shelved", "suppressed", "out_of_service"})
        for change in changes:
            assert (change.event, change.version, change.comment) == ("ended", 4, "its run has ended")
            assert not any((change.active, change.shelved, change.suppressed, change.out_of_service))
        assert alarms.end(after, 10 * S, "")[1] == ()


steps = st.lists(
    st.tuples(
        st.integers(0, 30),
        st.sampled_from([None, "warning", "alarm", *ActionKind]),
    ),
    max_size=25,
)
rulebooks = st.builds(
    AlarmRules,
    on_delay_s=st.sampled_from([0, 5]),
    off_delay_s=st.sampled_from([0, 7]),
    realarm_s=st.sampled_from([None, 11]),
)


def live(story, rules, grain=None):
    """Tell a story; time goes by in one step between its entries, or in grains of a second."""
    a, log, now = alarm(), [], 0
    for wait, what in story:
        for second in range(now + 1, now + wait + 1) if grain else ():
            a, changes = alarms.advance(a, second * S, rules, "run")
            log += changes
        now += wait
        if isinstance(what, ActionKind):
            a, changes = alarms.advance(a, now * S, rules, "run")
            log += changes
            until = (now + 13) * S if what is ActionKind.SHELVE else None
            done = do(a, what, now, rules, until=until)
            if isinstance(done, Conflict):
                continue
            a, changes = done
        else:
            a, changes = alarms.demand(a, what, now * S, rules, "run", "level", 6.0)
        log += changes
    return a, log


@given(steps, rulebooks)
def test_how_often_the_clock_is_read_makes_no_difference(story, rules):
    """Kills a timer that fires when it is noticed instead of when it is due: a replay would differ."""
    assert live(story, rules) == live(story, rules, grain=1)


@given(steps, rulebooks)
def test_what_every_story_obeys(story, rules):
    """Kills a change without a version, an id that changes within an occurrence, a severity below what stands."""
    _, log = live(story, rules)
    versions = {}
    for change in log:
        assert change.version == versions.get(change.id, 0) + 1
        versions[change.id] = change.version
        assert change.time >= change.since
        if change.version == 1:
            assert change.event == "raised"
        if change.event == "acknowledged":
            assert change.acknowledged
            assert not change.latched
    assert [c.time for c in log] == sorted(c.time for c in log)


@given(steps, rulebooks)
def test_operators_can_be_replayed_from_what_was_recorded(story, rules):
    """Each action is found again in the change that it led to: kills a recording that forgets who did what."""
    a, log = live(story, rules)
    for change in log:
        action = alarms.action_of(change)
        assert (action is not None) == (change.by != "")
        if action is not None:
            assert action.alarm == change.id
    if log:
        known = alarms.of_change(log[-1])
        if known.id == a.id:
            assert known.facts == replace(a.facts, pending=False)
            assert (known.severity, known.version) == (a.severity, a.version)


def test_severities_rank_and_guidance_names_every_condition():
    assert RANK[None] < RANK["warning"] < RANK["alarm"]
    assert guidance("level+trend") == f"{GUIDANCE['level']} {GUIDANCE['trend']}"
    assert guidance("") == ""
