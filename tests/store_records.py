"""Records such as a worker hands to the store, made without measuring anything."""

from dataclasses import replace

import numpy as np

from conftest import make_rig
from creak.baseline import Baseline
from creak.monitor import Monitor
from creak.records import (
    AlarmChange,
    AlarmState,
    ElementShare,
    Estimate,
    Excitation,
    Fault,
    FaultKind,
    Frame,
    FrameStatus,
    NodeLevel,
    Run,
    Scope,
    Spectra,
)
from creak.sinks.store import RecordingEntry, StoreSink, put_recording
from creak.trend import Trend

START = 1_777_622_400_000_000_000  # 2026-05-01T08:00:00Z
SECOND = 1_000_000_000


def make_run(run_id="run-1", name="beam", rig=None, **changes):
    rig = make_rig(name=name) if rig is None else rig
    return Run(
        id=run_id,
        rig=rig,
        steady_periods=2,
        start=START,
        excitation=Excitation("multisine", rms=0.02, seed=1),
        source="simulated",
        software="0.1.0",
        **changes,
    )


def make_level(name, ratio=0.0):
    return NodeLevel(
        name=name,
        signal_db=-40.0,
        noise_db=-90.0,
        total_db=-90.0 + ratio,
        nonlinear_db=None if ratio <= 0 else -90.0 + 10 * np.log10(10 ** (ratio / 10) - 1),
        total_to_noise_db=ratio,
        classical_noise_db=-89.0,
        classical_total_db=-60.0 + ratio,
        classical_total_to_noise_db=29.0 + ratio,
        p_value=0.5 if ratio <= 0 else 1e-9,
    )


def make_spectra(rig, rng):
    powers = rng.exponential(1e-9, (7, len(rig.lines), rig.n))
    powers[:, 0, 0] = np.nan  # a quantity that is not available
    powers[3, -1, -1] = 0.0
    probabilities = rng.random((3, len(rig.lines), rig.n))
    return Spectra(rig.frequencies, *powers, *probabilities)


def make_estimate(run, realisation, scope=Scope.WINDOW, ratio=0.0, rng=None, elements=()):
    """The estimate after a realisation; the last node has the given ratio."""
    rig = run.rig
    ratios = [0.0] * (rig.n - 1) + [ratio]
    count = realisation + 1 if scope is Scope.RUN else min(realisation + 1, run.window)
    return Estimate(
        scope=scope,
        time=START + (realisation + 1) * SECOND,
        realisation=realisation,
        realisations=count,
        experiments=count * rig.q,
        periods=run.steady_periods,
        nodes=tuple(make_level(node.name, r) for node, r in zip(rig.nodes, ratios, strict=True)),
        spectra=make_spectra(rig, rng or np.random.default_rng(realisation)),
        located=rig.square,
        elements=elements,
    )


GROUND = ElementShare(("3", "ground"), share=0.98, confidence=0.999, separable=True)


def make_alarm(run, node="3", number=0, since=START, event="raised", **changes):
    facts = {
        "raised": (AlarmState.UNACKNOWLEDGED, True),
        "cleared": (AlarmState.RETURNED_UNACKNOWLEDGED, False),
    }
    state, active = facts[event]
    values = {
        "id": f"{run.id}/{node}/{number}",
        "rig": run.rig.name,
        "node": node,
        "class_": "process",
        "severity": "alarm",
        "event": event,
        "state": state,
        "active": active,
        "acknowledged": False,
        "shelved": False,
        "since": since,
        "time": since if event == "raised" else since + SECOND,
        "level_db": 11.25,
    }
    return AlarmChange(**{**values, **changes})


def make_frame(run, realisation, experiment=0, period=1, status=FrameStatus.ACCEPTED):
    rig = run.rig
    u, y = np.zeros((rig.q, rig.period_samples)), np.zeros((rig.n, rig.period_samples))
    return Frame(realisation, experiment, period, START + realisation * SECOND, u, y, status)


def make_fault(kind=FaultKind.LOST, number=0):
    return Fault(kind, START + number, f"period {number} never came", 0, 0, number)


def feed(sink, run, realisations, first=0, ratio=0.0):
    """Whole realisations as the worker hands them over: frames, then both estimates."""
    for m in range(first, first + realisations):
        for c in range(run.rig.q):
            sink.take(make_frame(run, m, c, 0, FrameStatus.TRANSIENT))
            for p in range(run.steady_periods):
                sink.take(make_frame(run, m, c, p + 1))
        for scope in (Scope.WINDOW, Scope.RUN):
            sink.take(make_estimate(run, m, scope, ratio, elements=(GROUND,) if ratio else ()))


def opened(store, run, **options):
    sink = StoreSink(store, **options)
    sink.open(run)
    return sink


BEAM = make_run("beam-1")


def fill_beam(store):
    """Two rigs: the beam, measured, with an alarm, a fault, a recording and a baseline; and a bench just begun."""
    sink = opened(store, BEAM)
    feed(sink, BEAM, 6)
    feed(sink, BEAM, 2, first=6, ratio=12.0)
    sink.take(make_alarm(BEAM, since=START + 8 * SECOND))
    sink.take(make_fault())
    sink.tick(1.0)
    learnt = Baseline("3", 0.02, 1e-9, Trend(25, 6.1, 4.0), realisations=100, complete=True, since=START)
    sink.save(replace(Monitor(BEAM).memory, time=START + 8 * SECOND, baselines=(learnt,)))
    put_recording(
        store, RecordingEntry("beam-1-000", "beam", "beam-1", "var/beam.mcap", START, None, "writing", 4096)
    )
    opened(store, make_run("bench-1", "bench"))
