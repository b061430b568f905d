"""Signatures after the Standard Webhooks specification (HMAC-SHA256, version ``v1``)."""

import base64
import hashlib
import hmac
import secrets
from collections.abc import Iterable

_PREFIX = "whsec_"
_BYTES = 32  # the specification asks for 24 to 64


def new_secret() -> str:
    """Return a new secret, ``whsec_`` and 32 random bytes in base64."""
    return _PREFIX + base64.b64encode(secrets.token_bytes(_BYTES)).decode()


def sign(identifier: str, seconds: int, body: bytes, keys: Iterable[str]) -> dict[str, str]:
    """Return the headers that prove where a message comes from.

    Parameters
    ----------
    identifier : str
        Of the message; the same at every attempt.
    seconds : int
        Time of the attempt, since the Unix epoch; a receiver refuses an old one, so it is not that of the event.
    body : bytes
    keys : iterable of str
        Secrets; during a rotation the new and the old one, so that either verifies.
    """
    signed = f"{identifier}.{seconds}.".encode() + body
    signatures = (
        base64.b64encode(hmac.new(base64.b64decode(key.removeprefix(_PREFIX)), signed, hashlib.sha256).digest())
        for key in keys
    )
    return {
        "webhook-id": identifier,
        "webhook-timestamp": str(seconds),
        "webhook-signature": " ".join(f"v1,{signature.decode()}" for signature in signatures),
    }
