"""Bodies of the routes of webhooks and of the audit log."""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, StringConstraints

from creak.api.models import Answer, Page

_EventName = Annotated[
    str, StringConstraints(max_length=64, pattern=r"^(\*|alarm\.\*|alarm\.[a-z_]+)$", strict=True)
]
_RigName = Annotated[
    str, StringConstraints(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]+$", strict=True)
]


class WebhookBody(Answer):
    """A receiver to be added."""

    model_config = ConfigDict(extra="forbid", strict=True)
    url: str = Field(
        min_length=1, max_length=2000, description="http or https, of a public host or an allowed one."
    )
    events: list[_EventName] = Field(
        default=[], max_length=50, description="Types wanted, such as `alarm.raised`; empty for all."
    )
    rigs: list[_RigName] = Field(default=[], max_length=1000, description="Rigs wanted; empty for all.")
    format: Literal["standard", "cloudevents"] = Field(
        default="standard", description="Standard Webhooks, or CloudEvents 1.0 in structured JSON; signed alike."
    )


class Webhook(Answer):
    """A receiver."""

    id: str
    url: str
    events: list[str]
    rigs: list[str]
    format: Literal["standard", "cloudevents"]
    enabled: bool
    reason: str = Field(description="Why it is disabled.")
    created_at: str
    failing_since: str | None = Field(description="Wall-clock time of the first failure since the last success.")
    waiting: int = Field(description="Messages that are not delivered yet.")


class NewWebhook(Webhook):
    """A receiver that was added; its secret is shown this once."""

    secret: str


class NewSecret(Answer):
    """The new secret of a receiver."""

    secret: str
    old_secret_until: str = Field(description="Until then messages are signed with the old secret as well.")


class Queued(Answer):
    """A message that is on its way."""

    message: str = Field(description="Its id, which the receiver finds in `webhook-id`.")


class Delivery(Answer):
    """One attempt to deliver a message."""

    message: str
    type: str
    attempt: int
    time: str
    seconds: float
    status_code: int | None = Field(description="Null if no answer came.")
    outcome: Literal["delivered", "retried", "failed"]
    error: str


class WebhookPage(Page):
    """Receivers, as they were added."""

    items: list[Webhook]


class DeliveryPage(Page):
    """Attempts, newest first."""

    items: list[Delivery]


class AuditEntry(Answer):
    """Who asked for what."""

    time: str
    who: str = Field(description="Name of the key; empty without one.")
    address: str
    method: str
    path: str
    status: int


class AuditPage(Page):
    """Entries of the audit log, newest first."""

    items: list[AuditEntry]


_TIME = "2026-05-01T08:00:00.000000Z"
_WEBHOOK: dict[str, Any] = {
    "id": "wh_5d1c",
    "url": "https://example.com/hook",
    "events": ["alarm.raised", "alarm.cleared"],
    "rigs": ["beam"],
    "format": "standard",
    "enabled": True,
    "reason": "",
    "created_at": _TIME,
    "failing_since": None,
    "waiting": 0,
}
_DELIVERY: dict[str, Any] = {
    "message": "msg_77aa",
    "type": "alarm.raised",
    "attempt": 1,
    "time": _TIME,
    "seconds": 0.041,
    "status_code": 204,
    "outcome": "delivered",
    "error": "",
}
_EXAMPLES: dict[type[Answer], Any] = {
    WebhookBody: {name: _WEBHOOK[name] for name in ("url", "events", "rigs", "format")},
    Webhook: _WEBHOOK,
    NewWebhook: {**_WEBHOOK, "secret": "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"},
    NewSecret: {"secret": "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "old_secret_until": _TIME},
    Queued: {"message": "msg_77aa"},
    WebhookPage: {"items": [_WEBHOOK], "next": None},
    DeliveryPage: {"items": [_DELIVERY], "next": None},
    AuditPage: {
        "items": [
            {
                "time": _TIME,
                "who": "control-room",
                "address": "10.20.0.7",
                "method": "POST",
                "path": "/api/v1/alarms/9f3c1b6e/acknowledge",
                "status": 200,
            }
        ],
        "next": None,
    },
}
for _model, _example in _EXAMPLES.items():
    _model.example = _example
