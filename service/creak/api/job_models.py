"""Bodies of jobs, and an example of each."""

from typing import Any, Literal

from pydantic import ConfigDict, Field

from creak.api.models import Answer, Page

_LINE = r"^[^\x00-\x1f\x7f]*$"


class DiagnosisRequest(Answer):
    """What is to be diagnosed: a recording, or an alarm, which stands for the stretch in which it was raised."""

    model_config = ConfigDict(
        extra="forbid",
        strict=True,
        json_schema_extra={"examples": [{"recording": "beam-20260501T080000Z-000"}, {"alarm": "9f3c1b6e"}]},
    )
    recording: str | None = Field(default=None, max_length=200, pattern=_LINE, description="Id of a recording.")
    alarm: str | None = Field(default=None, max_length=200, pattern=_LINE, description="Id of an alarm.")
    model: str | None = Field(
        default=None, max_length=4000, pattern=_LINE, description="The rig's model, which is the default."
    )
    validation: str | None = Field(
        default=None,
        alias="validate",
        max_length=200,
        pattern=_LINE,
        description="Id of a recording at another amplitude.",
    )
    first_realisation: int | None = Field(default=None, ge=0, lt=2**31, description="First that counts, from 0.")
    last_realisation: int | None = Field(default=None, ge=0, lt=2**31, description="Last that counts.")


DiagnosisRequest.example = {"alarm": "9f3c1b6e"}


class JobSummary(Answer):
    """A computation that takes longer than a request may."""

    id: str
    kind: Literal["diagnosis", "replay"]
    status: Literal["queued", "running", "done", "failed", "cancelled"]
    progress: float | None = Field(description="Share of the work that is done, 0 to 1; null while not known.")
    stage: str = Field(description="What is being done.")
    reason: str | None = Field(description="Why there is no result.")
    request: dict[str, Any] = Field(description="What was asked for.")
    created_at: str = Field(description="Wall-clock time, as are the next two.")
    started_at: str | None
    ended_at: str | None
    report: str | None = Field(description="Path of the HTML report.")


class Job(JobSummary):
    """A computation with its result."""

    result: dict[str, Any] | None = Field(description="What the command prints with `--json`; null until done.")


class DiagnosisJob(Job):
    """A diagnosis: the result is the document of `creak diagnose --json`."""


class JobPage(Page):
    """Jobs, newest first."""

    items: list[JobSummary]


_JOB = {
    "id": "5f0c6d1e-7a0b-4c55-9a43-0d3f0a2b9c11",
    "kind": "diagnosis",
    "status": "done",
    "progress": 1.0,
    "stage": "",
    "reason": None,
    "request": {"recording": "beam-20260501T080000Z-000", "rig": "beam", "model": "model.toml"},
    "created_at": "2026-05-01T09:00:00.000000Z",
    "started_at": "2026-05-01T09:00:00.200000Z",
    "ended_at": "2026-05-01T09:00:08.500000Z",
    "report": "/api/v1/diagnoses/5f0c6d1e-7a0b-4c55-9a43-0d3f0a2b9c11/report",
}
JobPage.example = {"items": [_JOB], "next": None}
DiagnosisJob.example = {
    **_JOB,
    "result": {
        "verdict": "explained",
        "gap": {"before_db": -8.2, "after_db": -39.6, "noise_db": -39.9, "closed": 0.9999},
        "nodes": [],
        "where": [{"at": ["3", "ground"], "share": 0.98, "band_hz": [28.1, 41.0]}],
        "causes": [
            {
                "effect": "cubic_stiffness",
                "at": ["3", "ground"],
                "parameters": {"coefficient": 1.0e8},
                "standard_errors": {"coefficient": 2e5},
                "probability": 0.99,
                "gap_after_db": -39.6,
            }
        ],
        "alternatives": [],
        "linear_corrections": [],
        "held_out_realisations": 2,
    },
}
Job.example = {
    **_JOB,
    "kind": "replay",
    "request": {"recording": "beam-20260501T080000Z-000", "rig": "beam"},
    "report": None,
    "result": {"rig": "beam", "frames": 60, "rejected_frames": 0, "nodes": []},
}
