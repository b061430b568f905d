"""All that crosses a border inside creak, frozen, with the symbols and the axis order that the whole code uses.

Symbols (those of the paper and of the field)::

    n   nodes (measured points)         q   inputs (driven nodes), q <= n
    N   samples a period                F   excited lines
    M   realisations                    E   experiments, E = M q
    P   steady-state periods of an experiment
    u   inputs, time domain             U   inputs, DFT divided by N
    y   responses, time domain          Y   responses, DFT divided by N
    S   BLA from inputs to nodes        G   BLA from node to node

Axis order: repetitions first, then frequency, then matrix; time runs last. A realisation's spectra are
``(q, P, F, q + n)``, the matrix ``S`` is ``(F, n, q)``, a period frame holds ``u (q, N)`` and ``y (n, N)``.

Times are integer nanoseconds since the Unix epoch and are the *recorded* time: that of the samples, not of the
process that handles them. Levels are dB re 1 unit squared of the node's output, ``10 log10`` of a power.
Realisations, experiments and periods are counted from 0, the transient periods included.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from creak.alarm_records import AlarmChange as AlarmChange  # noqa: PLC0414 - handed on, with the two below
from creak.alarm_records import AlarmRules, BaselineRules
from creak.alarm_records import AlarmState as AlarmState  # noqa: PLC0414
from creak.alarm_records import Limits as Limits  # noqa: PLC0414
from creak.findings import DetectionLevel
from creak.findings import FaultKind as FaultKind  # noqa: PLC0414 - a record, though it stands one module below
from creak.rig_records import Grid as Grid  # noqa: PLC0414
from creak.rig_records import Hold as Hold  # noqa: PLC0414
from creak.rig_records import Node as Node  # noqa: PLC0414
from creak.rig_records import Rig as Rig  # noqa: PLC0414

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Excitation:
    """How the inputs were made.

    Parameters
    ----------
    kind : str
        ``multisine`` (random phases, orthogonal experiments) or ``measured`` (as the measurement has it).
    rms : float or None
        RMS value of every input in its unit; None if not known.
    seed : int or None
        Seed of the random phases; None if not known.
    """

    kind: Literal["multisine", "measured"]
    rms: float | None = None
    seed: int | None = None


@dataclass(frozen=True)
class Run:
    """Opens a run: all that is known before the first frame.

    Parameters
    ----------
    id : str
        Unique and immutable.
    rig : Rig
    steady_periods : int
        P, periods of every experiment that count after the transient ones.
    start : int
        Recorded time of the first sample, ns since the Unix epoch.
    excitation : Excitation
    source : str
        Kind of the source: ``simulated``, ``measurement``, ``recording``, ``can``, ``stream``.
    window : int
        R, complete realisations over which live levels are taken.
    limits : Limits
    software : str
        Version of creak.
    alarms : AlarmRules
    baseline : BaselineRules
    before : bytes
        What the monitor knew when the run began (:func:`creak.codec.memory_bytes`), so that a replay of a run
        after a restart begins where it began; empty for nothing.
    """

    id: str
    rig: Rig
    steady_periods: int
    start: int
    excitation: Excitation
    source: str
    window: int = 4
    limits: Limits = field(default_factory=Limits)
    software: str = ""
    alarms: AlarmRules = field(default_factory=AlarmRules)
    baseline: BaselineRules = field(default_factory=BaselineRules)
    before: bytes = b""

    @property
    def periods(self) -> int:
        """Periods of an experiment, the transient ones included."""
        return self.rig.transient_periods + self.steady_periods


class FrameStatus(StrEnum):
    """What became of a period frame."""

    ACCEPTED = "accepted"
    TRANSIENT = "transient"
    REJECTED = "rejected"


@dataclass(frozen=True, eq=False)
class Frame:
    """One period of all channels.

    Parameters
    ----------
    realisation, experiment, period : int
        Where it belongs; the period counts the transient ones.
    time : int
        Recorded time of its first sample, ns since the Unix epoch.
    u : array, (q, N)
        Inputs, in their units.
    y : array, (n, N)
        Responses, in their units.
    status : FrameStatus
        As the monitor judged it; a source leaves it ``accepted``.
    reason : str
        Why it was rejected.
    """

    realisation: int
    experiment: int
    period: int
    time: int
    u: Real
    y: Real
    status: FrameStatus = FrameStatus.ACCEPTED
    reason: str = ""


@dataclass(frozen=True)
class Fault:
    """Data that were refused or never came, counted and named.

    Parameters
    ----------
    kind : FaultKind
    time : int
        Recorded time, ns since the Unix epoch.
    message : str
        One line for a person.
    realisation, experiment, period : int or None
        What it touches, as far as it is known.
    """

    kind: FaultKind
    time: int
    message: str
    realisation: int | None = None
    experiment: int | None = None
    period: int | None = None


@dataclass(frozen=True)
class NodeLevel:
    """Levels of one node over the excited lines; None where the data do not carry the quantity.

    Parameters
    ----------
    name : str
    signal_db : float or None
        Mean over experiments and periods of the summed ``|Y|^2``; None if the channel is dead.
    noise_db, total_db, nonlinear_db : float or None
        Summed variances (40), (39), (41) of the networked residuals.
    total_to_noise_db : float or None
        Their ratio, networked.
    classical_noise_db, classical_total_db : float or None
        The same of the residuals from the inputs.
    classical_total_to_noise_db : float or None
    p_value : float or None
        Probability, if the structure is linear, of a pooled node statistic at least this large.
    """

    name: str
    signal_db: float | None = None
    noise_db: float | None = None
    total_db: float | None = None
    nonlinear_db: float | None = None
    total_to_noise_db: float | None = None
    classical_noise_db: float | None = None
    classical_total_db: float | None = None
    classical_total_to_noise_db: float | None = None
    p_value: float | None = None


@dataclass(frozen=True, eq=False)
class Spectra:
    """Power per excited line and node, unit squared; each ``(F, n)``, NaN where a quantity is not available.

    Parameters
    ----------
    frequency : array, (F,)
        Hz.
    signal, noise, total, nonlinear : array, (F, n)
        ``|Y|^2`` and the variances (40), (39), (41) of the networked residuals.
    classical_noise, classical_total, classical_nonlinear : array, (F, n)
        The same of the residuals from the inputs.
    p_value, q_value, classical_p_value : array, (F, n), or None
        Probability of so large a residual if the structure is linear, networked; the smallest rate of false
        discoveries over all lines and nodes at which it is still significant; and the probability of the
        residual from the inputs. None in recordings of before these were kept.
    """

    frequency: Real
    signal: Real
    noise: Real
    total: Real
    nonlinear: Real
    classical_noise: Real
    classical_total: Real
    classical_nonlinear: Real
    p_value: Real | None = None
    q_value: Real | None = None
    classical_p_value: Real | None = None


@dataclass(frozen=True)
class ElementShare:
    """A place where distortion acts: between two nodes, or between a node and ``ground``."""

    between: tuple[str, str]
    share: float
    confidence: float
    separable: bool


class Scope(StrEnum):
    """Over what an estimate is taken."""

    WINDOW = "window"  # the last R complete realisations
    RUN = "run"  # all complete realisations of the run


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the data say at one moment.

    Parameters
    ----------
    scope : Scope
    time : int
        Recorded time at the end of its last period, ns since the Unix epoch.
    realisation : int
        Index of the last realisation in it.
    realisations, experiments, periods : int
        M, E and P behind it.
    nodes : tuple of NodeLevel
    spectra : Spectra
    located : bool
        True if the networked levels exist.
    elements : tuple of ElementShare
    unavailable : tuple of str
        What the data do not carry, and why, a sentence each.
    detection : tuple of DetectionLevel
        Distortion at the lines left out, a node each; empty where the grid leaves none.
    remarks : tuple of str
        What else the data say about their own use, a sentence each.
    """

    scope: Scope
    time: int
    realisation: int
    realisations: int
    experiments: int
    periods: int
    nodes: tuple[NodeLevel, ...]
    spectra: Spectra
    located: bool
    elements: tuple[ElementShare, ...] = ()
    unavailable: tuple[str, ...] = ()
    detection: tuple[DetectionLevel, ...] = ()
    remarks: tuple[str, ...] = ()


class RunStatus(StrEnum):
    """How a run ended."""

    COMPLETED = "completed"
    INTERRUPTED = "interrupted"
    FAILED = "failed"


@dataclass(frozen=True)
class Counts:
    """What a run has handled so far.

    Parameters
    ----------
    frames : int
        Accepted steady frames of complete realisations.
    rejected_frames : int
        All other frames but the transient ones: refused ones, and good ones of realisations that did not
        become complete.
    transient_frames : int
    realisations, experiments : int
        Complete ones.
    faults : mapping of str to int
        By kind.
    """

    frames: int = 0
    rejected_frames: int = 0
    transient_frames: int = 0
    realisations: int = 0
    experiments: int = 0
    faults: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class RunEnd:
    """Closes a run: how it ended, and what it counted."""

    time: int
    status: RunStatus
    counts: Counts
    message: str = ""


Record = Run | Frame | Fault | Estimate | AlarmChange | RunEnd
"""What sources yield, the monitor adds and sinks take."""
