"""Baselines over REST: what was learnt can be read, stays as it is, and is replaced if an operator asks for it."""

from dataclasses import replace

from api_client import V1, assert_problem, get, serving, walk
from conftest import make_rig
from conftest import make_run as make_real_run
from creak.alarm_records import BaselineRules, Limits
from creak.api import create_app
from creak.monitor import Monitor
from creak.records import AlarmChange, Counts, RunEnd, RunStatus
from creak.sinks import actions
from drifting import drifting_frames
from store_records import opened

RUN = replace(
    make_real_run(
        make_rig(2, samples=128, lines=range(2, 42), transient=0),
        window=4,
        limits=Limits(total_to_noise_db=12.0, p_value=1e-4, false_alarms_per_year=None),
    ),
    baseline=BaselineRules(realisations=40, change_db=3.0),
)
RIG = RUN.rig.name
CHANGED = {"by": "ada", "comment": "new bearing"}
FRAMES = list(drifting_frames(RUN, 240, lambda m: 1.0 if m < 80 else 3.0))  # four frames a realisation


class Bench:
    """A rig whose node 2 changes after 80 realisations: monitor and store as a worker would keep them."""

    def __init__(self, store):
        self.store, self.sink, self.monitor = store, opened(store, RUN), Monitor(RUN)

    def measure(self, first, last, save=True):
        for frame in FRAMES[4 * first : 4 * last]:
            for outcome in self.monitor.take(frame):
                if isinstance(outcome, AlarmChange):
                    self.sink.take(outcome)
        if save:
            self.sink.save(self.monitor.memory)

    def end(self):
        self.sink.close(RunEnd(self.monitor.time, RunStatus.COMPLETED, Counts()))

    def learn_of_actions(self):
        """What a worker does before its first frame."""
        with self.store.read() as connection:
            waiting = actions.waiting(connection, RIG, 0)
        return [(asked.told, self.monitor.act(asked.action)) for asked in waiting]


def of_node(client, name):
    (item,) = get(client, f"{V1}/rigs/{RIG}/baselines", node=name)["items"]
    return item


def test_a_baseline_is_read_stays_frozen_and_is_replaced_over_rest(store):
    """Kills a relearn that is told and changes nothing, and one that drops the old baseline at once."""
    bench = Bench(store)
    with serving(create_app(store)) as client:
        assert get(client, f"{V1}/rigs/{RIG}/baselines") == {"rig": RIG, "time": None, "items": [], "next": None}
        bench.measure(0, 20)
        learning = of_node(client, "2")
        assert (learning["complete"], learning["successor"]) == (False, None)
        assert 0 < learning["realisations"] < 40
        bench.measure(20, 80)
        first = of_node(client, "2")
        assert (first["complete"], first["realisations"], first["windows"]) == (True, 40, 10)
        bench.measure(80, 120)
        bench.end()
        assert of_node(client, "2") == first  # frozen, though the machine has changed
        assert [item["node"] for item in walk(client, f"{V1}/rigs/{RIG}/baselines", limit=1)] == ["1", "2"]
        (alarm,) = get(client, f"{V1}/alarms", node="2")["items"]
        told = client.post(f"{V1}/alarms/{alarm['id']}/relearn", json=CHANGED)
        assert told.status_code == 200, told.text
        assert (told.json()["event"], told.json()["by"], told.json()["active"]) == ("relearning", "ada", True)
        assert [asked for asked, _ in bench.learn_of_actions()] == [True]
        bench.measure(120, 130)
        during = of_node(client, "2")
        assert {**during, "successor": None} == first  # in force until the new one is complete
        assert 0 < during["successor"]["realisations"] < 40
        assert of_node(client, "1")["successor"] is None
        bench.measure(130, 240)
        new = of_node(client, "2")
        assert (new["complete"], new["successor"]) == (True, None)
        assert new["mean_db"] > first["mean_db"] + 3.0
        assert new["since"] > first["updated"]


def test_what_has_no_baseline_cannot_be_relearnt(store):
    """Kills a relearn that says 'done' where nothing is learnt."""
    bench = Bench(store)
    bench.measure(0, 120, save=False)
    bench.end()
    with serving(create_app(store)) as client:
        (alarm,) = get(client, f"{V1}/alarms", node="2")["items"]
        path = f"{V1}/alarms/{alarm['id']}/relearn"
        problem = assert_problem(client.post(path, json=CHANGED), 409, "alarm-not-allowed")
        assert "baseline" in problem["detail"]
        assert get(client, f"{V1}/alarms/{alarm['id']}")["event"] == alarm["event"]
        assert_problem(client.post(path, json={}), 422, "bad-parameter")
        assert_problem(client.post(f"{V1}/alarms/nosuch/relearn", json=CHANGED), 404, "unknown-alarm")


def test_baselines_of_what_is_not_there(store):
    opened(store, RUN)
    with serving(create_app(store)) as client:
        assert_problem(client.get(f"{V1}/rigs/nosuch/baselines"), 404, "unknown-rig")
        assert_problem(client.get(f"{V1}/rigs/{RIG}/baselines?node=nosuch"), 404, "unknown-node")
