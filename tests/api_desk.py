"""An alarm as a worker keeps it, for tests of what operators may do with it over REST."""

import contextlib

from api_client import V1, get, serving
from creak.alarm_records import AlarmRules, Conflict
from creak.alarms import act
from creak.alarms.life import Alarm, demand
from creak.api import create_app
from creak.api.access import Access
from creak.records import Counts, RunEnd, RunStatus
from creak.sinks import actions
from creak.sinks.database import open_store
from store_records import SECOND, START, make_run, opened

RUN = make_run("beam-1")
LOOPBACK = ["127.0.0.0/8"]
SEEN = {"by": "operator", "comment": "seen"}


class Desk:
    """A worker's part: one alarm, carried through its life by the rules, and the store that hears of it."""

    def __init__(self, store, number=0):
        self.store, self.sink, self.time = store, opened(store, RUN), START + number * SECOND
        self.alarm = Alarm("beam", "3")
        self.want("alarm")

    def want(self, severity):
        self.time += SECOND
        self.alarm, changes = demand(self.alarm, severity, self.time, AlarmRules(), RUN.id, "level", 11.0)
        for change in changes:
            self.sink.take(change)

    def work(self):
        """What a worker does at each turn."""
        with self.store.read() as connection:
            waiting = actions.waiting(connection, "beam", 0)
        for asked in waiting:
            done = act(self.alarm, asked.action, self.time, AlarmRules(), RUN.id)
            conflict = done if isinstance(done, Conflict) else None
            if conflict is None:
                self.alarm = done[0]
                for change in () if asked.told else done[1]:
                    self.sink.take(change)
            with self.store.write() as connection:
                actions.answer(connection, asked, conflict)
        return len(waiting)


def left_alone(desk):
    """The same, its worker ended."""
    desk.sink.close(RunEnd(desk.time, RunStatus.COMPLETED, Counts()))
    return desk


@contextlib.contextmanager
def refusing(directory):
    """A client and the path of an alarm, for what is refused and changes nothing."""
    store = open_store(f"sqlite:///{directory}/creak.db")
    desk = left_alone(Desk(store))
    with serving(create_app(store, access=Access(allow=LOOPBACK))) as client:
        yield client, f"{V1}/alarms/{desk.alarm.id}"
        assert get(client, f"{V1}/webhooks")["items"] == []
    store.close()


def post(client, path, status=200, body=None, **headers):
    answer = client.post(V1 + path, json=body, headers=headers)
    assert answer.status_code == status, answer.text
    return answer.json()
