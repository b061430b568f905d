"""Messages arrive: signed, in order, at least once, and one receiver's trouble is its own."""

import contextlib
import itertools
import socket
import threading
import time
from dataclasses import replace

import pytest
import sqlalchemy as sa
from hypothesis import given
from hypothesis import strategies as st
from standardwebhooks import Webhook, WebhookVerificationError

from creak.records import AlarmState
from creak.sinks import outbox, queries, receivers
from creak.sinks.alarm_rows import put_alarm
from creak.sinks.database import open_store
from creak.sinks.operator_tables import deliveries
from creak.sinks.operator_tables import outbox as messages
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import Deliverer, DeliveryRules
from creak.webhooks.schedule import SECOND, Schedule
from creak.webhooks.signature import new_secret, sign
from receiver import receiving
from store_records import START, make_alarm, make_run, opened

RUN = make_run("beam-1")
FAST = Schedule(delays=(0.02, 0.04, 0.08, 0.16), disable_after=3600.0)
LOOPBACK = AddressPolicy(["127.0.0.0/8"])


@pytest.fixture
def store(tmp_path):
    made = open_store(f"sqlite:///{tmp_path}/creak.db")
    yield made
    made.close()


@pytest.fixture
def sink(store):
    return opened(store, RUN)


def add(store, url, *, events=(), rigs=(), form="standard"):
    with store.write() as connection:
        return receivers.add(connection, url, events, rigs, form, new_secret())


@contextlib.contextmanager
def delivering(store, *, policy=LOOPBACK, rules=None, **options):
    deliverer = Deliverer(store, policy, rules or DeliveryRules(schedule=FAST, timeout=0.5), **options)
    deliverer.start()
    try:
        yield deliverer
    finally:
        deliverer.stop()


def log(store, receiver):
    with store.read() as connection:
        return outbox.delivery_page(connection, receiver.id, None, 1000)[::-1]


def wait_for(until, seconds=10.0):
    end = time.monotonic() + seconds
    while not (found := until()):
        assert time.monotonic() < end, "timed out"
        time.sleep(0.01)
    return found


def statuses(store):
    with store.read() as connection:
        return list(connection.execute(sa.select(messages.c.status).order_by(messages.c.seq)).scalars())


def changes(number, count=4):
    """One alarm raised and cleared over and over."""
    return [
        make_alarm(RUN, number=number, event=event, time=START + i * SECOND, level_db=float(i))
        for i, event in zip(range(count), itertools.cycle(("raised", "cleared")), strict=False)
    ]


# --- what is sent ----------------------------------------------------------------------------------------------


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


# --- the outbox is part of the change ----------------------------------------------------------------------------


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


# --- failures ----------------------------------------------------------------------------------------------------


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


def test_redirect_is_not_followed(store, sink):
    """Kills the way around the address check."""
    with receiving() as inside, receiving(*[(307, {"Location": inside.url})] * 5) as server, delivering(store):
        add(store, server.url)
        sink.take(make_alarm(RUN))
        wait_for(lambda: statuses(store) == ["failed"])
        assert inside.received == []


def test_proxy_of_the_environment_is_not_asked(store, sink, monkeypatch):
    with receiving() as proxy, receiving() as server:
        for name in ("http_proxy", "HTTP_PROXY", "ALL_PROXY", "https_proxy"):
            monkeypatch.setenv(name, proxy.url)
        with delivering(store):
            add(store, server.url)
            sink.take(make_alarm(RUN))
            server.wait(1)
        assert proxy.received == []


def test_rebinding_name_gets_no_connection(store, sink):
    """A name that is public when it is checked and loopback when it is used; it is looked up once an attempt."""
    asked = []

    async def rebinding(host, port):
        asked.append(host)
        return ["93.184.215.14"] if len(asked) == 1 else ["127.0.0.1"]

    with receiving() as server:
        receiver = add(store, f"http://rebind.example:{server.server_port}/")
        with delivering(store, policy=AddressPolicy(), resolver=rebinding):
            sink.take(make_alarm(RUN))
            wait_for(lambda: statuses(store) == ["failed"])
        assert server.received == []
    entries = log(store, receiver)
    assert len(asked) == len(entries)
    assert all("127.0.0.1 is not a public address" in entry["error"] for entry in entries[1:])


def test_connection_goes_to_the_checked_address_with_the_name_in_the_host_header(store, sink):
    async def resolver(host, port):
        return ["127.0.0.1"]

    with receiving() as server:
        add(store, f"http://hook.example:{server.server_port}/a?b")
        with delivering(store, resolver=resolver):
            sink.take(make_alarm(RUN))
            (got,) = server.wait(1)
    assert (got.path, got.headers["host"]) == ("/a?b", f"hook.example:{server.server_port}")


@pytest.mark.parametrize(
    "trickle",
    [b"HTTP/1.1 200 OK\r\nx: ", b"not http at all\r\n\r\n", b"", b"HTTP/1.1 200 OK\r\n" + b"a: b\r\n" * 9000],
)
def test_odd_answers_end_in_time_and_take_no_memory(store, sink, trickle):
    """An answer without end, one that is not HTTP, none, and one of endless headers."""
    done = threading.Event()

    def answer(listener):
        with contextlib.suppress(OSError):
            while True:
                connection, _ = listener.accept()
                with connection, contextlib.suppress(OSError):
                    connection.sendall(trickle)
                    while trickle.endswith(b": ") and not done.wait(0.05):
                        connection.sendall(b"y")

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=answer, args=(listener,), daemon=True).start()
        receiver = add(store, f"http://127.0.0.1:{listener.getsockname()[1]}/")
        with delivering(store, rules=DeliveryRules(timeout=0.2, schedule=Schedule(delays=()))):
            sink.take(make_alarm(RUN))
            wait_for(lambda: statuses(store) == ["failed"])
        done.set()
        listener.shutdown(socket.SHUT_RDWR)
    (entry,) = log(store, receiver)
    assert entry["status_code"] is None
    assert entry["seconds"] < 2
    assert entry["error"]


def test_retry_after_pauses_the_receiver(store, sink):
    with receiving((429, {"Retry-After": "1"})) as server, delivering(store):
        add(store, server.url)
        for number in range(3):
            sink.take(make_alarm(RUN, number=number))
        first, second = server.wait(2)
        assert 0.9 < second.at - first.at < 3
        server.wait(4)


def test_gone_disables_at_once_with_an_alarm_that_enabling_clears(store, sink):
    from creak.webhooks import trouble

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


def all_receivers(store):
    with store.read() as connection:
        return receivers.page(connection, None, 100)


# --- order, rate, storms -----------------------------------------------------------------------------------------


def test_order_within_an_alarm_holds_over_failures_while_others_go_on(store, sink):
    """Kills a cleared that overtakes the raised which failed, and an alarm that holds up another."""
    answers = [500, 204, 204, 500, 204, 500, 500]
    with receiving(*answers) as server, delivering(store):
        add(store, server.url)
        for pair in zip(changes(0), changes(1), changes(2), strict=True):
            for change in pair:
                sink.take(change)
        wait_for(lambda: statuses(store) == ["delivered"] * 12)
    for number in range(3):
        told = [got.json["data"] for got in server.received]
        levels = [alarm["level_db"] for alarm in told if alarm["id"].endswith(f"/{number}")]
        assert levels == sorted(levels)
        assert set(levels) == {0.0, 1.0, 2.0, 3.0}


def test_storm_is_capped_and_put_together_without_losing_an_alarm(store, sink):
    with receiving() as server:
        add(store, server.url)
        for number in range(30):
            for change in changes(number, 2):
                sink.take(change)
        with delivering(store, rules=DeliveryRules(per_minute=120, burst=3, storm=5, schedule=FAST)):
            server.wait(4)
            wait_for(lambda: "pending" not in statuses(store))
        assert len(server.received) <= 6
        last = {}
        for got in server.received:
            data = got.json["data"]
            for alarm in data["alarms"] if got.json["type"] == "alarms.coalesced" else [data]:
                last[alarm["id"]] = alarm["event"]
    assert last == {make_alarm(RUN, number=number).id: "cleared" for number in range(30)}
    assert set(statuses(store)) == {"delivered", "coalesced"}


def test_stalled_receiver_holds_up_nobody_else(store, sink):
    slow, rules = ("stall", {"seconds": 5}), DeliveryRules(timeout=4.0)
    with receiving(*[slow] * 5) as stalled, receiving() as server, delivering(store, rules=rules):
        add(store, stalled.url)
        add(store, server.url)
        begun = time.monotonic()
        for number in range(10):
            sink.take(make_alarm(RUN, number=number))
        server.wait(10)
        assert time.monotonic() - begun < 3.9
        assert stalled.received


def test_one_of_two_deliverers_delivers(store, sink, tmp_path):
    other = open_store(f"sqlite:///{tmp_path}/creak.db")
    with receiving() as server, delivering(store), delivering(other):
        add(store, server.url)
        for number in range(20):
            sink.take(make_alarm(RUN, number=number))
        server.wait(20)
        wait_for(lambda: statuses(store) == ["delivered"] * 20)
        assert len(server.received) == 20
    other.close()


def test_removed_receiver_takes_its_messages_with_it(store, sink):
    receiver = add(store, "http://127.0.0.1:9/")
    sink.take(make_alarm(RUN))
    with store.write() as connection:
        assert receivers.remove(connection, receiver.id)
        assert not receivers.remove(connection, receiver.id)
        for table in (messages, deliveries):
            assert connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one() == 0


def test_kill_9_loses_no_message():
    """Six here; the bench does two hundred."""
    from bench.bench_webhooks import measure

    result = measure(6)
    assert result["written"] > 6
    assert (result["lost"], result["ids_of_more_than_one_body"]) == (0, 0)
