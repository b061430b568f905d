"""Order within an alarm, storms, several receivers and deliverers: one receiver's trouble is its own."""

import time
from collections import Counter

import pytest
import sqlalchemy as sa

from creak.sinks import outbox, receivers
from creak.sinks.database import open_store
from creak.sinks.operator_tables import deliveries
from creak.sinks.operator_tables import outbox as messages
from creak.webhooks.delivery import DeliveryRules
from processes import wait_for
from receiver import receiving
from store_records import make_alarm, opened
from webhook_desk import FAST, RUN, add, changes, delivering, statuses


@pytest.fixture
def sink(store):
    return opened(store, RUN)


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


def test_backlog_of_any_length_is_put_together_and_one_message_stays_as_it_is(tmp_path):
    """Kills a list of all that waits in one statement: a database takes so many values and no more."""
    store = open_store(f"sqlite:///{tmp_path}/creak.db")
    sa.event.listen(store._engine, "checkout", lambda connection, *_: connection.setlimit(9, 50))  # of values
    receiver = add(store, "http://127.0.0.1:9/")
    sink = opened(store, RUN)
    sink.take(changes(0)[0])
    with store.write() as connection:
        assert outbox.coalesce(connection, receiver, 7) is None
    assert statuses(store) == ["pending"]
    for number in range(1, 40):
        for change in changes(number, 2):
            sink.take(change)
    with store.write() as connection:
        assert outbox.coalesce(connection, receiver, 7) is not None
    assert Counter(statuses(store)) == {"coalesced": 79, "pending": 1}
    store.close()


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


def test_one_of_two_deliverers_delivers(store, sink, url):
    other = open_store(url)
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
