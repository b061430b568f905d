"""Figures of the service itself: receivers that fail, jobs that wait, alarms of runs that are over."""

import pytest

from creak.sinks import figures, receivers
from creak.sinks.database import open_store
from creak.sinks.service_alarms import SERVICE, clear_alarm, raise_alarm
from creak.sinks.store import StoreSink
from store_records import fill_beam, make_run


@pytest.fixture
def store(tmp_path):
    made = open_store(f"sqlite:///{tmp_path}/creak.db")
    yield made
    made.close()


def test_receivers_tell_since_when_they_fail_and_what_waits(store):
    with store.write() as connection:
        failing = receivers.add(connection, "https://a.example/", (), (), "standard", "whsec_a").id
        well = receivers.add(connection, "https://b.example/", ("nothing",), (), "standard", "whsec_b").id
        receivers.update(connection, failing, failing_since_at=7, enabled=False)
        receivers.update(connection, failing, enabled=True)
    fill_beam(store)  # raises an alarm, of which one of them is to hear
    with store.read() as connection:
        found = figures.receivers(connection)
    assert [(r.id, r.enabled, r.failing_since) for r in found] == [(failing, True, 7), (well, True, None)]
    assert found[0].waiting > 0
    assert found[1].waiting == 0


def test_only_alarms_of_current_runs_stand(store):
    """Kills an alarm of a run that was replaced: nobody could acknowledge it, and it would be counted for ever."""
    fill_beam(store)
    beam = ("beam", "process", "alarm", False)
    with store.read() as connection:
        assert figures.active_alarms(connection)[beam] == 1
    StoreSink(store).open(make_run("another run"))
    with store.write() as connection:
        assert beam not in figures.active_alarms(connection)
        own = raise_alarm(connection, SERVICE, "", "webhook_disabled", 0, reason="410", guidance="enable it")
        (((rig, class_, _, acknowledged), count),) = figures.active_alarms(connection).items()
        assert (rig, class_, acknowledged, count) == (SERVICE, "quality", False, 1)
        clear_alarm(connection, own, 1)
        assert figures.active_alarms(connection) == {}
