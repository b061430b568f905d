"""Figures for Prometheus, computed from the store at every scrape, whichever process measures."""

import shutil
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from fastapi import APIRouter, Request, Response
from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, StateSetMetricFamily
from prometheus_client.exposition import choose_encoder
from prometheus_client.metrics_core import Metric
from prometheus_client.registry import Collector

from creak import __version__
from creak.api.describe import StoreOf, refusals
from creak.records import AlarmState, FaultKind, RunStatus, Scope
from creak.sinks import figures, queries
from creak.sinks.database import Store
from creak.sinks.store import RUNNING

router = APIRouter(tags=["service"])

_QUANTITIES = {
    "signal": "signal_db",
    "noise": "noise_db",
    "total": "total_db",
    "nonlinear": "nonlinear_db",
    "total_to_noise": "total_to_noise_db",
    "classical_noise": "classical_noise_db",
    "classical_total": "classical_total_db",
    "classical_total_to_noise": "classical_total_to_noise_db",
}
_FRAMES = {"accepted": "frames", "rejected": "rejected_frames", "transient": "transient_frames"}
_EXAMPLE = 'creak_frames_total{rig="beam",status="accepted"} 108.0\n'


class StoreCollector(Collector):
    """Reads the current run of every rig, and how the service fares.

    Parameters
    ----------
    store : Store
    data : Path or None
        Directory of the recordings, where this process can see it.
    """

    def __init__(self, store: Store, data: Path | None = None) -> None:
        self._store = store
        self._data = data

    def collect(self) -> Iterable[Metric]:
        """Return all families, each as of the same moment."""
        with self._store.read() as connection:
            runs = queries.current_runs(connection)
            nodes = {run["rig"]: queries.nodes(connection, run, Scope.WINDOW) for run in runs}
            alarms = figures.active_alarms(connection)
            receivers = figures.receivers(connection)
            recorded = figures.recorded_bytes(connection)
            jobs = figures.jobs(connection)
        yield InfoMetricFamily("creak_build", "Version of creak that answers.", {"version": __version__})
        yield from _run_families(runs)
        yield from _node_families(nodes)
        yield from _service_families(alarms, receivers, jobs)
        yield from _disk_families(recorded, self._data)


def _run_families(runs: list[queries.Row]) -> Iterable[Metric]:
    running = GaugeMetricFamily("creak_run_running", "1 while the rig is measured.", labels=["rig"])
    frames = CounterMetricFamily("creak_frames", "Frames of the run, as judged.", labels=["rig", "status"])
    complete = CounterMetricFamily("creak_realisations", "Complete realisations of the run.", labels=["rig"])
    faults = CounterMetricFamily("creak_faults", "Data refused or missing in the run.", labels=["rig", "kind"])
    recorded = GaugeMetricFamily("creak_last_recorded_timestamp_seconds", "Newest recorded time.", labels=["rig"])
    heard = GaugeMetricFamily(
        "creak_last_heard_timestamp_seconds", "Wall clock of the newest frame.", labels=["rig"]
    )
    beat = GaugeMetricFamily(
        "creak_last_beat_timestamp_seconds", "Wall clock at which the worker last wrote.", labels=["rig"]
    )
    period = GaugeMetricFamily("creak_period_seconds", "Length of a period.", labels=["rig"])
    status = StateSetMetricFamily("creak_run_status", "How the run stands.", labels=["rig"])
    for run in runs:
        rig = run["rig"]
        running.add_metric([rig], float(run["status"] == RUNNING))
        status.add_metric([rig], {name: run["status"] == name for name in (RUNNING, *RunStatus)})
        beat.add_metric([rig], run["beat_at"] / 1e9)
        period.add_metric([rig], run["period_samples"] / run["sample_rate"])
        for judged, column in _FRAMES.items():
            frames.add_metric([rig, judged], run[column])
        complete.add_metric([rig], run["realisations"])
        for kind in FaultKind:  # also the zeros, so that a rate exists before the first fault
            faults.add_metric([rig, kind.value], run["faults"].get(kind.value, 0))
        if run["last"] is not None:
            recorded.add_metric([rig], run["last"] / 1e9)
        if run["heard_at"] is not None:
            heard.add_metric([rig], run["heard_at"] / 1e9)
    return running, status, frames, complete, faults, recorded, heard, beat, period


def _node_families(rigs: Mapping[str, list[dict[str, Any]]]) -> Iterable[Metric]:
    level = GaugeMetricFamily(
        "creak_node_level_db",
        "Levels of the window, dB re 1 unit squared; ratios in dB.",
        labels=["rig", "node", "quantity"],
    )
    p_value = GaugeMetricFamily(
        "creak_node_p_value", "Probability of the window's statistic if linear.", labels=["rig", "node"]
    )
    alarm = StateSetMetricFamily("creak_node_alarm", "State of the node's alarm.", labels=["rig", "node"])
    for rig, nodes in rigs.items():
        for node in nodes:
            labels = [rig, node["name"]]
            for quantity, key in _QUANTITIES.items():
                if node[key] is not None:
                    level.add_metric([*labels, quantity], node[key])
            if node["p_value"] is not None:
                p_value.add_metric(labels, node["p_value"])
            alarm.add_metric(labels, {state.value: node["alarm"] == state.value for state in AlarmState})
    return level, p_value, alarm


def _service_families(
    alarms: Mapping[tuple[str, str, str, bool], int],
    receivers: Iterable[figures.ReceiverState],
    jobs: Mapping[tuple[str, str], int],
) -> Iterable[Metric]:
    active = GaugeMetricFamily(
        "creak_active_alarms", "Alarms that stand.", labels=["rig", "class", "severity", "acknowledged"]
    )
    for (rig, class_, severity, acknowledged), count in alarms.items():
        active.add_metric([rig, class_, severity, str(acknowledged).lower()], count)
    enabled = GaugeMetricFamily("creak_webhook_enabled", "1 unless the receiver is disabled.", labels=["webhook"])
    waiting = GaugeMetricFamily("creak_webhook_waiting", "Messages that wait for delivery.", labels=["webhook"])
    failing = GaugeMetricFamily(
        "creak_webhook_failing_since_timestamp_seconds",
        "Wall clock of the first failure since the last success; absent while deliveries succeed.",
        labels=["webhook"],
    )
    for receiver in receivers:
        enabled.add_metric([receiver.id], float(receiver.enabled))
        waiting.add_metric([receiver.id], receiver.waiting)
        if receiver.failing_since is not None:
            failing.add_metric([receiver.id], receiver.failing_since / 1e9)
    counted = GaugeMetricFamily("creak_jobs", "Diagnoses and replays.", labels=["kind", "status"])
    for key, count in jobs.items():
        counted.add_metric(key, count)
    return active, enabled, waiting, failing, counted


def _disk_families(recorded: Mapping[str, int], data: Path | None) -> Iterable[Metric]:
    size = GaugeMetricFamily("creak_recordings_bytes", "Size of all recordings of a rig.", labels=["rig"])
    for rig, count in recorded.items():
        size.add_metric([rig], count)
    yield size
    if data is not None:
        with suppress(OSError):  # a directory that cannot be seen has no figures
            disk = shutil.disk_usage(data)
            yield GaugeMetricFamily("creak_data_size_bytes", "Size of the recordings' file system.", disk.total)
            yield GaugeMetricFamily("creak_data_free_bytes", "What is free of it.", disk.free)


@router.get(
    "/metrics",
    response_class=Response,
    responses={
        200: {"description": "Prometheus or OpenMetrics text.", "content": {"text/plain": {"example": _EXAMPLE}}},
        **refusals(),
    },
)
def metrics(request: Request, store: StoreOf) -> Response:
    """Figures of all rigs for Prometheus."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(StoreCollector(store, request.app.state.data))
    ProcessCollector(registry=registry)
    encode, media_type = choose_encoder(request.headers.get("accept", ""))
    return Response(encode(registry), media_type=media_type)
