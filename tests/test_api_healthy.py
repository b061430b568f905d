"""A rig without a model: an alarm is diagnosed against the healthy realisations before it, by the same call."""

import pytest

from api_client import V1, assert_problem, serving
from creak.api import create_app
from creak.jobs import arguments
from creak.sinks import jobs
from creak.sinks.database import open_store
from store_records import SECOND, START, make_alarm
from test_diagnosable import filled


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number in range(4):
        (tmp_path / f"{number}.mcap").touch()
    store = open_store(f"sqlite:///{tmp_path}/creak.db")
    yield store
    store.close()


def test_an_alarm_of_a_rig_without_model_is_held_against_what_was_before_it(store):
    """Kills an answer that asks for equations where a healthy past was recorded; and one that mixes it in."""
    sink, run = filled(store, 40)
    late, early = (make_alarm(run, id=name, since=START + s * SECOND) for name, s in (("late", 19), ("early", 2)))
    sink.take(late)
    sink.take(early)
    with serving(create_app(store)) as client:
        answer = client.post(f"{V1}/diagnoses", json={"alarm": "late"})
        assert answer.status_code == 202, answer.text
        asked = answer.json()["request"]
        assert (asked["model"], asked["healthy_realisations"]) == (None, [4, 15])
        assert (asked["first_realisation"], asked["last_realisation"]) == (17, 28)
        # What was raised at once has no healthy past, and a recording alone does not tell healthy from not.
        assert_problem(client.post(f"{V1}/diagnoses", json={"alarm": "early"}), 409, "no-model")
        assert_problem(client.post(f"{V1}/diagnoses", json={"recording": "p0"}), 409, "no-model")
        model = client.post(f"{V1}/diagnoses", json={"alarm": "late", "model": "m.toml"})
        assert_problem(model, 422, "bad-parameter")
    claimed = jobs.claim(store, 0)
    words = arguments(claimed.task, None)
    assert words[:2] == ["diagnose", "--json"]
    assert words[2:6] == ["--healthy", "0.mcap", "--healthy", "1.mcap"]
    assert words[6:10] == ["--first-healthy", "4", "--last-healthy", "15"]
    assert words[words.index("--") + 1 :] == ["1.mcap", "2.mcap"]
