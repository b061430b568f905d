"""A small run to record: every kind of record, in the order in which a monitor hands them to its sinks."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from creak.records import (
    AlarmChange,
    AlarmState,
    Counts,
    ElementShare,
    Estimate,
    Excitation,
    Fault,
    FaultKind,
    Frame,
    FrameStatus,
    Node,
    NodeLevel,
    Rig,
    Run,
    RunEnd,
    RunStatus,
    Scope,
    Spectra,
)
from creak.sinks.recorder import Recorder

START = 1_767_225_600_000_000_000  # 2026-01-01
END = RunEnd(START + 10**12, RunStatus.INTERRUPTED, Counts(24, 1, 12, 6, 12, {"lost": 1}), "stopped by the user")
Taken = Frame | Fault | Estimate | AlarmChange


def rig(samples: int = 64) -> Rig:
    return Rig(
        name="bench",
        sample_rate=samples / 0.2,  # a period takes 0.2 s
        period_samples=samples,
        transient_periods=1,
        lines=(3, 4, 5),
        nodes=(Node("left", "m", "N"), Node("right side", "m", "N")),
        network=(("left", "right side"),),
    )


def run(samples: int = 64) -> Run:
    return Run("bench-1", rig(samples), 2, START, Excitation("multisine", 50.0, 1), "simulated", software="0.1.0")


def records(realisations: int = 6, samples: int = 64) -> Iterator[Taken]:
    """Yield realisations of 6 frames, a refused frame, faults of both origins, estimates and an alarm."""
    rng = np.random.default_rng(5)
    period = 200_000_000
    for m in range(realisations):
        for experiment in range(2):
            for p in range(3):
                time = START + ((m * 2 + experiment) * 3 + p) * period
                status = FrameStatus.TRANSIENT if p == 0 else FrameStatus.ACCEPTED
                yield Frame(
                    m, experiment, p, time, rng.normal(size=(2, samples)), rng.normal(size=(2, samples)), status
                )
        if m == 1:
            bad = np.full((1, 7), np.nan)
            yield Frame(10**9, 0, 0, time, bad, bad, FrameStatus.REJECTED, "is none of the run's")
            yield Fault(FaultKind.OUT_OF_PLAN, time, "is none of the run's", 10**9, 0, 0)
            yield Fault(FaultKind.LOST, time, "2 samples never came")
        yield _estimate(Scope.WINDOW, m, time + period, rng)
        yield _estimate(Scope.RUN, m, time + period, rng)
        if m == 2:
            since = time + period
            unacknowledged = AlarmState.UNACKNOWLEDGED
            yield AlarmChange(
                "a1",
                "bench",
                "left",
                "process",
                "alarm",
                "raised",
                unacknowledged,
                True,
                False,
                False,
                since,
                since,
                9.5,
            )


def _estimate(scope: Scope, m: int, time: int, rng: np.random.Generator) -> Estimate:
    nodes = tuple(
        NodeLevel(name, -40.5, -90.25, None, None, rng.normal(), None, None, rng.normal(), rng.random())
        for name in ("left", "right side")
    )
    spectra = Spectra(np.array([15.0, 20.0, 25.0]), *(rng.normal(size=(3, 2)) for _ in range(7)))
    elements = (ElementShare(("right side", "ground"), 0.9, 0.99, True),)
    return Estimate(scope, time, m, m + 1, 2 * m + 2, 2, nodes, spectra, True, elements, ("no p-values",))


def write(target: Path, taken: Iterable[Taken], every: int = 3, **limits: Any) -> Recorder:
    """Record and close; a tick that flushes comes after so many records."""
    recorder = Recorder(target, **limits)
    recorder.open(run())
    for index, record in enumerate(taken, start=1):
        recorder.take(record)
        if index % every == 0:
            recorder.tick(float(index))
    recorder.close(END)
    return recorder


def exact(value: Any) -> Any:
    """Form in which two values are equal only if they are of one type and every bit of their floats agrees."""
    if dataclasses.is_dataclass(value):
        return type(value), [exact(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, np.ndarray):
        return value.dtype, value.shape, value.tobytes()
    if isinstance(value, float):
        return "nan" if math.isnan(value) else value.hex()
    if isinstance(value, list | tuple):
        return [exact(item) for item in value]
    return type(value), value
