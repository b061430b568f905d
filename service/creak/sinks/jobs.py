"""Computations that outlast a request, as the store holds them: asked for by the API, done by a runner.

A job is *queued* until a runner claims it, *running* until its process ends, and then *done*, *failed* or
*cancelled* for good. A runner writes at least every few seconds that it is alive; a job whose runner has fallen
silent has failed. All times are wall-clock nanoseconds.
"""

import json
import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from typing import Any, Literal

import sqlalchemy as sa

from creak.codec import moment_json, time_json
from creak.sinks import tables
from creak.sinks.database import Store
from creak.sinks.queries import Slice

SILENT_SECONDS = 15.0
"""A running job of which nothing was heard for so long has lost its runner."""

_KEPT = 500  # jobs that have ended, with their reports

Json = dict[str, Any]
Kind = Literal["diagnosis", "replay"]


class JobStatus(StrEnum):
    """Where a job stands."""

    QUEUED = "queued"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


@dataclass(frozen=True)
class Task:
    """What is to be computed.

    Parameters
    ----------
    kind : str
        ``diagnosis`` or ``replay``.
    files : tuple of str
        Parts of one recording.
    model : str or None
        Model file; a diagnosis needs one, or a healthy recording.
    validate : str or None
        Recording at another amplitude.
    first, last : int or None
        Realisations that count, ends included; None for no limit.
    healthy : tuple of str
        Parts of the recording that stands in for a model.
    first_healthy, last_healthy : int or None
        Its realisations that count.
    """

    kind: Kind
    files: tuple[str, ...]
    model: str | None = None
    validate: str | None = None
    first: int | None = None
    last: int | None = None
    healthy: tuple[str, ...] = ()
    first_healthy: int | None = None
    last_healthy: int | None = None


@dataclass(frozen=True)
class Claim:
    """A job that a runner has taken on."""

    id: str
    task: Task


def put(store: Store, task: Task, request: Mapping[str, Any], *, now: int, waiting: int) -> str | None:
    """Put a job at the end of the queue.

    Parameters
    ----------
    store : Store
    task : Task
    request : mapping
        What the client asked for, which is shown with the job.
    now : int
    waiting : int
        How many jobs may wait.

    Returns
    -------
    str or None
        Its id; None if so many wait already.
    """
    jobs = tables.jobs
    identifier = str(uuid.uuid4())
    with store.write() as connection:
        queued = sa.select(sa.func.count()).select_from(jobs).where(jobs.c.status == JobStatus.QUEUED.value)
        if connection.execute(queued).scalar_one() >= waiting:
            return None
        connection.execute(
            sa.insert(jobs).values(
                id=identifier,
                kind=task.kind,
                status=JobStatus.QUEUED.value,
                request=dict(request),
                task=asdict(task),
                stage="",
                cancel=False,
                created_at=now,
            )
        )
    return identifier


def claim(store: Store, now: int) -> Claim | None:
    """Take the job that has waited longest; None if none waits, or another runner was quicker."""
    jobs = tables.jobs
    with store.read() as connection:
        query = sa.select(jobs.c.id, jobs.c.task).where(jobs.c.status == JobStatus.QUEUED.value)
        row = connection.execute(query.order_by(jobs.c.seq).limit(1)).first()
    if row is None:
        return None
    with store.write() as connection:
        taken = connection.execute(
            sa.update(jobs)
            .where(jobs.c.id == row.id, jobs.c.status == JobStatus.QUEUED.value)
            .values(status=JobStatus.RUNNING.value, started_at=now, beat_at=now)
        ).rowcount
    return Claim(row.id, _task(row.task)) if taken else None


def beat(store: Store, identifier: str, now: int, progress: float | None, stage: str) -> bool:
    """Write that a job is being worked on, and how far it is.

    Returns
    -------
    bool
        False if it is to be ended: somebody cancelled it, or it is no longer this runner's.
    """
    jobs = tables.jobs
    with store.write(durable=False) as connection:
        going_on = connection.execute(
            sa.update(jobs)
            .where(jobs.c.id == identifier, jobs.c.status == JobStatus.RUNNING.value, jobs.c.cancel.is_(False))
            .values(beat_at=now, progress=progress, stage=stage)
        ).rowcount
    return bool(going_on)


def finish(
    store: Store,
    identifier: str,
    status: JobStatus,
    now: int,
    *,
    result: str | None = None,
    report: str | None = None,
    reason: str | None = None,
) -> None:
    """Write how a running job ended; one that was cancelled meanwhile is so, however it ended."""
    jobs = tables.jobs
    values: Json = {"ended_at": now, "stage": ""}
    ended = {**values, "status": status.value, "result": result, "report": report, "reason": reason}
    if status is JobStatus.DONE:
        ended["progress"] = 1.0
    cancelled = {**values, "status": JobStatus.CANCELLED.value, "reason": "cancelled while it ran"}
    running = (jobs.c.id == identifier, jobs.c.status == JobStatus.RUNNING.value)
    with store.write() as connection:
        connection.execute(sa.update(jobs).where(*running, jobs.c.cancel.is_(True)).values(cancelled))
        connection.execute(sa.update(jobs).where(*running).values(ended))


def cancel(store: Store, identifier: str, now: int) -> None:
    """End a job that waits, and ask for the end of one that runs; any other is left as it is."""
    jobs = tables.jobs
    with store.write() as connection:
        connection.execute(
            sa.update(jobs)
            .where(jobs.c.id == identifier, jobs.c.status == JobStatus.QUEUED.value)
            .values(status=JobStatus.CANCELLED.value, ended_at=now, reason="cancelled before it began")
        )
        connection.execute(
            sa.update(jobs)
            .where(jobs.c.id == identifier, jobs.c.status == JobStatus.RUNNING.value)
            .values(cancel=True)
        )


def fail_orphans(store: Store, now: int) -> None:
    """Give the jobs whose runner has fallen silent up."""
    jobs = tables.jobs
    with store.write(durable=False) as connection:
        connection.execute(
            sa.update(jobs)
            .where(jobs.c.status == JobStatus.RUNNING.value, jobs.c.beat_at < now - round(SILENT_SECONDS * 1e9))
            .values(
                status=JobStatus.FAILED.value,
                ended_at=now,
                stage="",
                reason="the service that ran it ended before it did; ask for it again",
            )
        )


def prune(store: Store, kept: int = _KEPT) -> list[str]:
    """Forget the oldest jobs that have ended; gives the paths of their reports."""
    jobs = tables.jobs
    ended = jobs.c.status.not_in([JobStatus.QUEUED.value, JobStatus.RUNNING.value])
    with store.write() as connection:
        newest = sa.select(jobs.c.seq).where(ended).order_by(jobs.c.seq.desc()).offset(kept).limit(1)
        limit = connection.execute(newest).scalar()
        if limit is None:
            return []
        old = (ended, jobs.c.seq <= limit)
        reports = connection.execute(sa.select(jobs.c.report).where(*old, jobs.c.report.is_not(None))).scalars()
        paths = list(reports)
        connection.execute(sa.delete(jobs).where(*old))
    return paths


def job(connection: sa.Connection, identifier: str, kind: Kind | None = None) -> Json | None:
    """Return a job as it is shown; None if there is none of this id (and kind)."""
    query = sa.select(tables.jobs).where(tables.jobs.c.id == identifier)
    if kind is not None:
        query = query.where(tables.jobs.c.kind == kind)
    row = connection.execute(query).mappings().first()
    return None if row is None else _shown(row)


def report_path(connection: sa.Connection, identifier: str) -> str | None:
    """Return where a job's report lies; None if it has none."""
    query = sa.select(tables.jobs.c.report).where(tables.jobs.c.id == identifier)
    return connection.execute(query).scalar()


def listed(connection: sa.Connection, kind: Kind | None, after: int | None, limit: int) -> Slice:
    """Return jobs without their results, the newest first."""
    jobs = tables.jobs
    query = sa.select(jobs)
    if kind is not None:
        query = query.where(jobs.c.kind == kind)
    if after is not None:
        query = query.where(jobs.c.seq < after)
    rows = connection.execute(query.order_by(jobs.c.seq.desc()).limit(limit + 1)).mappings().all()
    items = [{key: value for key, value in _shown(row).items() if key != "result"} for row in rows[:limit]]
    return Slice(items, (rows[limit - 1]["seq"],) if len(rows) > limit else None)


def _shown(row: sa.RowMapping) -> Json:
    return {
        "id": row["id"],
        "kind": row["kind"],
        "status": row["status"],
        "progress": row["progress"],
        "stage": row["stage"],
        "reason": row["reason"],
        "request": row["request"],
        "created_at": time_json(row["created_at"]),
        "started_at": moment_json(row["started_at"]),
        "ended_at": moment_json(row["ended_at"]),
        "report": None if row["report"] is None else f"/api/v1/diagnoses/{row['id']}/report",
        "result": None if row["result"] is None else json.loads(row["result"]),
    }


def _task(stored: Mapping[str, Any]) -> Task:
    values = {field.name: stored[field.name] for field in fields(Task)}
    return Task(**{**values, "files": tuple(stored["files"]), "healthy": tuple(stored.get("healthy", ()))})
