"""Routes of webhooks and of the audit log."""

import time
from typing import Annotated, Any

from anyio.to_thread import run_sync
from fastapi import APIRouter, Depends, Path, Request, Response

from creak.api.access import Access
from creak.api.describe import StoreOf, refusals
from creak.api.paging import CursorText, Limit, read_cursor, write_cursor
from creak.api.problems import ProblemError, bad_parameter
from creak.api.webhook_models import (
    AuditPage,
    DeliveryPage,
    NewSecret,
    NewWebhook,
    Queued,
    Webhook,
    WebhookBody,
    WebhookPage,
)
from creak.codec import moment_json, time_json
from creak.errors import RefusedAddressError
from creak.sinks import audit, outbox, receivers
from creak.sinks.receivers import Receiver
from creak.webhooks import trouble
from creak.webhooks.addresses import AddressPolicy, parse_target, resolve
from creak.webhooks.schedule import SECOND
from creak.webhooks.signature import new_secret

router = APIRouter(tags=["webhooks"])
Json = dict[str, Any]

_MOST = 200
_OLD_SECRET_SECONDS = 86_400

WebhookId = Annotated[str, Path(description="Id of the webhook.")]
MessageId = Annotated[str, Path(description="Id of the message.")]


async def _policy(request: Request) -> AddressPolicy:
    access: Access = request.app.state.access
    return AddressPolicy(access.allow)


@router.get("/webhooks", response_model=WebhookPage, responses=refusals(422))
def list_webhooks(store: StoreOf, cursor: CursorText = None, limit: Limit = 100) -> Json:
    """List receivers, without their secrets."""
    place = read_cursor(cursor, ["webhooks"], (int,))
    with store.read() as connection:
        found = receivers.page(connection, None if place is None else place[0], limit + 1)
        items = [_shown(item, outbox.backlog(connection, item.id)) for item in found[:limit]]
    end = (found[limit - 1].seq,) if len(found) > limit else None
    return {"items": items, "next": write_cursor(end, ["webhooks"])}


@router.post("/webhooks", response_model=NewWebhook, status_code=201, responses=refusals(409, 408, 413, 422))
async def add_webhook(
    store: StoreOf, body: WebhookBody, policy: Annotated[AddressPolicy, Depends(_policy)], response: Response
) -> Json:
    """Add a receiver. Its host must be known and must not lie in a network to which nothing is sent.

    The secret with which messages are signed is in the answer to this request and in no other.
    """
    try:
        await resolve(parse_target(body.url), policy)
    except RefusedAddressError as error:
        raise bad_parameter("body", "url", str(error)) from error
    secret = new_secret()

    def write() -> Receiver:
        with store.write() as connection:
            if len(receivers.page(connection, None, _MOST)) == _MOST:
                raise ProblemError(409, "too-many-webhooks", "Too many webhooks", f"there are {_MOST} already")
            return receivers.add(connection, body.url, tuple(body.events), tuple(body.rigs), body.format, secret)

    made = await run_sync(write)
    response.headers["Location"] = f"/api/v1/webhooks/{made.id}"
    return {**_shown(made, 0), "secret": secret}


@router.get("/webhooks/{webhook}", response_model=Webhook, responses=refusals(404, 422))
def get_webhook(store: StoreOf, webhook: WebhookId) -> Json:
    """Return one receiver."""
    with store.read() as connection:
        found = receivers.get(connection, webhook)
        if found is None:
            raise _unknown(webhook)
        return _shown(found, outbox.backlog(connection, webhook))


@router.delete(
    "/webhooks/{webhook}",
    status_code=204,
    response_class=Response,
    responses={204: {"description": "Removed, with its messages and its log."}, **refusals(404, 408, 413, 422)},
)
def remove_webhook(store: StoreOf, webhook: WebhookId) -> None:
    """Remove a receiver."""
    with store.write() as connection:
        found = receivers.get(connection, webhook)
        if found is None or not receivers.remove(connection, webhook):
            raise _unknown(webhook)
        trouble.clear(connection, found, time.time_ns())


@router.post(
    "/webhooks/{webhook}/test", response_model=Queued, status_code=202, responses=refusals(404, 408, 409, 413, 422)
)
def test_webhook(store: StoreOf, webhook: WebhookId) -> Json:
    """Send a message of type `webhook.test`; what becomes of it stands in the deliveries."""
    with store.write() as connection:
        return {"message": outbox.enqueue_test(connection, _enabled(connection, webhook), time.time_ns())}


@router.post("/webhooks/{webhook}/enable", response_model=Webhook, responses=refusals(404, 408, 413, 422))
def enable_webhook(store: StoreOf, webhook: WebhookId) -> Json:
    """Take a disabled receiver into service again: what waits for it is delivered."""
    with store.write() as connection:
        found = receivers.get(connection, webhook)
        if found is None:
            raise _unknown(webhook)
        if not found.enabled:
            trouble.enable(connection, found, time.time_ns())
        changed = receivers.get(connection, webhook)
        assert changed is not None
        return _shown(changed, outbox.backlog(connection, webhook))


@router.post("/webhooks/{webhook}/secret", response_model=NewSecret, responses=refusals(404, 408, 413, 422))
def rotate_secret(store: StoreOf, webhook: WebhookId) -> Json:
    """Make a new secret; for a day messages are signed with the old one too, so that a receiver can change."""
    secret, until = new_secret(), time.time_ns() + _OLD_SECRET_SECONDS * SECOND
    with store.write() as connection:
        found = receivers.get(connection, webhook)
        if found is None:
            raise _unknown(webhook)
        receivers.update(connection, webhook, secret=secret, old_secret=found.secret, old_secret_until_at=until)
    return {"secret": secret, "old_secret_until": time_json(until)}


@router.get("/webhooks/{webhook}/deliveries", response_model=DeliveryPage, responses=refusals(404, 422))
def list_deliveries(store: StoreOf, webhook: WebhookId, cursor: CursorText = None, limit: Limit = 100) -> Json:
    """List attempts to deliver, the newest first."""
    of = ["deliveries", webhook]
    place = read_cursor(cursor, of, (int,))
    with store.read() as connection:
        if receivers.get(connection, webhook) is None:
            raise _unknown(webhook)
        rows = outbox.delivery_page(connection, webhook, None if place is None else place[0], limit + 1)
    names = ("message", "type", "attempt", "seconds", "status_code", "outcome", "error")
    items = [{**{name: row[name] for name in names}, "time": time_json(row["begun_at"])} for row in rows[:limit]]
    return {"items": items, "next": write_cursor((rows[limit - 1]["seq"],) if len(rows) > limit else None, of)}


@router.post(
    "/webhooks/{webhook}/deliveries/{message}/redeliver",
    response_model=Queued,
    status_code=202,
    responses=refusals(404, 408, 409, 413, 422),
)
def redeliver(store: StoreOf, webhook: WebhookId, message: MessageId) -> Json:
    """Send a message once more, under its own id."""
    with store.write() as connection:
        _enabled(connection, webhook)
        if not outbox.redeliver(connection, webhook, message, time.time_ns()):
            detail = f"webhook {webhook!r} has no message {message!r}, or has it no longer"
            raise ProblemError(404, "unknown-message", "Unknown message", detail)
    return {"message": message}


@router.get("/audit", response_model=AuditPage, responses=refusals(422), tags=["service"])
def list_audit(store: StoreOf, cursor: CursorText = None, limit: Limit = 100) -> Json:
    """List who changed what through this API, and who was turned away; the newest first."""
    place = read_cursor(cursor, ["audit"], (int,))
    with store.read() as connection:
        rows = audit.page(connection, None if place is None else place[0], limit + 1)
    names = ("who", "address", "method", "path", "status")
    items = [{**{name: row[name] for name in names}, "time": time_json(row["at"])} for row in rows[:limit]]
    return {
        "items": items,
        "next": write_cursor((rows[limit - 1]["seq"],) if len(rows) > limit else None, ["audit"]),
    }


def _enabled(connection: Any, webhook: str) -> Receiver:
    found = receivers.get(connection, webhook)
    if found is None:
        raise _unknown(webhook)
    if not found.enabled:
        detail = f"webhook {webhook!r} is disabled ({found.reason}); enable it first"
        raise ProblemError(409, "webhook-disabled", "Webhook disabled", detail)
    return found


def _unknown(webhook: str) -> ProblemError:
    return ProblemError(404, "unknown-webhook", "Unknown webhook", f"there is no webhook {webhook!r}")


def _shown(receiver: Receiver, waiting: int) -> Json:
    since = receiver.failing_since_at
    return {
        "id": receiver.id,
        "url": receiver.url,
        "events": list(receiver.events),
        "rigs": list(receiver.rigs),
        "format": receiver.format,
        "enabled": receiver.enabled,
        "reason": receiver.reason,
        "created_at": time_json(receiver.created_at),
        "failing_since": moment_json(since),
        "waiting": waiting,
    }
