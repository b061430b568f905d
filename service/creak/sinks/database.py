"""The store as a database: opened, checked, and its two kinds of transaction."""

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Any, Literal, Protocol

import sqlalchemy as sa
from sqlalchemy.exc import ArgumentError, NoSuchModuleError, SQLAlchemyError

from creak.errors import ConfigurationError, StorageError
from creak.sinks import migrations, tables

Mode = Literal["read", "durable", "status"]

_READER_WAIT_MS = 5_000
_MODE = "creak_mode"
_CREATION_LOCK = 0x637265616B  # any constant will do: "creak"


class Writing(Protocol):
    """What a sink needs of a store."""

    def write(self, durable: bool = True) -> AbstractContextManager[sa.Connection]:
        """As `Store.write`."""
        ...


class Store:
    """An open store; safe to share between threads.

    Parameters
    ----------
    engine : sqlalchemy.Engine
        Made by `open_store`, which is what callers use.
    label : str
        What error messages call it: its URL without the password.
    """

    def __init__(self, engine: sa.Engine, label: str) -> None:
        self.label = label
        self._engine = engine
        # on PostgreSQL several statements of one read see one moment only from "repeatable read" upwards
        snapshot: dict[str, Any] = (
            {"isolation_level": "REPEATABLE READ"} if engine.dialect.name == "postgresql" else {}
        )
        self._engines: dict[Mode, sa.Engine] = {
            "read": engine.execution_options(**{_MODE: "read"}, **snapshot),
            "durable": engine.execution_options(**{_MODE: "durable"}),
            "status": engine.execution_options(**{_MODE: "status"}),
        }
        # SQLite lets a waiting writer try again now and then, so of a hundred some wait for half a minute
        self._turn = threading.Lock() if engine.dialect.name == "sqlite" else nullcontext()
        self._witness: Any = None  # a connection that never writes, and so sees all that is written

    @contextmanager
    def read(self) -> Iterator[sa.Connection]:
        """Give a connection on which all statements see the same moment.

        Raises
        ------
        StorageError
            If the store cannot be read.
        """
        with self._transaction("read") as connection:
            yield connection

    @contextmanager
    def write(self, durable: bool = True) -> Iterator[sa.Connection]:
        """Give a connection whose statements all come about at the end of the block, or none of them.

        Parameters
        ----------
        durable : bool
            True: on disk before the block ends, whatever happens to the machine then. False: for what is
            written again within seconds, and may be lost with the power, though never half.

        Raises
        ------
        StorageError
            If the store cannot be written.
        """
        with self._turn, self._transaction("durable" if durable else "status") as connection:
            yield connection

    def version(self) -> int | None:
        """Return a number that is another one after anything was written; takes microseconds and never waits.

        To be called from one thread. None where the database does not tell, as PostgreSQL does not.

        Raises
        ------
        StorageError
            If the store cannot be read.
        """
        if self._engine.dialect.name != "sqlite":
            return None
        try:
            if self._witness is None:
                self._witness = self._engine.raw_connection()
                self._witness.detach()
                self._witness.execute("PRAGMA busy_timeout = 0")
            return int(self._witness.execute("PRAGMA data_version").fetchone()[0])
        except (SQLAlchemyError, self._engine.dialect.loaded_dbapi.Error) as error:
            raise StorageError(f"{self.label}: {_reason(error)}") from error

    def close(self) -> None:
        """Release all connections."""
        if self._witness is not None:
            self._witness.close()
        self._engine.dispose()

    @contextmanager
    def _transaction(self, mode: Mode) -> Iterator[sa.Connection]:
        try:
            with self._engines[mode].begin() as connection:
                yield connection
        except SQLAlchemyError as error:
            raise StorageError(f"{self.label}: {_reason(error)}") from error


def open_store(url: str, *, source: str = "store", key: str = "url") -> Store:
    """Open the store, and make its tables if it is new.

    Parameters
    ----------
    url : str
        ``sqlite:///path`` or ``postgresql+psycopg://...``.
    source, key : str
        Where the URL was given, for error messages.

    Raises
    ------
    ConfigurationError
        If the URL is none that can be used, or names a database that is not this program's or of a newer version;
        such a database is left as it is.
    StorageError
        If the database cannot be reached, opened or written.
    """
    try:
        address = sa.make_url(url)
        label = address.render_as_string(hide_password=True)
        if address.get_backend_name() == "sqlite":
            engine = _sqlite(address, source, key)
        else:
            # Said, because a database without an encoding of its own (SQL_ASCII) would answer in bytes.
            words = {"client_encoding": "utf8"}
            engine = sa.create_engine(
                address, pool_size=8, max_overflow=32, pool_pre_ping=True, connect_args=words
            )
    except (ArgumentError, NoSuchModuleError, ImportError) as error:
        problem = f"not a store that can be used ({_reason(error)}); allowed are sqlite:///path and postgresql+psycopg://..."
        raise ConfigurationError(source, key, problem) from error
    _listen(engine)
    store = Store(engine, label)
    try:
        _adopt(store, source, key)
    except BaseException:
        store.close()
        raise
    return store


def _sqlite(address: sa.URL, source: str, key: str) -> sa.Engine:
    if address.database in {None, "", ":memory:"}:
        raise ConfigurationError(source, key, "a store in memory cannot be shared; give a file: sqlite:///path")
    path = Path(str(address.database))
    if path.is_dir():
        raise ConfigurationError(source, key, f"{path} is a directory; the store is a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{path}: the store's directory cannot be made: {error.strerror}") from error
    return sa.create_engine(address, pool_size=8, max_overflow=32)


def _listen(engine: sa.Engine) -> None:
    """Set every connection up, and begin each transaction in the manner of its mode."""
    backend = engine.dialect.name

    def connected(connection: Any, _record: object) -> None:
        if backend == "sqlite":
            connection.isolation_level = (
                None  # transactions begin as the next function says, not as sqlite3 guesses
            )
            cursor = connection.cursor()
            cursor.execute(f"PRAGMA busy_timeout = {_READER_WAIT_MS}")
            cursor.execute("PRAGMA foreign_keys = ON")
            cursor.close()

    def begin(connection: sa.Connection) -> None:
        mode = connection.get_execution_options().get(_MODE, "read")
        if backend == "sqlite":
            if mode == "read":
                connection.exec_driver_sql("BEGIN")
                return
            connection.exec_driver_sql(f"PRAGMA synchronous = {'FULL' if mode == 'durable' else 'NORMAL'}")
            # a transaction that begins by reading and then writes fails at once if another has written meanwhile;
            # one that begins as a writer waits for its turn
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        elif backend == "postgresql" and mode == "status":
            connection.exec_driver_sql("SET LOCAL synchronous_commit = off")

    sa.event.listen(engine, "connect", connected)
    sa.event.listen(engine, "begin", begin)


def _adopt(store: Store, source: str, key: str) -> None:
    """Make the tables of a new store, bring up those of an older one, and leave any other alone.

    Any other: one of something else, of a newer version, or damaged.
    """
    try:
        _check(store)
        with store.read() as connection:
            current = _version(connection, source, key) == tables.SCHEMA_VERSION
    except StorageError as error:
        if "not a database" in str(error):
            problem = f"{store.label} is not a database; it is left as it is"
            raise ConfigurationError(source, key, problem) from error
        if "malformed" in str(error):
            problem = (
                f"{error}; it is left as it is: put a copy from before in its place, or save what can be read "
                'with sqlite3 OLD ".recover" | sqlite3 NEW, or give another store'
            )
            raise ConfigurationError(source, key, problem) from error
        raise
    with store._engine.connect() as connection:
        _write_ahead(connection, store)
    if current:
        return
    with store.write() as connection:
        if connection.dialect.name == "postgresql":
            connection.execute(sa.text("SELECT pg_advisory_xact_lock(:key)"), {"key": _CREATION_LOCK})
        version = _version(connection, source, key)  # another process may have been quicker
        if version is None:
            migrations.create(connection)
        elif version < tables.SCHEMA_VERSION:
            migrations.migrate(connection, version)


def _check(store: Store) -> None:
    """Read all of an SQLite file: damage is known before anything is written, and not when it is met.

    Raises
    ------
    StorageError
        If it is damaged.
    """
    if store._engine.dialect.name != "sqlite":
        return
    with store.read() as connection:
        found = str(connection.exec_driver_sql("PRAGMA quick_check(1)").scalar_one())
    if found != "ok":
        raise StorageError(f"{store.label}: the database is malformed ({' '.join(found.split())})")


def _version(connection: sa.Connection, source: str, key: str) -> int | None:
    """Return the version of the tables, None for an empty database."""
    names = sa.inspect(connection).get_table_names()
    if not names:
        return None
    if tables.schema.name not in names:
        problem = f"the database holds tables of something else ({min(names)}, ...); it is left as it is"
        raise ConfigurationError(source, key, problem)
    version = int(connection.execute(sa.select(sa.func.max(tables.schema.c.version))).scalar_one())
    if version > tables.SCHEMA_VERSION:
        problem = (
            f"the database is of version {version}, this creak knows versions up to {tables.SCHEMA_VERSION}: "
            "use a newer creak or another database; it is left as it is"
        )
        raise ConfigurationError(source, key, problem)
    return version


def _write_ahead(connection: sa.Connection, store: Store) -> None:
    """Let readers and the writer of an SQLite file not wait for each other; kept in the file once set."""
    if connection.dialect.name != "sqlite":
        return
    raw = connection.connection
    try:
        cursor = raw.cursor()
        mode = cursor.execute("PRAGMA journal_mode").fetchone()[0]
        if mode != "wal":
            mode = cursor.execute("PRAGMA journal_mode = WAL").fetchone()[0]
        cursor.close()
    except store._engine.dialect.loaded_dbapi.Error as error:
        raise StorageError(f"{store.label}: {error}") from error
    if mode != "wal":
        raise StorageError(f"{store.label}: the file system does not allow a shared write-ahead log")


def _reason(error: Exception) -> str:
    """Return the database's own words, one line."""
    cause = getattr(error, "orig", None) or error
    return " ".join(str(cause).split()) or type(cause).__name__
