"""What operators do with nodes, whether these have ever alarmed or not."""

import concurrent.futures
import random
import threading
from dataclasses import replace

import pytest

from api_client import V1, assert_problem, get, serving
from conftest import make_frames, make_rig, make_run
from creak import alarms
from creak.alarm_records import Action, ActionKind, AlarmRules, AlarmState, Conflict
from creak.api import create_app
from creak.baseline import Baseline
from creak.codec import memory_bytes
from creak.monitor import Monitor
from creak.records import AlarmChange, Counts, RunEnd, RunStatus
from creak.sinks import actions
from creak.sinks.background import BackgroundStore
from creak.sinks.database import open_store
from creak.sinks.recorder import Recorder
from creak.sinks.restart import saved_memory
from creak.sinks.store import StoreSink
from creak.sources.recording import Recording
from creak.trend import Trend
from creak.worker import Worker
from store_records import SECOND, START, feed, opened

RUN = make_run(make_rig(2, samples=128, lines=range(2, 40), name="beam"), window=2, start=START)
NODES = f"{V1}/rigs/beam/nodes"
WHO = {"by": "ada", "comment": "bearing is changed"}


def asked(kind, node="2", identifier=""):
    return Action(identifier, kind, "ada", "why", node=node)


def step(alarm, kind, second):
    alarm, changes = alarms.act(alarm, asked(kind), START + second * SECOND, AlarmRules(), "run")
    return alarm, [(c.event, c.state.value, c.version, c.never_raised) for c in changes]


def test_a_node_that_never_alarmed_is_retired_alarms_out_of_sight_and_is_reinstated():
    alarm, told = step(alarms.Alarm("beam", "2"), ActionKind.RETIRE, 0)
    assert told == [("retired", "out_of_service", 1, True)]
    assert step(alarm, ActionKind.RETIRE, 1)[1] == []
    first = alarm.id
    alarm, changes = alarms.demand(alarm, "alarm", START + 2 * SECOND, AlarmRules(), "run", "level", 6.0)
    assert [(c.id, c.event, c.state.value, c.version, c.never_raised) for c in changes] == [
        (first, "raised", "out_of_service", 2, False)
    ]
    assert changes[0].since == START + 2 * SECOND
    alarm, told = step(alarm, ActionKind.REINSTATE, 3)
    assert told == [("reinstated", "unacknowledged", 3, False)]
    assert alarm.id == first


def test_an_occurrence_that_is_over_gets_nothing_added():
    """Kills an action that changes what has ended."""
    alarm, _ = alarms.demand(alarms.Alarm("beam", "2"), "alarm", START, AlarmRules(), "run")
    first = alarm.id
    alarm, _ = alarms.act(alarm, Action(first, ActionKind.ACKNOWLEDGE, "ada"), START + 1, AlarmRules(), "run")
    alarm, _ = alarms.demand(alarm, None, START + SECOND, AlarmRules(), "run")
    alarm, told = step(alarm, ActionKind.SUPPRESS, 2)
    assert told == [("suppressed", "suppressed", 1, True)]
    assert alarm.id != first
    alarm, told = step(alarm, ActionKind.UNSUPPRESS, 3)
    assert told == [("unsuppressed", "normal", 2, True)]
    second = alarm.id
    alarm, (raised,) = alarms.demand(alarm, "alarm", START + 4 * SECOND, AlarmRules(), "run")
    assert raised.id not in {first, second}
    assert (raised.version, raised.never_raised) == (1, False)


@pytest.mark.parametrize("seed", range(2))
def test_replay_equals_live_with_actions_on_nodes(tmp_path, seed):
    luck = random.Random(seed)
    monitor, recorder, live = Monitor(RUN), Recorder(tmp_path / "run.mcap"), []
    recorder.open(RUN)
    for frame in make_frames(RUN, 16, seed=seed, cubic=6, noise=1e-3):
        outcomes = list(monitor.take(frame))
        if luck.random() < 0.3:
            kind = luck.choice([k for k in ActionKind if k is not ActionKind.SHELVE])
            done = monitor.act(asked(kind, luck.choice("12")))
            outcomes += [] if isinstance(done, Conflict) else done
        for outcome in outcomes:
            recorder.take(outcome)
        live += [outcome for outcome in outcomes if isinstance(outcome, AlarmChange)]
    recorder.close(RunEnd(monitor.time, RunStatus.COMPLETED, Counts()))
    again = Monitor(RUN)
    items = Recording(tmp_path / "run.mcap").replayed()
    replayed = [o for item in items for o in again.take(item) if isinstance(o, AlarmChange)]
    assert [repr(change) for change in replayed] == [repr(change) for change in live]
    assert {True, False} == {change.never_raised for change in live}
    assert len({change.id for change in live if change.version == 1}) == sum(c.version == 1 for c in live)


def left(store, learnt=()):
    """A run of the rig that its worker has left, with what has been learnt."""
    sink = opened(store, RUN)
    feed(sink, RUN, 2)
    sink.save(replace(Monitor(RUN).memory, time=START + 2 * SECOND, baselines=tuple(learnt)))
    sink.close(RunEnd(START + 2 * SECOND, RunStatus.COMPLETED, Counts()))


def post(client, path, status=200, body=WHO):
    answer = client.post(f"{NODES}/{path}", json=body)
    assert answer.status_code == status, answer.text
    return answer.json()


def test_without_a_worker_over_rest_and_a_later_worker_learns_of_it(store):
    """Kills a node that is in service again after a restart, and a list with alarms that never were."""
    left(store)
    with serving(create_app(store)) as client:
        before = get(client, f"{NODES}/2")
        node = post(client, "2/retire")
        assert node == {**before, "alarm": "out_of_service"}
        assert post(client, "2/retire") == node
        assert get(client, f"{V1}/alarms")["items"] == []
        assert get(client, f"{V1}/alarms", state="normal")["items"] == []
        (entry,) = get(client, f"{V1}/alarms", state="out_of_service")["items"]
        assert (entry["node"], entry["by"], entry["comment"], entry["active"]) == ("2", *WHO.values(), False)
        sink = StoreSink(store)
        memory = saved_memory(store, "beam")
        later = replace(RUN, id="later", start=memory.time, before=memory_bytes(memory))
        monitor = Monitor(later, memory)
        desk = BackgroundStore(store, sink)
        desk.open(later)
        for asked_for in desk.asked():
            assert asked_for.told
            (change,) = monitor.act(asked_for.action)
            assert (change.id, change.version) == (entry["id"], entry["version"])
        assert monitor.alarms == {"1": AlarmState.NORMAL, "2": AlarmState.OUT_OF_SERVICE}
        desk.close(RunEnd(memory.time, RunStatus.COMPLETED, Counts()))


def test_each_pair_of_actions_over_rest(store):
    left(store)
    with serving(create_app(store)) as client:
        for there, back, state in (
            ("suppress", "unsuppress", "suppressed"),
            ("retire", "reinstate", "out_of_service"),
        ):
            assert post(client, f"1/{back}")["alarm"] == "normal"
            assert post(client, f"1/{there}")["alarm"] == state
            assert post(client, f"1/{back}")["alarm"] == "normal"
        assert get(client, f"{V1}/alarms")["items"] == []


def test_many_operators_at_once_leave_one_entry(store):
    """Kills two entries of a node whose alarm has no row yet that could be locked."""
    left(store)
    with serving(create_app(store)) as client, concurrent.futures.ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda i: post(client, "2/retire", body={"by": f"op {i}"}), range(16)))
        (entry,) = get(client, f"{V1}/alarms", state="out_of_service")["items"]
        assert entry["version"] == 1


def test_relearn_of_a_node_that_never_alarmed(store):
    """Kills a baseline that only an alarm could replace."""
    left(store, [Baseline("2", 0.02, 1e-9, Trend(25, 6.1, 4.0), realisations=100, complete=True, since=START)])
    with serving(create_app(store)) as client:
        answer = client.post(f"{NODES}/1/relearn", json=WHO)
        assert "no baseline" in assert_problem(answer, 409, "alarm-not-allowed")["detail"]
        assert post(client, "2/relearn")["alarm"] == "normal"
    with store.read() as connection:
        (waiting,) = actions.waiting(connection, "beam", 0)
    monitor = Monitor(RUN, saved_memory(store, "beam"))
    (told,) = monitor.act(waiting.action)
    assert (told.event, told.by, told.comment) == ("relearning", *WHO.values())
    assert monitor.baselines[0].successor is not None


class Source:
    """Frames of the rig without haste, until it is told to end."""

    live = False

    def __init__(self):
        self.run, self._closed = RUN, threading.Event()

    def frames(self):
        for frame in make_frames(RUN, 500, noise=1e-3):
            if self._closed.wait(0.01):
                return
            yield frame

    def close(self):
        self._closed.set()


def test_a_living_worker_does_it(store):
    desk = BackgroundStore(store, StoreSink(store))
    worker = Worker(Source(), [desk], desk=desk)
    worker.start()
    try:
        with serving(create_app(store)) as client:
            assert post(client, "2/retire")["alarm"] == "out_of_service"
            assert worker._path.monitor.alarms["2"] is AlarmState.OUT_OF_SERVICE
            assert_problem(client.post(f"{NODES}/2/relearn", json=WHO), 409, "alarm-not-allowed")
            assert post(client, "2/reinstate")["alarm"] == "normal"
            assert get(client, f"{V1}/alarms")["items"] == []
    finally:
        worker.stop()
    assert worker.error is None


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    store = open_store(f"sqlite:///{tmp_path_factory.mktemp('nodes')}/creak.db")
    left(store)
    with serving(create_app(store)) as client:
        yield client
        assert {node["alarm"] for node in get(client, NODES)["items"]} == {"normal"}
    store.close()


@pytest.mark.parametrize("verb", ["relearn", "suppress", "unsuppress", "retire", "reinstate"])
def test_what_is_not_there_or_not_said_is_refused_and_changes_nothing(shared, verb):
    assert_problem(shared.post(f"{NODES}/9/{verb}", json=WHO), 404, "unknown-node")
    assert_problem(shared.post(f"{V1}/rigs/nosuch/nodes/2/{verb}", json=WHO), 404, "unknown-rig")
    for body in ({}, {"by": ""}, {"by": 3}, {"by": "a\x00"}, {"by": "a", "more": 1}, [], None):
        assert_problem(shared.post(f"{NODES}/2/{verb}", json=body), 422, "bad-parameter")
