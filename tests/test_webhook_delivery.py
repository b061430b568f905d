"""Messages arrive: signed, at least once, tried again, and part of the change that they tell of."""

import contextlib
import time
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from standardwebhooks import Webhook, WebhookVerificationError

from creak.records import AlarmState
from creak.sinks import outbox, queries, receivers
from creak.sinks.alarm_rows import put_alarm
from creak.webhooks import trouble
from creak.webhooks.delivery import DeliveryRules
from creak.webhooks.schedule import SECOND
from creak.webhooks.signature import new_secret, sign
from processes import wait_for
from receiver import receiving
from store_records import make_alarm, opened
from webhook_desk import FAST, RUN, add, all_receivers, changes, delivering, log, statuses


@pytest.fixture
def sink(store):
    return opened(store, RUN)


@given(st.text(max_size=200), st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1))
def test_reference_library_verifies_what_we_sign_with_either_secret(text, identifier):
    """Kills a signature over other bytes, a wrong separator, and a rotation that locks receivers out."""
    old, new = new_secret(), new_secret()
    body = text.encode()
    headers = sign(identifier, int(time.time()), body, [new, old])
    assert headers["webhook-signature"].count("v1,") == 2
    for secret in (old, new):
        Webhook(secret).verify(body, headers, json_parse=False)
    with pytest.raises(WebhookVerificationError):
        Webhook(new_secret()).verify(body, headers, json_parse=False)
    with pytest.raises(WebhookVerificationError):
        Webhook(new).verify(body + b" ", headers, json_parse=False)


def test_a_change_arrives_signed_and_as_the_contract_has_it(store, sink):
    with receiving() as server, delivering(store):
        receiver = add(store, server.url, events=("alarm.raised",), rigs=("beam",))
        alarm = make_alarm(RUN)
        sink.take(alarm)
        unwanted = replace(alarm, event="cleared", state=AlarmState.RETURNED_UNACKNOWLEDGED, active=False)
        sink.take(unwanted)
        (got,) = server.wait(1)
        assert Webhook(receiver.secret).verify(got.body, got.headers) == got.json
        assert list(got.json) == ["type", "timestamp", "data"]
        assert (got.json["type"], got.json["timestamp"]) == ("alarm.raised", "2026-05-01T08:00:00.000000Z")
        with store.read() as connection:
            shown = queries.alarm(connection, alarm.id)["changes"][0]
        assert got.json["data"] == shown
        assert got.headers["content-type"] == "application/json"
        assert got.headers["host"] == server.url.split("/")[2]
        wait_for(lambda: statuses(store) == ["delivered"])
        assert len(server.received) == 1
        (entry,) = log(store, receiver)
        assert (entry["status_code"], entry["outcome"], entry["message"]) == (204, "delivered", got.id)


def test_cloudevents_structured(store, sink):
    with receiving() as server, delivering(store):
        receiver = add(store, server.url, form="cloudevents")
        sink.take(make_alarm(RUN))
        (got,) = server.wait(1)
        Webhook(receiver.secret).verify(got.body, got.headers)
    assert got.headers["content-type"] == "application/cloudevents+json"
    event = got.json
    assert (event["specversion"], event["id"], event["type"]) == ("1.0", got.id, "alarm.raised")
    assert (event["source"], event["subject"]) == ("/creak/rigs/beam", make_alarm(RUN).id)
    assert (event["data"]["node"], event["time"]) == ("3", "2026-05-01T08:00:00.000000Z")


def test_secret_that_was_rotated_signs_until_its_time(store, sink):
    with receiving() as server:
        receiver = add(store, server.url)
        fresh, now = new_secret(), time.time_ns()
        with store.write() as connection:
            receivers.update(
                connection, receiver.id, secret=fresh, old_secret=receiver.secret,
                old_secret_until_at=now + 3600 * SECOND,
            )  # fmt: skip
        with delivering(store):
            sink.take(make_alarm(RUN))
            (got,) = server.wait(1)
        Webhook(receiver.secret).verify(got.body, got.headers)
        Webhook(fresh).verify(got.body, got.headers)
        with store.read() as connection:
            turned = receivers.get(connection, receiver.id)
        assert turned.secrets(now + 3601 * SECOND) == (fresh,)


def test_a_change_that_is_rolled_back_sends_nothing(store):
    """Kills a message about something that never was, and a change without its message."""
    with receiving() as server, delivering(store):
        add(store, server.url)
        with contextlib.suppress(RuntimeError), store.write() as connection:
            put_alarm(connection, RUN.id, make_alarm(RUN))
            raise RuntimeError
        with store.write() as connection:
            put_alarm(connection, RUN.id, make_alarm(RUN, number=1))
        (got,) = server.wait(1)
        assert got.json["data"]["id"] == make_alarm(RUN, number=1).id
    assert len(server.received) == 1


def test_a_run_that_is_told_again_sends_nothing_twice(store, sink):
    with receiving() as server, delivering(store):
        add(store, server.url)
        for change in changes(0):
            sink.take(change)
        server.wait(4)
        again = opened(store, RUN)
        for change in changes(0):
            again.take(change)
        again.take(make_alarm(RUN, number=9))
        server.wait(5)
    assert len({got.id for got in server.received}) == len(server.received) == 5


def test_failures_are_tried_again_with_the_same_id_and_body_and_a_new_timestamp(store, sink):
    with receiving(500, ("stall", {"seconds": 1}), 302, 404) as server, delivering(store):
        receiver = add(store, server.url)
        sink.take(make_alarm(RUN))
        got = server.wait(5)
        wait_for(lambda: statuses(store) == ["delivered"])
        assert len({(item.id, item.body) for item in got}) == 1
        for item in got:
            Webhook(receiver.secret).verify(item.body, item.headers)
        entries = log(store, receiver)
    assert [entry["outcome"] for entry in entries] == ["retried"] * 4 + ["delivered"]
    assert [entry["status_code"] for entry in entries] == [500, None, 302, 404, 204]
    assert entries[1]["error"] == "no answer within 0.5 s"
    assert [entry["attempt"] for entry in entries] == [1, 2, 3, 4, 5]


def test_a_message_is_given_up_in_the_end_and_can_be_sent_again_by_hand(store, sink):
    with receiving(*[500] * 5) as server, delivering(store):
        receiver = add(store, server.url)
        sink.take(make_alarm(RUN))
        wait_for(lambda: statuses(store) == ["failed"])
        with store.write() as connection:
            assert outbox.redeliver(connection, receiver.id, server.received[0].id, time.time_ns())
            assert not outbox.redeliver(connection, receiver.id, "msg_nosuch", time.time_ns())
        wait_for(lambda: statuses(store) == ["delivered"])
        assert len({got.id for got in server.received}) == 1


def test_retry_after_pauses_the_receiver(store, sink):
    with receiving((429, {"Retry-After": "1"})) as server, delivering(store):
        add(store, server.url)
        for number in range(3):
            sink.take(make_alarm(RUN, number=number))
        first, second = server.wait(2)
        assert 0.9 < second.at - first.at < 3
        server.wait(4)


def test_gone_disables_at_once_with_an_alarm_that_enabling_clears(store, sink):
    with receiving(410) as server, receiving() as witness, delivering(store):
        receiver, _ = add(store, server.url), add(store, witness.url)
        sink.take(make_alarm(RUN))
        about = [got.json for got in witness.wait(2)]
        alarm = next(item["data"] for item in about if item["data"]["rig"] == "creak")
        assert (alarm["class"], alarm["node"], alarm["state"]) == ("quality", receiver.id, "unacknowledged")
        assert "410" in alarm["comment"]
        sink.take(make_alarm(RUN, number=1))
        witness.wait(3)
        assert len(server.received) == 1
        with store.write() as connection:
            disabled = receivers.get(connection, receiver.id)
            assert not disabled.enabled
            trouble.enable(connection, disabled, time.time_ns())
        sink.take(make_alarm(RUN, number=2))
        server.wait(2)
        with store.read() as connection:
            shown = queries.alarm(connection, alarm["id"])
        assert (shown["state"], shown["active"]) == ("returned_unacknowledged", False)


def test_long_failure_disables(store, sink):
    with receiving(*[500] * 9) as server:
        rules = DeliveryRules(schedule=replace(FAST, disable_after=0.03))
        with delivering(store, rules=rules):
            receiver = add(store, server.url)
            sink.take(make_alarm(RUN))
            wait_for(lambda: any(not item.enabled for item in all_receivers(store)))
    (found,) = all_receivers(store)
    assert found.reason.startswith("it has failed for 0 h; the last time: the receiver answered 500")
    assert found.id == receiver.id
