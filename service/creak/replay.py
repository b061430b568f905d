"""Recordings put through the pipeline again, each as when it was live, and several of one rig summed.

A recording is one task: its frames go in order through a monitor of its own, so its alarms are those of the live
run. What recordings have in common are their sums: they merge, and one estimate over all is made of them.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any, Literal

from creak.codec import summary_json, time_json
from creak.errors import RecordingError
from creak.judgement import Block, judged
from creak.quality import FLAWS
from creak.records import AlarmState, Counts, Estimate, Fault, FaultKind, Run, RunEnd, RunStatus, Scope
from creak.sinks.protocol import Sink
from creak.sources.recording import Recording
from creak.sources.settled import SettledSource
from creak.worker import drive

Method = Literal["plain", "lpm"]


class Newest:
    """Sink that keeps the newest estimate of the whole run and counts the windows that can be judged."""

    def __init__(self) -> None:
        self.estimate: Estimate | None = None
        self.windows = 0
        self.flaws: dict[FaultKind, list[Fault]] = {}

    def open(self, run: Run) -> None:
        """Nothing is to be prepared."""

    def take(self, record: object) -> None:
        """Keep what counts."""
        if isinstance(record, Fault) and record.kind in FLAWS:
            self.flaws.setdefault(record.kind, []).append(record)
        elif isinstance(record, Estimate):
            if record.scope is Scope.RUN:
                self.estimate = record
            elif record.nodes[0].p_value is not None:
                self.windows += 1

    @property
    def quality(self) -> list[dict[str, Any]]:
        """What is wrong with the data, a kind each: its first finding, and how many realisations have one."""
        return [
            {"kind": kind.value, "message": found[0].message, "realisations": len({f.realisation for f in found})}
            for kind, found in self.flaws.items()
        ]

    def tick(self, now: float) -> None:
        """Nothing is due."""

    def close(self, end: RunEnd) -> None:
        """Nothing is to be closed."""


@dataclass(frozen=True, eq=False)
class Told:
    """One recording as it was replayed, but for its sums.

    Parameters
    ----------
    files : tuple of str
        Names of its parts.
    run : Run
        As the monitor took it.
    index, end : int
        Of the last complete realisation: index, and recorded end in ns since the Unix epoch; -1 and the run's
        start if there is none.
    counts : Counts
    alarms : mapping of str to AlarmState
        State of every node at its end.
    windows : int
        Windows that could be judged.
    truncated : bool
    damage : tuple of str
    quality : list of dict
        As `Newest.quality`.
    """

    files: tuple[str, ...]
    run: Run
    index: int
    end: int
    counts: Counts
    alarms: Mapping[str, AlarmState]
    windows: int
    truncated: bool
    damage: tuple[str, ...]
    quality: list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Replayed:
    """Recordings that were replayed; they add, in the order in which they are told.

    Parameters
    ----------
    recordings : tuple of Told
    block : Block or None
        Sums of all their complete realisations; None if there is none.
    """

    recordings: tuple[Told, ...]
    block: Block | None

    def __add__(self, other: "Replayed") -> "Replayed":
        """Both, the recordings of `other` behind."""
        blocks = [block for block in (self.block, other.block) if block is not None]
        return Replayed(self.recordings + other.recordings, reduce(add, blocks) if blocks else None)


def in_order(recordings: Sequence[Recording]) -> list[Recording]:
    """Sort recordings that are to be summed by start, and refuse those that are not of one rig.

    Raises
    ------
    RecordingError
        The file and what is different.
    """
    ordered = sorted(recordings, key=lambda recording: (recording.run.start, recording.run.id))
    first = ordered[0]
    for other in ordered[1:]:
        one, two = first.run.rig, other.run.rig
        unlike = [field.name for field in fields(one) if getattr(one, field.name) != getattr(two, field.name)]
        unlike += ["steady_periods"] if first.run.steady_periods != other.run.steady_periods else []
        if unlike:
            raise RecordingError(
                f"{other.paths[0]}: is of another run than {first.paths[0]} and differs in {', '.join(unlike)}; "
                "recordings that are summed must be of one rig"
            )
    return ordered


def replayed(
    paths: tuple[Path, ...], method: Method = "plain", sinks: Sequence[Sink] = (), *, ahead: bool = True
) -> Replayed:
    """Replay the parts of one recording.

    Parameters
    ----------
    paths : tuple of Path
    method : str
        ``plain`` drops transient periods; ``lpm`` keeps all, and estimates the transient.
    sinks : sequence of Sink
        What else is to be fed.
    ahead : bool
        As for `worker.drive`; a task that is one of many on a machine keeps to one core.

    Raises
    ------
    CreakError
        What the recording raised.
    KeyboardInterrupt
        The user has had enough.
    """
    recording = Recording(*paths)
    source = SettledSource(recording) if method == "lpm" else recording
    newest = Newest()
    monitor, end = drive(source, [newest, *sinks], ahead=ahead)
    if end.status is RunStatus.INTERRUPTED:
        raise KeyboardInterrupt
    last = newest.estimate
    told = Told(
        files=tuple(path.name for path in recording.paths),
        run=monitor.run,
        index=-1 if last is None else last.realisation,
        end=monitor.run.start if last is None else last.time,
        counts=monitor.counts,
        alarms=dict(monitor.alarms),
        windows=newest.windows,
        truncated=recording.truncated,
        damage=recording.losses,
        quality=newest.quality,
    )
    return Replayed((told,), monitor.checkpoint.whole)


def summary(replayed: Replayed, method: Method = "plain") -> dict[str, Any]:
    """Sum up what was replayed: the document of ``creak replay --json``.

    Levels are those of all recordings together; the alarms are those at the end of the last one.
    """
    last = replayed.recordings[-1]
    rig, limits = last.run.rig, last.run.limits
    estimate = None if replayed.block is None else judged(rig, replayed.block, Scope.RUN, last)
    unavailable = []
    if estimate is None:
        unavailable.append("no realisation is complete")
    elif 0 < last.windows < limits.exceeding:
        unavailable.append(
            f"alarms need {limits.exceeding} of the last {limits.windows} windows above the limits; "
            f"the recording has {last.windows}"
        )
    document = summary_json(
        rig.name,
        _counted([told.counts for told in replayed.recordings]),
        estimate,
        last.alarms,
        any(told.truncated for told in replayed.recordings),
        unavailable=unavailable,
    )
    document["quality"] = _quality(replayed.recordings)
    document["method"] = method
    document["recordings"] = [_told_json(told) for told in replayed.recordings]
    return document


def _counted(each: Sequence[Counts]) -> Counts:
    faults: Counter[str] = Counter()
    for counts in each:
        faults.update(counts.faults)
    return Counts(
        frames=sum(counts.frames for counts in each),
        rejected_frames=sum(counts.rejected_frames for counts in each),
        transient_frames=sum(counts.transient_frames for counts in each),
        realisations=sum(counts.realisations for counts in each),
        experiments=sum(counts.experiments for counts in each),
        faults=dict(sorted(faults.items())),
    )


def _quality(recordings: Sequence[Told]) -> list[dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for flaw in (flaw for told in recordings for flaw in told.quality):
        known = found.setdefault(flaw["kind"], flaw | {"realisations": 0})
        known["realisations"] += flaw["realisations"]
    return list(found.values())


def _told_json(told: Told) -> dict[str, Any]:
    return {
        "run": told.run.id,
        "files": list(told.files),
        "start": time_json(told.run.start),
        "frames": told.counts.frames,
        "rejected_frames": told.counts.rejected_frames,
        "realisations": told.counts.realisations,
        "truncated": told.truncated,
        "alarms": {name: state.value for name, state in told.alarms.items()},
    }
