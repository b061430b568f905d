"""A fleet as processes: workers, analysers, broker, store and API, some of them killed."""

import signal
import time

import httpx
import pytest
import sqlalchemy as sa

from fleet_places import Processes, broker, write_fleet
from fleet_truth import closed, expected, progress, stored
from processes import free_port
from store_places import place

RIGS = ["a", "b"]
DEADLINE = 120.0  # seconds after which something hangs; not a figure


def wait_for(what, until, processes=None):
    end = time.monotonic() + DEADLINE
    while not (found := until()):
        assert time.monotonic() < end, (
            what,
            processes and {n: processes.said(n)[-2000:] for n in processes.running},
        )
        time.sleep(0.1)
    return found


@pytest.fixture
def folder(tmp_path):
    with place("postgresql", tmp_path) as url, broker(tmp_path / "nats") as server:
        write_fleet(tmp_path, server.url, url, RIGS)
        engine = sa.create_engine(url)
        processes = Processes(tmp_path)
        try:
            yield tmp_path, server, engine, processes
        finally:
            processes.close()
            engine.dispose()


def owners(engine):
    return {row.owner for row in progress(engine).values() if row.owner}


def taken(engine, rig):
    row = progress(engine).get(rig)
    return 0 if row is None else row.blocks


def goes_on(engine, processes, rig, by=3):
    before = taken(engine, rig)
    wait_for(f"{rig} goes on", lambda: taken(engine, rig) >= before + by, processes)


def test_nothing_is_lost_or_counted_twice_when_parts_of_a_fleet_are_killed(folder):
    """Kills a realisation that is lost with a broker, a worker or an analyser, and one that is taken twice.

    What the store holds at the end is compared with what the workers' own recordings say it must be.
    """
    path, server, engine, processes = folder
    told = {name: free_port() for name in ("one", RIGS[0])}
    processes.start("one", "analyse", "analyse.toml", CREAK_STREAM__METRICS_PORT=str(told["one"]))
    processes.start("two", "analyse", "analyse.toml")
    for rig in RIGS:
        own = {"CREAK_STREAM__METRICS_PORT": str(told[rig])} if rig in told else {}
        processes.start(rig, "worker", f"{rig}-worker.toml", **own)
    port = free_port()
    processes.start("api", "serve", "analyse.toml", "--api-only", CREAK_SERVER__PORT=str(port))
    wait_for("each analyser has a rig", lambda: len(owners(engine)) == 2, processes)
    for rig in RIGS:
        goes_on(engine, processes, rig)

    figures = {name: httpx.get(f"http://127.0.0.1:{own}/metrics").text for name, own in told.items()}
    assert "creak_rigs_owned 1.0" in figures["one"]
    assert 'creak_realisations_total{rig="a"}' in figures["a"]

    processes.kill("one")
    wait_for("its rig is taken over", lambda: len(owners(engine)) == 1, processes)
    for rig in RIGS:
        goes_on(engine, processes, rig)

    server.kill()
    processes.start("one", "analyse", "analyse.toml")
    time.sleep(1.0)  # workers go on measuring meanwhile
    server.start()
    for rig in RIGS:
        goes_on(engine, processes, rig)

    recordings = path / "data-a"
    before = len(list(recordings.rglob("*.mcap")))
    processes.kill("a")
    processes.start("a", "worker", "a-worker.toml")
    # The broker may still hold realisations of the killed one: a recording of its own says that this one measures.
    wait_for("a measures again", lambda: len(list(recordings.rglob("*.mcap"))) > before, processes)
    goes_on(engine, processes, "a")

    rigs = httpx.get(f"http://127.0.0.1:{port}/api/v1/rigs").json()["items"]
    assert {rig["name"]: rig["status"] for rig in rigs} == dict.fromkeys(RIGS, "running")
    assert httpx.get(f"http://127.0.0.1:{port}/readyz").status_code == 200

    for rig in RIGS:
        assert processes.kill(rig, signal.SIGTERM) == 0
    wait_for("all is told", lambda: closed(engine, path, RIGS), processes)
    for name in ("one", "two"):
        assert processes.kill(name, signal.SIGTERM) == 0
    assert not owners(engine)
    for rig in RIGS:
        estimates, changes, complete = expected(path, rig)
        found, journal, counted, twice, alarms_twice = stored(engine, rig)
        assert counted == complete
        assert found.keys() == estimates.keys()
        assert found == estimates  # the same arithmetic on the same frames: to the last bit
        assert journal == changes
        assert any(change["event"] == "raised" for change in changes)
        assert (twice, alarms_twice) == (0, 0)
