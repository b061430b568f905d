"""Tables of what people and their programs add to the store: actions, receivers, messages, keys, saved states.

They came with version 2 of the store. Columns named ``*_at`` are wall-clock nanoseconds since the Unix epoch.
"""

import sqlalchemy as sa

from creak.sinks.tables import Serial, metadata

actions = sa.Table(
    "actions",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("id", sa.Text, nullable=False, unique=True),
    sa.Column("rig", sa.Text, nullable=False),
    sa.Column("alarm", sa.Text, nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),  # an ActionKind
    sa.Column("by", sa.Text, nullable=False),
    sa.Column("comment", sa.Text, nullable=False),
    sa.Column("until", sa.BigInteger),  # recorded time, ns; of a shelving
    sa.Column("version", sa.Integer),  # of the alarm that the operator has seen
    sa.Column("asked_at", sa.BigInteger, nullable=False),
    sa.Column("status", sa.String(16), nullable=False),  # pending, done, stale, not_allowed
    sa.Column("reason", sa.Text, nullable=False),  # why it was refused
    sa.Column("folded", sa.Boolean, nullable=False),  # the rig's monitor knows it
    sa.Column("node", sa.Text),  # of whose alarm it is asked, whether it alarmed or not; since version 4
    sa.Index("actions_pending", "rig", "folded", "seq"),
    sqlite_autoincrement=True,
)
"""What operators asked for: written by the API, carried out by the worker of the rig."""

states = sa.Table(
    "states",
    metadata,
    sa.Column("rig", sa.Text, primary_key=True),
    sa.Column("run", sa.Text, nullable=False),
    sa.Column("time", sa.BigInteger, nullable=False),  # recorded
    sa.Column("payload", sa.LargeBinary, nullable=False),
)
"""What a rig's monitor has to know after a restart, as of its last complete realisation."""

webhooks = sa.Table(
    "webhooks",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("id", sa.Text, nullable=False, unique=True),
    sa.Column("url", sa.Text, nullable=False),
    sa.Column("events", sa.JSON, nullable=False),  # types wanted; empty for all
    sa.Column("rigs", sa.JSON, nullable=False),  # rigs wanted; empty for all
    sa.Column("format", sa.String(16), nullable=False),  # standard, cloudevents
    sa.Column("secret", sa.Text, nullable=False),  # in clear: whoever signs must know it
    sa.Column("old_secret", sa.Text),
    sa.Column("old_secret_until_at", sa.BigInteger),
    sa.Column("created_at", sa.BigInteger, nullable=False),
    sa.Column("enabled", sa.Boolean, nullable=False),
    sa.Column("reason", sa.Text, nullable=False),  # why it is disabled
    sa.Column("alarm", sa.Text),  # the alarm that tells of it
    sa.Column("failing_since_at", sa.BigInteger),
    sa.Column("paused_until_at", sa.BigInteger, nullable=False),
    sqlite_autoincrement=True,
)

outbox = sa.Table(
    "outbox",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("id", sa.Text, nullable=False),
    sa.Column("webhook", sa.ForeignKey("webhooks.id", ondelete="CASCADE"), nullable=False),
    sa.Column("subject", sa.Text, nullable=False),  # messages of one subject keep their order; "" waits for all
    sa.Column("type", sa.Text, nullable=False),
    sa.Column("body", sa.Text, nullable=False),
    sa.Column("created_at", sa.BigInteger, nullable=False),
    sa.Column("status", sa.String(16), nullable=False),  # pending, delivered, failed, coalesced
    sa.Column("attempts", sa.Integer, nullable=False),
    sa.Column("next_at", sa.BigInteger, nullable=False),
    sa.Column("merged_into", sa.Text),  # id of the message that a coalesced one went into
    sa.UniqueConstraint("webhook", "id"),
    sa.Index("outbox_order", "webhook", "status", "subject", "seq"),
    sa.Index("outbox_due", "status", "next_at"),
    sqlite_autoincrement=True,
)
"""Messages for receivers, written in the transaction of that which they tell of."""

deliveries = sa.Table(
    "deliveries",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("webhook", sa.ForeignKey("webhooks.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("type", sa.Text, nullable=False),
    sa.Column("attempt", sa.Integer, nullable=False),
    sa.Column("begun_at", sa.BigInteger, nullable=False),
    sa.Column("seconds", sa.Double, nullable=False),
    sa.Column("status_code", sa.Integer),  # null if no answer came
    sa.Column("outcome", sa.String(16), nullable=False),  # delivered, retried, failed
    sa.Column("error", sa.Text, nullable=False),
    sqlite_autoincrement=True,
)
"""Every attempt. Answers' bodies are not kept: who may add a webhook must not read through it what it reaches."""

leases = sa.Table(
    "leases",
    metadata,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("owner", sa.Text, nullable=False),
    sa.Column("until_at", sa.BigInteger, nullable=False),
)
"""Work that one process at a time may do."""

keys = sa.Table(
    "api_keys",
    metadata,
    sa.Column("id", sa.String(32), primary_key=True),
    sa.Column("name", sa.Text, nullable=False, unique=True),
    sa.Column("scope", sa.String(16), nullable=False),
    sa.Column("hash", sa.String(64), nullable=False),
    sa.Column("created_at", sa.BigInteger, nullable=False),
)

audit = sa.Table(
    "audit",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("at", sa.BigInteger, nullable=False),  # wall clock, ns
    sa.Column("who", sa.Text, nullable=False),
    sa.Column("address", sa.Text, nullable=False),
    sa.Column("method", sa.Text, nullable=False),
    sa.Column("path", sa.Text, nullable=False),
    sa.Column("status", sa.Integer, nullable=False),
    sqlite_autoincrement=True,
)
"""Who asked to change what, and who was turned away."""

ADDED = (actions, states, webhooks, outbox, deliveries, leases, keys, audit)
"""Tables that version 2 added."""
