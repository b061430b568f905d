"""Records of alarms: limits and rules, what operators ask for, and what changed. All times are recorded times.

They lie below :mod:`creak.records`, which hands the ones of a run on.
"""

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

AlarmClass = Literal["process", "quality"]
Severity = Literal["warning", "alarm"]


@dataclass(frozen=True)
class Limits:
    """When a node alarms: clearance and significance together, K of the last N windows.

    Parameters
    ----------
    total_to_noise_db : float
        A window exceeds if its networked total-to-noise ratio lies above this, dB. At 3 dB the nonlinear
        distortion is as strong as the noise.
    p_value : float
        ... and its pooled p-value lies below this.
    dead_band_db : float
        An alarm clears when the ratio has fallen this far below the limit, dB.
    windows : int
        N, windows looked back on.
    exceeding : int
        K, windows among them that must exceed to raise, or must lie below the dead band to clear.
    warning_db : float or None
        A lower ratio that raises a warning, dB; None for no warnings.
    false_alarms_per_year : float or None
        At most so many false alarms of the rig a year of recorded time; takes the place of `p_value`, which then
        follows from the rig's pace (:func:`creak.limits.p_threshold`). None for `p_value` as it is.
    """

    total_to_noise_db: float = 3.0
    p_value: float = 1e-3
    dead_band_db: float = 1.0
    windows: int = 3
    exceeding: int = 2
    warning_db: float | None = None
    false_alarms_per_year: float | None = None


@dataclass(frozen=True)
class AlarmRules:
    """How alarms live: delays, shelving, and when data are poor. Seconds of recorded time.

    Parameters
    ----------
    on_delay_s, off_delay_s : float
        How long a condition must stand before it is raised, and must be gone before it is cleared.
    realarm_s : float or None
        An acknowledged alarm that still stands is unacknowledged again after this time; None for never.
    shelving_max_s : float
        Longest time for which an alarm can be shelved.
    silence_s : float or None
        Silence that is a quality alarm; None for ten periods, at least 10 s.
    stale_realisations : float
        An estimate that is older than this many realisations take is stale.
    """

    on_delay_s: float = 0.0
    off_delay_s: float = 0.0
    realarm_s: float | None = None
    shelving_max_s: float = 86_400.0
    silence_s: float | None = None
    stale_realisations: float = 4.0


@dataclass(frozen=True)
class BaselineRules:
    """How a node's own baseline is learnt and what departs from it.

    Parameters
    ----------
    realisations : int
        Healthy realisations from which a baseline is learnt; 0 for no baselines.
    change_db : float
        A window exceeds if the nonlinear level (:func:`creak.baseline.level_db`) lies this far above the baseline
        and that is significant.
    state_tolerance_db : float
        Excitations within this of each other are one operating state.
    trend_false_alarms_per_year : float or None
        At most so many false warnings of slow growth of the rig a year; None for no trend test.
    """

    realisations: int = 0
    change_db: float = 3.0
    state_tolerance_db: float = 1.0
    trend_false_alarms_per_year: float | None = 1.0


class Verdict(StrEnum):
    """Where one window of one node lies with respect to one limit."""

    EXCEEDS = "exceeds"
    BETWEEN = "between"  # in the dead band
    BELOW = "below"


class AlarmState(StrEnum):
    """State names of ISA-18.2."""

    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    RETURNED_UNACKNOWLEDGED = "returned_unacknowledged"
    SHELVED = "shelved"
    SUPPRESSED = "suppressed"
    OUT_OF_SERVICE = "out_of_service"


class ActionKind(StrEnum):
    """What an operator can do to an alarm."""

    ACKNOWLEDGE = "acknowledge"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    SUPPRESS = "suppress"
    UNSUPPRESS = "unsuppress"
    RETIRE = "retire"  # out of service
    REINSTATE = "reinstate"
    RELEARN = "relearn"  # the machine was changed on purpose: learn a new baseline of the node


@dataclass(frozen=True)
class Action:
    """What an operator asks for.

    Parameters
    ----------
    alarm : str
        Id of the occurrence; with a `node`, the one to begin if none stands, or empty.
    kind : ActionKind
    by : str
        Who.
    comment : str
        Why.
    until : int or None
        End of a shelving, ns since the Unix epoch; None for anything else.
    version : int or None
        Version of the alarm that the operator has seen; None if any will do.
    node : str
        Of whose process alarm this is asked, whether it ever alarmed or not; empty for an occurrence.
    """

    alarm: str
    kind: ActionKind
    by: str
    comment: str = ""
    until: int | None = None
    version: int | None = None
    node: str = ""


@dataclass(frozen=True)
class Conflict:
    """Why an action was not carried out; nothing has changed.

    Parameters
    ----------
    kind : str
        ``stale``: the alarm is no longer what the operator saw. ``not_allowed``: the rules forbid it.
    reason : str
        A sentence for the operator.
    """

    kind: Literal["stale", "not_allowed"]
    reason: str


@dataclass(frozen=True)
class Clock:
    """Recorded time has come to `time` although no frame says so: what falls due until then happens."""

    time: int


@dataclass(frozen=True)
class AlarmChange:
    """One change of one alarm occurrence; the newest change of an id is the alarm as it stands.

    Parameters
    ----------
    id : str
        Of the occurrence: constant over its changes, and the same in a replay.
    rig, node : str
        An empty node stands for the whole rig.
    class_ : str
        ``process`` or ``quality``.
    severity : str
        ``warning`` or ``alarm``: the highest since the occurrence was last acknowledged.
    event : str
        ``raised``, ``cleared`` and so on.
    state : AlarmState
    active, acknowledged, shelved : bool
    since : int
        Recorded time at which the occurrence was raised, or else began, ns since the Unix epoch.
    time : int
        Recorded time of this change.
    level_db : float
        The node's networked total-to-noise ratio in the window that caused the change, dB; NaN if there is none.
    version : int
        Counts the changes of the occurrence, from 1.
    condition : str
        What stands, in words joined by ``+``: ``level``, ``baseline``, ``trend``; or the quality condition.
    by, comment : str
        Who changed it and why; empty where no person did.
    shelved_until : int or None
        Recorded time at which the shelving ends.
    suppressed, out_of_service, latched : bool
        Latched: something that has gone, the alarm or its higher severity, is kept until it is acknowledged.
    guidance : str
        What to do about it.
    never_raised : bool
        No alarm yet, only what an operator did with that of the node.
    """

    id: str
    rig: str
    node: str
    class_: AlarmClass
    severity: Severity
    event: str
    state: AlarmState
    active: bool
    acknowledged: bool
    shelved: bool
    since: int
    time: int
    level_db: float
    version: int = 0
    condition: str = ""
    by: str = ""
    comment: str = ""
    shelved_until: int | None = None
    suppressed: bool = False
    out_of_service: bool = False
    latched: bool = False
    guidance: str = ""
    never_raised: bool = False
