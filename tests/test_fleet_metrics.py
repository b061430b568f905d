"""What a worker's and an analyser's own process tell Prometheus."""

import socket
import urllib.error
import urllib.request
from contextlib import closing
from types import SimpleNamespace

import pytest
from prometheus_client.parser import text_string_to_metric_families

from conftest import make_frames, make_rig, make_run
from creak.cli.fleet_metrics import AnalyserCollector, WorkerCollector, served
from creak.digests import Gatherer
from creak.errors import ConfigurationError
from creak.records import Fault, FaultKind
from processes import free_port

BROKER = SimpleNamespace(connected=False)


def scraped(port):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30) as answer:
        families = text_string_to_metric_families(answer.read().decode())
    return {(s.name, *sorted(s.labels.values())): s.value for family in families for s in family.samples}


def test_a_worker_tells_what_it_measures_while_the_broker_is_away():
    run = make_run(make_rig(2, name="beam"))
    gatherer, port = Gatherer(run), free_port()
    with served(port, WorkerCollector([(gatherer, SimpleNamespace(waiting=3))], BROKER)):
        assert scraped(port)["creak_realisations_total", "beam"] == 0
        frames = make_frames(run, 3)
        for frame in frames[:-1]:
            gatherer.take(frame)
        gatherer.take(Fault(FaultKind.LOST, frames[-1].time, "gone"))
        found = scraped(port)
    assert found["creak_realisations_total", "beam"] == 2
    assert found["creak_frames_total", "accepted", "beam"] == 8
    assert found["creak_frames_total", "beam", "transient"] == 6
    assert found["creak_faults_total", "beam", "lost"] == 1
    assert found["creak_letters_waiting", "beam"] == 3
    assert found["creak_broker_connected",] == 0
    assert found["process_resident_memory_bytes",] > 1e6
    with pytest.raises(urllib.error.URLError):
        scraped(port)


def test_an_analyser_tells_its_share_and_a_port_that_is_taken_is_one_line():
    analyser = SimpleNamespace(owned=frozenset({"a", "b"}), taken=7)
    collector = AnalyserCollector(analyser, BROKER)
    with closing(socket.create_server(("127.0.0.1", 0))) as other:
        port = other.getsockname()[1]
        with pytest.raises(ConfigurationError, match=rf"stream\.metrics_port: {port}: "), served(port, collector):
            pass
    with served(port, collector):
        found = scraped(port)
    assert (found["creak_rigs_owned",], found["creak_letters_taken_total",]) == (2, 7)
    with served(None, collector):  # nobody asked for it
        pass
