"""Figures for Prometheus of a worker's or an analyser's own process, on loopback.

What the fleet has come to is in the store, and served by the API. These tell what the store cannot know: what a
worker measures while the broker is away, and who does the analysing.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager

from prometheus_client import CollectorRegistry, ProcessCollector, start_http_server
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from creak.analyser import Analyser
from creak.broker import Broker
from creak.digests import Gatherer
from creak.errors import ConfigurationError
from creak.sinks.stream import StreamSink


class WorkerCollector(Collector):
    """What each rig of a worker has come to, and what waits for the broker.

    Parameters
    ----------
    rigs : sequence of (Gatherer, StreamSink)
    broker : Broker
    """

    def __init__(self, rigs: Sequence[tuple[Gatherer, StreamSink]], broker: Broker) -> None:
        self._rigs = rigs
        self._broker = broker

    def collect(self) -> Iterable[Metric]:
        """Return all families."""
        frames = CounterMetricFamily("creak_frames", "Frames of the run, as judged.", labels=["rig", "status"])
        complete = CounterMetricFamily("creak_realisations", "Complete realisations of the run.", labels=["rig"])
        faults = CounterMetricFamily("creak_faults", "Data refused or missing in the run.", labels=["rig", "kind"])
        waiting = GaugeMetricFamily("creak_letters_waiting", "Not with the broker yet, in memory.", labels=["rig"])
        for gatherer, sink in self._rigs:
            rig, counts = gatherer.run.rig.name, gatherer.counts
            frames.add_metric([rig, "accepted"], counts.frames)
            frames.add_metric([rig, "rejected"], counts.rejected_frames)
            frames.add_metric([rig, "transient"], counts.transient_frames)
            complete.add_metric([rig], counts.realisations)
            for kind, count in counts.faults.items():
                faults.add_metric([rig, kind], count)
            waiting.add_metric([rig], sink.waiting)
        return frames, complete, faults, waiting, _connected(self._broker)


class AnalyserCollector(Collector):
    """How many rigs an analyser owns, and how many letters it has taken.

    Parameters
    ----------
    analyser : Analyser
    broker : Broker
    """

    def __init__(self, analyser: Analyser, broker: Broker) -> None:
        self._analyser = analyser
        self._broker = broker

    def collect(self) -> Iterable[Metric]:
        """Return all families."""
        taken = CounterMetricFamily("creak_letters_taken", "Realisations and ends of runs that it has stored.")
        taken.add_metric([], self._analyser.taken)
        yield taken
        yield GaugeMetricFamily("creak_rigs_owned", "Rigs that it analyses.", len(self._analyser.owned))
        yield _connected(self._broker)


@contextmanager
def served(port: int | None, collector: Collector) -> Iterator[None]:
    """Answer Prometheus on loopback for as long as the context lasts, if there is a port.

    Raises
    ------
    ConfigurationError
        If the port cannot be had.
    """
    if port is None:
        yield
        return
    registry = CollectorRegistry(auto_describe=False)
    registry.register(collector)
    ProcessCollector(registry=registry)
    try:
        server, thread = start_http_server(port, "127.0.0.1", registry)
    except OSError as error:
        raise ConfigurationError("configuration", "stream.metrics_port", f"{port}: {error.strerror}") from error
    try:
        yield
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def _connected(broker: Broker) -> Metric:
    return GaugeMetricFamily("creak_broker_connected", "1 while the broker answers.", float(broker.connected))
