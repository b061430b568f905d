"""Routes of what takes longer than a request: diagnoses and replays, put into the store for a runner to do."""

import time
from pathlib import Path as FilePath
from typing import Annotated, Any

from fastapi import APIRouter, Body, Path, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import AfterValidator

from creak.api.describe import StoreOf, plain_name, refusals
from creak.api.job_models import DiagnosisJob, DiagnosisRequest, Job, JobPage
from creak.api.paging import CursorText, Limit, read_cursor, write_cursor
from creak.api.problems import ProblemError, bad_parameter, unknown_alarm
from creak.report import POLICY
from creak.sinks import jobs
from creak.sinks.database import Store
from creak.sinks.diagnosable import Material, healthy_before, of_alarm, of_recording
from creak.sinks.jobs import Kind, Task

router = APIRouter(tags=["jobs"])
Json = dict[str, Any]

_WAITING = 100  # jobs that may wait; a client that asks for more is told to come back

JobId = Annotated[str, Path(description="Id of the job.", max_length=200), AfterValidator(plain_name)]
DiagnosisId = Annotated[str, Path(description="Id of the diagnosis.", max_length=200), AfterValidator(plain_name)]
RecordingId = Annotated[str, Path(description="Id of the recording."), AfterValidator(plain_name)]
_ACCEPTED: dict[int | str, dict[str, Any]] = {
    202: {"headers": {"Location": {"description": "Where to ask how it goes.", "schema": {"type": "string"}}}}
}


@router.post(
    "/diagnoses", status_code=202, response_model=DiagnosisJob, responses=_ACCEPTED | refusals(404, 409, 410, 422)
)
def ask_for_a_diagnosis(
    request: Request, response: Response, store: StoreOf, body: Annotated[DiagnosisRequest, Body()]
) -> Json:
    """Ask where a recording, or the stretch of it in which an alarm stood, departs from the rig's model, and why.

    Where the rig has no model, an alarm's recording is held against the healthy realisations before the alarm.
    The answer comes at once; the diagnosis is computed beside the service and found at `Location`, which is also
    where its HTML report lies (`/report`).
    """
    material = _material(store, body)
    model = _model(request, material.rig, body.model)
    healthy = None if model is not None else _healthy(store, material.rig, body.alarm)
    _present(material)
    if healthy is not None:
        _present(healthy)
    validate = None if body.validation is None else _recording(store, body.validation)
    if validate is not None:
        _present(validate)
    task = Task(
        "diagnosis",
        material.files,
        model=None if model is None else str(model),
        validate=None if validate is None else validate.files[0],
        first=material.first if body.first_realisation is None else body.first_realisation,
        last=material.last if body.last_realisation is None else body.last_realisation,
        healthy=() if healthy is None else healthy.files,
        first_healthy=None if healthy is None else healthy.first,
        last_healthy=None if healthy is None else healthy.last,
    )
    asked = {
        "recording": body.recording,
        "alarm": body.alarm,
        "rig": material.rig,
        "model": None if model is None else model.name,
        "healthy_realisations": None if healthy is None else [healthy.first, healthy.last],
        "validate": body.validation,
        "first_realisation": task.first,
        "last_realisation": task.last,
    }
    return _accept(store, response, task, asked)


@router.get("/diagnoses", response_model=JobPage, responses=refusals(422))
def list_diagnoses(store: StoreOf, cursor: CursorText = None, limit: Limit = 100) -> Json:
    """List diagnoses, the newest first, without their results."""
    return _page(store, "diagnosis", cursor, limit)


@router.get("/diagnoses/{diagnosis}", response_model=DiagnosisJob, responses=refusals(404, 422))
def get_diagnosis(store: StoreOf, diagnosis: DiagnosisId) -> Json:
    """Return a diagnosis: how it goes, and once it is done its result, the document of `creak diagnose --json`."""
    return _job(store, diagnosis, "diagnosis")


@router.get(
    "/diagnoses/{diagnosis}/report",
    response_class=HTMLResponse,
    responses={
        200: {
            "content": {"text/html": {"example": "<!doctype html>..."}},
            "description": "One page, nothing loaded.",
        },
        **refusals(404, 422),
    },
)
def get_report(store: StoreOf, diagnosis: DiagnosisId) -> HTMLResponse:
    """Return the report of a diagnosis that is done: one page for a person, with its pictures in it."""
    found = _job(store, diagnosis, "diagnosis")
    with store.read() as connection:
        path = jobs.report_path(connection, diagnosis)
    try:
        text = None if path is None else FilePath(path).read_text(encoding="utf-8")
    except OSError:
        text = None
    if text is None:
        detail = f"diagnosis {diagnosis!r} has no report: it is {found['status']}"
        raise ProblemError(404, "no-report", "No report", detail)
    return HTMLResponse(text, headers={"Content-Security-Policy": f"{POLICY}; frame-ancestors 'none'; sandbox"})


@router.post(
    "/recordings/{recording}/replay",
    status_code=202,
    response_model=Job,
    responses=_ACCEPTED | refusals(404, 409, 410, 422),
)
def ask_for_a_replay(response: Response, store: StoreOf, recording: RecordingId) -> Json:
    """Ask for a recording to be put through the pipeline again; the result is that of `creak replay --json`."""
    material = _recording(store, recording)
    _present(material)
    return _accept(store, response, Task("replay", material.files), {"recording": recording, "rig": material.rig})


@router.get("/jobs", response_model=JobPage, responses=refusals(422))
def list_jobs(store: StoreOf, cursor: CursorText = None, limit: Limit = 100) -> Json:
    """List jobs of every kind, the newest first, without their results."""
    return _page(store, None, cursor, limit)


@router.get("/jobs/{job}", response_model=Job, responses=refusals(404, 422))
def get_job(store: StoreOf, job: JobId) -> Json:
    """Return a job: how it goes, and once it is done its result."""
    return _job(store, job, None)


@router.post("/jobs/{job}/cancel", response_model=Job, responses=refusals(404, 422))
def cancel_job(store: StoreOf, job: JobId) -> Json:
    """End a job that waits or runs; one that has ended stays as it is. Within a second or so it is `cancelled`."""
    _job(store, job, None)
    jobs.cancel(store, job, time.time_ns())
    return _job(store, job, None)


def _accept(store: Store, response: Response, task: Task, asked: Json) -> Json:
    identifier = jobs.put(store, task, asked, now=time.time_ns(), waiting=_WAITING)
    if identifier is None:
        detail = f"{_WAITING} jobs wait already; ask again later"
        raise ProblemError(503, "queue-full", "Queue full", detail, headers={"Retry-After": "60"})
    response.headers["Location"] = f"/api/v1/{'diagnoses' if task.kind == 'diagnosis' else 'jobs'}/{identifier}"
    return _job(store, identifier, task.kind)


def _material(store: Store, body: DiagnosisRequest) -> Material:
    if (body.recording is None) == (body.alarm is None):
        raise bad_parameter("body", "recording", "give either 'recording' or 'alarm'")
    if body.recording is not None:
        return _recording(store, body.recording)
    assert body.alarm is not None
    with store.read() as connection:
        found = of_alarm(connection, body.alarm)
    if found is None:
        raise unknown_alarm(body.alarm)
    if not found.files:
        detail = f"the run in which alarm {body.alarm!r} was raised has no recording"
        raise ProblemError(409, "not-recorded", "Not recorded", detail)
    return found


def _recording(store: Store, identifier: str) -> Material:
    with store.read() as connection:
        found = of_recording(connection, identifier)
    if found is None:
        raise ProblemError(404, "unknown-recording", "Unknown recording", f"there is no recording {identifier!r}")
    return found


def _present(material: Material) -> None:
    for file in material.files:
        if not FilePath(file).is_file():
            raise ProblemError(
                410, "recording-gone", "Recording gone", f"the file {FilePath(file).name} is no longer there"
            )


def _model(request: Request, rig: str, asked: str | None) -> FilePath | None:
    """Return the model that the service file gives the rig, if any: no other file is opened for a client."""
    model: FilePath | None = request.app.state.models.get(rig)
    if model is None:
        if asked is not None:
            raise bad_parameter("body", "model", f"{asked!r} is not the model of rig {rig!r}, which has none")
        return None
    if asked is not None and asked not in {str(model), model.name}:
        raise bad_parameter("body", "model", f"{asked!r} is not the model of rig {rig!r}; that is {model.name!r}")
    return model


def _healthy(store: Store, rig: str, alarm: str | None) -> Material:
    """Return what stands in for a model: the realisations before an alarm."""
    found = None
    if alarm is not None:
        with store.read() as connection:
            found = healthy_before(connection, alarm)
    if found is None:
        why = "there is nothing to compare its recordings with"
        if alarm is not None:
            why = "the alarm has no healthy realisations before it to compare with"
        detail = f"rig {rig!r} has no model in the service file, and {why}"
        raise ProblemError(409, "no-model", "No model", detail)
    return found


def _job(store: Store, identifier: str, kind: Kind | None) -> Json:
    with store.read() as connection:
        found = jobs.job(connection, identifier, kind)
    if found is None:
        name = kind or "job"
        raise ProblemError(404, f"unknown-{name}", f"Unknown {name}", f"there is no {name} {identifier!r}")
    return found


def _page(store: Store, kind: Kind | None, cursor: str | None, limit: int) -> Json:
    of = ["jobs", kind]
    place = read_cursor(cursor, of, (int,))
    with store.read() as connection:
        page = jobs.listed(connection, kind, None if place is None else place[0], limit)
    return {"items": page.items, "next": write_cursor(page.end, of)}
