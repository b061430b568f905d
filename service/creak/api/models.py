"""Bodies of the API's answers, and an example of each; the examples are the documentation's."""

from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from creak.records import AlarmState, Scope

Decibels = float | None


class Answer(BaseModel):
    """Root of all bodies."""

    model_config = ConfigDict(extra="forbid", use_enum_values=True)
    example: ClassVar[Any] = None


class RigSummary(Answer):
    """A rig and the run that goes on, or that ended last."""

    name: str
    run: str = Field(description="Id of the run.")
    status: Literal["running", "completed", "interrupted", "failed"]
    message: str = Field(description="Why the run failed or was interrupted.")
    source: str = Field(description="Kind of the source.")
    software: str = Field(description="Version of creak that measures.")
    start: str = Field(description="Recorded time of the first sample, ISO 8601.")
    last: str | None = Field(description="Newest recorded time.")
    end: str | None = Field(description="Recorded time of the end of the run.")
    heard_at: str | None = Field(description="Wall-clock time of the newest frame.")
    nodes: list[str] = Field(description="Names of the nodes, in order.")
    frames: int = Field(description="Accepted steady frames of complete realisations.")
    rejected_frames: int = Field(description="All other frames but the transient ones.")
    transient_frames: int
    realisations: int
    experiments: int
    faults: dict[str, int] = Field(description="Faults by kind.")
    alarms: dict[str, str] = Field(description="Alarm states of the nodes that are not normal.")


class Fault(Answer):
    """Data that were refused or never came."""

    kind: str
    time: str
    message: str
    realisation: int | None
    experiment: int | None
    period: int | None


class Flaw(Answer):
    """What is wrong with frames that are whole and finite; they count all the same."""

    kind: str
    message: str = Field(description="The newest finding; empty if it is no longer kept.")
    findings: int = Field(description="How many there were: at most one a realisation, or a channel of it.")


class RigDetail(RigSummary):
    """All that is known of a rig."""

    configuration: str = Field(description="The rig file, TOML.")
    excitation: dict[str, Any]
    limits: dict[str, Any] = Field(description="When a node alarms.")
    sample_rate: float = Field(description="Hz.")
    period_samples: int
    steady_periods: int
    window: int = Field(description="Realisations over which the levels of scope `window` are taken.")
    lines: int = Field(description="Number of excited lines.")
    recent_faults: list[Fault] = Field(description="The newest faults, newest first.")
    quality: list[Flaw] = Field(description="Flaws of the data, by kind.")


class Levels(Answer):
    """Levels of a node, dB re 1 unit squared; null where the data do not carry the quantity."""

    name: str
    signal_db: Decibels
    noise_db: Decibels
    total_db: Decibels
    nonlinear_db: Decibels
    total_to_noise_db: Decibels
    classical_total_to_noise_db: Decibels
    p_value: float | None = Field(description="Probability of such a statistic if the structure is linear.")
    classical_noise_db: Decibels
    classical_total_db: Decibels


class Detection(Answer):
    """Mean power of a line, dB re 1 unit squared, noise taken off: excited, and odd and even ones left out."""

    excited_db: Decibels
    odd_db: Decibels
    even_db: Decibels
    noise_db: Decibels


class Node(Levels):
    """A node as it stands."""

    alarm: AlarmState
    rig: str
    scope: Scope
    time: str | None = Field(description="Recorded time of the estimate; null before there is one.")
    realisations: int = Field(description="Realisations behind the levels.")
    input: str | None = Field(description="Unit of the input; null where the node is not driven.")
    output: str = Field(description="Unit of the response.")
    detection: Detection | None = Field(description="Null where the grid leaves no lines to tell odd from even.")


class Moment(Levels):
    """Levels that a node had."""

    run: str
    scope: Scope
    realisation: int = Field(description="Index of the last realisation in it.")
    time: str


class Band(BaseModel):
    """Lines of a node's spectrum taken together."""

    from_hz: float
    to_hz: float
    lines: int
    p_value: float | None
    classical_p_value: float | None


class Spectrum(Answer):
    """Power per excited line, dB re 1 unit squared; null where it is zero or not known."""

    rig: str
    name: str
    scope: Scope
    time: str
    realisations: int
    frequency_hz: list[float]
    signal_db: list[Decibels]
    noise_db: list[Decibels]
    total_db: list[Decibels]
    nonlinear_db: list[Decibels]
    classical_noise_db: list[Decibels]
    classical_total_db: list[Decibels]
    classical_nonlinear_db: list[Decibels]
    p_value: list[float | None] = Field(description="Of each line, uniform on [0, 1] if the structure is linear.")
    q_value: list[float | None] = Field(description="As a rate of false discoveries over lines and nodes.")
    classical_p_value: list[float | None]
    false_discovery_rate: float
    significant: list[bool | None] = Field(description="True where `q_value` is at most `false_discovery_rate`.")
    bands: list[Band] = Field(description="All lines, then octaves.")


class Element(Answer):
    """A place where distortion acts."""

    between: list[str] = Field(description="Two nodes, or a node and `ground`.")
    share: float | None = Field(description="Fraction of the non-coherent force power.")
    confidence: float | None
    separable: bool


class Alarm(Answer):
    """An alarm occurrence as it stands, or as a change left it."""

    id: str
    rig: str
    node: str
    class_: Literal["process", "quality"] = Field(alias="class")
    severity: Literal["warning", "alarm"]
    state: AlarmState
    active: bool
    acknowledged: bool
    shelved: bool
    since: str = Field(description="Recorded time at which it was raised.")
    level_db: Decibels = Field(description="Networked total-to-noise ratio of the change.")
    event: str = Field(description="What the change was.")
    time: str = Field(description="Recorded time of the change.")
    version: int = Field(description="Counts the changes of the occurrence, from 1.")
    condition: str = Field(description="What stands, joined by `+`.")
    by: str = Field(description="Who changed it; empty where no person did.")
    comment: str = Field(description="Why.")
    shelved_until: str | None = Field(description="Recorded time at which the shelving ends.")
    suppressed: bool
    out_of_service: bool
    latched: bool = Field(description="What has gone is kept until it is acknowledged.")
    guidance: str = Field(description="What to do about it.")


class AlarmDetail(Alarm):
    """An alarm with its journal."""

    changes: list[Alarm] = Field(description="Every change, oldest first.")


class Recording(Answer):
    """A recording."""

    id: str
    rig: str
    run: str
    path: str
    status: str
    size: int = Field(description="Bytes.")
    start: str
    end: str | None


class Page(Answer):
    """Part of a list."""

    next: str | None = Field(description="Cursor of the page that follows; null on the last one.")


class RigPage(Page):
    """Rigs, by name."""

    items: list[RigSummary]


class NodePage(Page):
    """Nodes, in the order of the rig."""

    items: list[Node]


class ElementPage(Page):
    """Elements in falling share; `located` also where there are none, if every node is driven."""

    items: list[Element]
    rig: str
    scope: Scope
    located: bool
    unavailable: list[str] = Field(description="What the data do not carry, and why.")
    remarks: list[str] = Field(description="What else the data say about their own use.")
    time: str | None


class HistoryPage(Page):
    """Levels over time."""

    items: list[Moment]


class AlarmPage(Page):
    """Alarms, newest first."""

    items: list[Alarm]


class RecordingPage(Page):
    """Recordings, newest first."""

    items: list[Recording]


class Health(Answer):
    """The process answers."""

    status: Literal["alive"]
    version: str
    example: ClassVar[Any] = {"status": "alive", "version": "0.1.0"}


class Readiness(Answer):
    """Store and rigs are in order."""

    status: Literal["ready"]
    rigs: list[str] = Field(description="Rigs that are watched.")
    example: ClassVar[Any] = {"status": "ready", "rigs": ["beam"]}


class RefusedParameter(Answer):
    """A parameter that holds what it must not hold."""

    in_: str = Field(alias="in")
    name: str
    problem: str


class Problem(Answer):
    """Problem details of RFC 9457."""

    model_config = ConfigDict(extra="allow")
    type: str
    title: str
    status: int
    detail: str
    instance: str
    errors: list[RefusedParameter] | None = Field(default=None, description="Of a refused parameter.")


_LEVELS = {
    "name": "3",
    "signal_db": -41.2,
    "noise_db": -88.9,
    "total_db": -77.4,
    "nonlinear_db": -77.7,
    "total_to_noise_db": 11.5,
    "classical_total_to_noise_db": 29.8,
    "p_value": 1e-12,
    "classical_noise_db": -88.7,
    "classical_total_db": -58.9,
}
_SUMMARY = {
    "name": "beam",
    "run": "beam-20260501T080000Z",
    "status": "running",
    "message": "",
    "source": "simulated",
    "software": "0.1.0",
    "start": "2026-05-01T08:00:00.000000Z",
    "last": "2026-05-01T08:14:24.000000Z",
    "end": None,
    "heard_at": "2026-05-01T08:14:24.310000Z",
    "nodes": ["1", "2", "3"],
    "frames": 108,
    "rejected_frames": 0,
    "transient_frames": 108,
    "realisations": 12,
    "experiments": 36,
    "faults": {"lost": 1},
    "alarms": {"3": "unacknowledged"},
}
_FAULT = {
    "kind": "lost",
    "time": "2026-05-01T08:02:12.000000Z",
    "message": "period 1 of experiment 0 of realisation 2 never came",
    "realisation": 2,
    "experiment": 0,
    "period": 1,
}
_ALARM = {
    "id": "9f3c1b6e",
    "rig": "beam",
    "node": "3",
    "class": "process",
    "severity": "alarm",
    "state": "unacknowledged",
    "active": True,
    "acknowledged": False,
    "shelved": False,
    "since": "2026-05-01T08:12:00.000000Z",
    "level_db": 11.2,
    "event": "raised",
    "time": "2026-05-01T08:12:00.000000Z",
    "version": 1,
    "condition": "level",
    "by": "",
    "comment": "",
    "shelved_until": None,
    "suppressed": False,
    "out_of_service": False,
    "latched": False,
    "guidance": "Inspect the node for looseness, rubbing, cracks and worn bearings.",
}
_ABOUT = {"rig": "beam", "scope": "window", "time": "2026-05-01T08:14:24.000000Z"}

Node.example = {**_LEVELS, "alarm": "unacknowledged", **_ABOUT, "realisations": 4, "input": "A", "output": "m/s^2"}
Node.example["detection"] = {"excited_db": -74.2, "odd_db": -101.3, "even_db": None, "noise_db": -120.4}
RigPage.example = {"items": [_SUMMARY], "next": None}
RigDetail.example = {
    **_SUMMARY,
    "configuration": 'name = "beam"\n...',
    "excitation": {"kind": "multisine", "rms": 0.02, "seed": 1},
    "limits": {"total_to_noise_db": 3.0, "p_value": 0.001, "dead_band_db": 1.0, "windows": 3, "exceeding": 2},
    "sample_rate": 4096.0,
    "period_samples": 16384,
    "steady_periods": 3,
    "window": 4,
    "lines": 2000,
    "recent_faults": [_FAULT],
    "quality": [{"kind": "stuck", "message": "realisation 3: response 2 does not change ...", "findings": 1}],
}
NodePage.example = {"items": [Node.example], "next": None}
ElementPage.example = {
    "items": [{"between": ["3", "ground"], "share": 0.99, "confidence": 0.999, "separable": True}],
    "next": None,
    **_ABOUT,
    "located": True,
    "unavailable": [],
    "remarks": [],
}
HistoryPage.example = {
    "items": [{**_LEVELS, "run": _SUMMARY["run"], "scope": "window", "realisation": 11, "time": _ABOUT["time"]}],
    "next": "WyJhMWIyYzNkNGU1ZjYiLDQyXQ",
}
Spectrum.example = {
    **_ABOUT,
    "name": "3",
    "realisations": 4,
    "frequency_hz": [0.25, 0.5],
    "signal_db": [-61.3, -58.8],
    "noise_db": [-121.9, -122.2],
    "total_db": [-110.4, -111.0],
    "nonlinear_db": [-110.7, -111.3],
    "classical_noise_db": [-121.7, -122.0],
    "classical_total_db": [-92.1, -91.5],
    "classical_nonlinear_db": [-92.1, None],
    "p_value": [3e-6, 0.4],
    "q_value": [2e-5, 0.7],
    "classical_p_value": [1e-12, 0.2],
    "false_discovery_rate": 0.05,
    "significant": [True, False],
    "bands": [{"from_hz": 0.25, "to_hz": 0.5, "lines": 2, "p_value": 1e-5, "classical_p_value": 1e-11}],
}
Alarm.example = _ALARM
AlarmPage.example = {"items": [_ALARM], "next": None}
AlarmDetail.example = {**_ALARM, "changes": [_ALARM]}
RecordingPage.example = {
    "items": [
        {
            "id": "beam-20260501T080000Z-000",
            "rig": "beam",
            "run": _SUMMARY["run"],
            "path": "var/beam/beam-20260501T080000Z-000.mcap",
            "status": "writing",
            "size": 31457280,
            "start": _SUMMARY["start"],
            "end": None,
        }
    ],
    "next": None,
}
Problem.example = {
    "type": "urn:problem-type:creak:unknown-rig",
    "title": "Unknown rig",
    "status": 404,
    "detail": "there is no rig 'bench'",
    "instance": "/api/v1/rigs/bench",
}
