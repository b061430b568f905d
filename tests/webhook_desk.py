"""Receivers, a deliverer and the log, as the tests of webhooks use them."""

import contextlib
import itertools

import sqlalchemy as sa

from creak.sinks import outbox, receivers
from creak.sinks.operator_tables import outbox as messages
from creak.webhooks.addresses import AddressPolicy
from creak.webhooks.delivery import Deliverer, DeliveryRules
from creak.webhooks.schedule import Schedule
from creak.webhooks.signature import new_secret
from store_records import SECOND, START, make_alarm, make_run

RUN = make_run("beam-1")
FAST = Schedule(delays=(0.02, 0.04, 0.08, 0.16), disable_after=3600.0)
LOOPBACK = AddressPolicy(["127.0.0.0/8"])


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


def statuses(store):
    with store.read() as connection:
        return list(connection.execute(sa.select(messages.c.status).order_by(messages.c.seq)).scalars())


def changes(number, count=4):
    """One alarm raised and cleared over and over."""
    return [
        make_alarm(RUN, number=number, event=event, time=START + i * SECOND, level_db=float(i))
        for i, event in zip(range(count), itertools.cycle(("raised", "cleared")), strict=False)
    ]


def all_receivers(store):
    with store.read() as connection:
        return receivers.page(connection, None, 100)
