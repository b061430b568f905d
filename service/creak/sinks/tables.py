"""Tables of the store: the one place where API and worker meet.

All statements on them are portable between SQLite and PostgreSQL. Times are recorded time in nanoseconds since
the Unix epoch, but for the columns named ``*_at``, which are wall-clock nanoseconds of the process that writes.
"""

import sqlalchemy as sa

SCHEMA_VERSION = 6
"""Version of these tables; a database of a newer one is refused."""

metadata = sa.MetaData()

# SQLite numbers rows by itself only for a column declared INTEGER PRIMARY KEY, which is 64 bits wide there
Serial = sa.BigInteger().with_variant(sa.Integer, "sqlite")
_Time = sa.BigInteger

schema = sa.Table(
    "creak_schema",
    metadata,
    sa.Column("version", sa.Integer, primary_key=True),
)

counters = sa.Table(
    "counters",
    metadata,
    sa.Column("name", sa.String(32), primary_key=True),
    sa.Column("value", sa.BigInteger, nullable=False),
)
"""Event ids come from here and not from a sequence: the row stays locked until the transaction commits, so ids
become visible in their order and a reader that stands at id ``k`` misses nothing below it."""

runs = sa.Table(
    "runs",
    metadata,
    sa.Column("id", sa.Text, primary_key=True),
    sa.Column("rig", sa.Text, nullable=False, index=True),
    sa.Column("configuration", sa.Text, nullable=False),  # the rig file
    sa.Column("sample_rate", sa.Double, nullable=False),
    sa.Column("period_samples", sa.Integer, nullable=False),
    sa.Column("lines", sa.Integer, nullable=False),
    sa.Column("nodes", sa.JSON, nullable=False),  # [{"name", "input", "output"}], in the order of the rig
    sa.Column("steady_periods", sa.Integer, nullable=False),
    sa.Column("window", sa.Integer, nullable=False),
    sa.Column("source", sa.Text, nullable=False),
    sa.Column("software", sa.Text, nullable=False),
    sa.Column("excitation", sa.JSON, nullable=False),
    sa.Column("limits", sa.JSON, nullable=False),
    sa.Column("rules", sa.JSON),  # AlarmRules; since version 2
    sa.Column("start", _Time, nullable=False),
    sa.Column("last", _Time),  # recorded time of the newest frame or fault
    sa.Column("end", _Time),
    sa.Column("status", sa.String(16), nullable=False),  # running, or a RunStatus
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("opened_at", _Time, nullable=False),
    sa.Column("beat_at", _Time, nullable=False),  # the worker last wrote
    sa.Column("heard_at", _Time),  # the rig last sent a frame
    sa.Column("frames", sa.BigInteger, nullable=False),
    sa.Column("rejected_frames", sa.BigInteger, nullable=False),
    sa.Column("transient_frames", sa.BigInteger, nullable=False),
    sa.Column("realisations", sa.BigInteger, nullable=False),
    sa.Column("experiments", sa.BigInteger, nullable=False),
    sa.Column("faults", sa.JSON, nullable=False),  # {kind: count}
)

rigs = sa.Table(
    "rigs",
    metadata,
    sa.Column("name", sa.Text, primary_key=True),
    sa.Column("run", sa.ForeignKey("runs.id"), nullable=False),  # the current one
)

estimates = sa.Table(
    "estimates",
    metadata,
    sa.Column("id", Serial, primary_key=True),
    sa.Column("run", sa.ForeignKey("runs.id", ondelete="CASCADE"), nullable=False),
    sa.Column("scope", sa.String(8), nullable=False),
    sa.Column("time", _Time, nullable=False),
    sa.Column("realisation", sa.Integer, nullable=False),
    sa.Column("realisations", sa.Integer, nullable=False),
    sa.Column("experiments", sa.Integer, nullable=False),
    sa.Column("periods", sa.Integer, nullable=False),
    sa.Column("located", sa.Boolean, nullable=False),
    sa.Column("elements", sa.JSON, nullable=False),
    sa.Column("unavailable", sa.JSON, nullable=False),
    sa.Column("more", sa.JSON),  # detection and remarks, as they are shown; since version 3
    sa.Index("estimates_newest", "run", "scope", "id"),
    sqlite_autoincrement=True,
)

levels = sa.Table(
    "levels",
    metadata,
    sa.Column("id", Serial, primary_key=True),
    sa.Column("estimate", sa.ForeignKey("estimates.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("rig", sa.Text, nullable=False),
    sa.Column("run", sa.Text, nullable=False),
    sa.Column("scope", sa.String(8), nullable=False),
    sa.Column("time", _Time, nullable=False),
    sa.Column("realisation", sa.Integer, nullable=False),
    sa.Column("name", sa.Text, nullable=False),  # of the node; from here on the columns are those of NodeLevel
    sa.Column("signal_db", sa.Double),
    sa.Column("noise_db", sa.Double),
    sa.Column("total_db", sa.Double),
    sa.Column("nonlinear_db", sa.Double),
    sa.Column("total_to_noise_db", sa.Double),
    sa.Column("classical_noise_db", sa.Double),
    sa.Column("classical_total_db", sa.Double),
    sa.Column("classical_total_to_noise_db", sa.Double),
    sa.Column("p_value", sa.Double),
    sa.Index("levels_history", "rig", "scope", "id"),
    sqlite_autoincrement=True,
)

spectra = sa.Table(
    "spectra",
    metadata,
    sa.Column("rig", sa.ForeignKey("rigs.name", ondelete="CASCADE"), primary_key=True),
    sa.Column("scope", sa.String(8), primary_key=True),
    sa.Column("node", sa.Text, primary_key=True),
    sa.Column("estimate", sa.ForeignKey("estimates.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("samples", sa.LargeBinary, nullable=False),  # (fields of Spectra, F) float64, little endian
)

alarms = sa.Table(
    "alarms",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("id", sa.Text, nullable=False, unique=True),
    sa.Column("run", sa.Text, nullable=False),
    sa.Column("rig", sa.Text, nullable=False),
    sa.Column("node", sa.Text, nullable=False),
    sa.Column("class_", sa.String(16), nullable=False),
    sa.Column("severity", sa.String(16), nullable=False),
    sa.Column("event", sa.String(32), nullable=False),
    sa.Column("state", sa.String(32), nullable=False),
    sa.Column("active", sa.Boolean, nullable=False),
    sa.Column("acknowledged", sa.Boolean, nullable=False),
    sa.Column("shelved", sa.Boolean, nullable=False),
    sa.Column("since", _Time, nullable=False),
    sa.Column("time", _Time, nullable=False),
    sa.Column("level_db", sa.Double),
    sa.Column("never_raised", sa.Boolean),  # null for false; since version 4
    sa.Column("more", sa.JSON),  # the fields of AlarmChange that have no column of their own; since version 2
    sa.Index("alarms_newest", "since", "seq"),
    sa.Index("alarms_of_run", "run", "seq"),
    sqlite_autoincrement=True,
)
"""One row an occurrence: its newest change."""

journal = sa.Table(
    "journal",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("alarm", sa.Text, nullable=False, index=True),
    sa.Column("run", sa.Text, nullable=False, index=True),
    sa.Column("payload", sa.Text, nullable=False),  # the change as JSON
    sqlite_autoincrement=True,
)
"""Every change of every alarm, in order."""

faults = sa.Table(
    "faults",
    metadata,
    sa.Column("id", Serial, primary_key=True),
    sa.Column("run", sa.ForeignKey("runs.id", ondelete="CASCADE"), nullable=False, index=True),
    sa.Column("kind", sa.String(32), nullable=False),
    sa.Column("time", _Time, nullable=False),
    sa.Column("message", sa.Text, nullable=False),
    sa.Column("realisation", sa.BigInteger),
    sa.Column("experiment", sa.BigInteger),
    sa.Column("period", sa.BigInteger),
    sqlite_autoincrement=True,
)

recordings = sa.Table(
    "recordings",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("id", sa.Text, nullable=False, unique=True),
    sa.Column("rig", sa.Text, nullable=False),
    sa.Column("run", sa.Text, nullable=False),
    sa.Column("path", sa.Text, nullable=False),
    sa.Column("start", _Time, nullable=False),
    sa.Column("end", _Time),
    sa.Column("status", sa.String(16), nullable=False),
    sa.Column("size", sa.BigInteger, nullable=False),
    sqlite_autoincrement=True,
)

jobs = sa.Table(
    "jobs",
    metadata,
    sa.Column("seq", Serial, primary_key=True),
    sa.Column("id", sa.Text, nullable=False, unique=True),
    sa.Column("kind", sa.String(16), nullable=False),  # diagnosis, replay
    sa.Column("status", sa.String(16), nullable=False),
    sa.Column("request", sa.JSON, nullable=False),  # what was asked for, as it is shown
    sa.Column("task", sa.JSON, nullable=False),  # what is to be computed: files and realisations
    sa.Column("progress", sa.Double),  # share of the work that is done
    sa.Column("stage", sa.Text, nullable=False),
    sa.Column("cancel", sa.Boolean, nullable=False),
    sa.Column("reason", sa.Text),  # why there is no result
    sa.Column("result", sa.Text),  # JSON
    sa.Column("report", sa.Text),  # path of a file
    sa.Column("created_at", _Time, nullable=False),
    sa.Column("started_at", _Time),
    sa.Column("ended_at", _Time),
    sa.Column("beat_at", _Time),  # its runner last wrote
    sa.Index("jobs_of_status", "status", "seq"),
    sqlite_autoincrement=True,
)
"""Computations that take longer than a request may."""

events = sa.Table(
    "events",
    metadata,
    sa.Column("id", sa.BigInteger, primary_key=True, autoincrement=False),
    sa.Column("kind", sa.String(32), nullable=False),
    sa.Column("rig", sa.Text, nullable=False),
    sa.Column("payload", sa.Text, nullable=False),
)
"""What the event stream tells, the newest few thousand."""
