"""Bodies of the API's answers; the example of each stands in the documentation."""

from typing import Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field

from creak.api import examples
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


Node.example = examples.NODE
RigPage.example = examples.RIG_PAGE
RigDetail.example = examples.RIG_DETAIL
NodePage.example = examples.NODE_PAGE
ElementPage.example = examples.ELEMENT_PAGE
HistoryPage.example = examples.HISTORY_PAGE
Spectrum.example = examples.SPECTRUM
Alarm.example = examples.ALARM
AlarmPage.example = examples.ALARM_PAGE
AlarmDetail.example = examples.ALARM_DETAIL
RecordingPage.example = examples.RECORDING_PAGE
Problem.example = examples.PROBLEM
