"""Opening the store: a new one is made, and what is not ours is refused in one line and left as it is."""

import sqlite3
import threading
import uuid

import pytest
import sqlalchemy as sa
from sqlalchemy.dialects import postgresql

from creak.errors import ConfigurationError, StorageError
from creak.sinks import tables
from creak.sinks.database import open_store
from creak.sinks.operator_tables import leases
from store_places import SERVER, place
from store_records import fill_beam


@pytest.fixture
def url(tmp_path):
    return f"sqlite:///{tmp_path}/var/creak.db"


def count(store, table):
    with store.read() as connection:
        return connection.execute(sa.select(sa.func.count()).select_from(table)).scalar_one()


def test_newer_database_is_refused_and_left_alone(url, tmp_path):
    store = open_store(url)
    with store.write() as connection:
        connection.execute(sa.update(tables.schema).values(version=99))
    store.close()
    path = tmp_path / "var/creak.db"
    before = path.read_bytes()
    with pytest.raises(
        ConfigurationError, match=rf"creak\.toml: store\.url: .*version 99.*up to {tables.SCHEMA_VERSION}"
    ):
        open_store(url, source="creak.toml", key="store.url")
    assert path.read_bytes() == before


def test_database_of_something_else_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "other.db"
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE invoices (id)")
    other.close()
    before = path.read_bytes()
    with pytest.raises(ConfigurationError, match=r"something else \(invoices"):
        open_store(f"sqlite:///{path}")
    assert path.read_bytes() == before


def damage(path, how):
    data = bytearray(path.read_bytes())
    if how == "a page of noise":
        data[40960:45056] = bytes(range(256)) * 16
    elif how == "cut":
        data = data[: len(data) // 2]
    elif how == "the list of tables":
        data[100:4096] = b"\xff" * 3996
    path.write_bytes(data)


@pytest.mark.parametrize("how", ["a page of noise", "cut", "the list of tables"])
def test_damaged_database_is_refused_left_alone_and_told_what_to_do_about(url, tmp_path, how):
    """Kills a service that begins on half a history, and one that writes into it."""
    store = open_store(url)
    fill_beam(store)
    store.close()
    path = tmp_path / "var/creak.db"
    damage(path, how)
    before = path.read_bytes()
    with pytest.raises(ConfigurationError, match=r"^creak\.toml: store\.url: .*malformed.*\.recover") as caught:
        open_store(url, source="creak.toml", key="store.url")
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before


def test_file_that_is_no_database_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("not a database at all\n" * 200)
    with pytest.raises(ConfigurationError, match="is not a database"):
        open_store(f"sqlite:///{path}")
    assert path.read_text() == "not a database at all\n" * 200


@pytest.mark.parametrize(
    "bad", ["", "creak.db", "sqlite://", "sqlite:///:memory:", "nosuch:///x", "postgresql+nosuch://h/d", "mysql:"]
)
def test_url_of_no_store_is_one_clear_line(bad):
    with pytest.raises(ConfigurationError, match=r"^creak\.toml: store\.url: ") as caught:
        open_store(bad, source="creak.toml", key="store.url")
    assert "\n" not in str(caught.value)


def test_path_that_cannot_be_opened_is_one_clear_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot be made"):
        open_store(f"sqlite:///{tmp_path}/file/creak.db")
    with pytest.raises(ConfigurationError, match="is a directory"):
        open_store(f"sqlite:///{tmp_path}")


def test_new_store_opened_by_many_at_once(url):
    """Kills a race between API and worker that both find the store empty."""
    stores, failures = [], []

    def attempt():
        try:
            stores.append(open_store(url))
        except Exception as error:  # noqa: BLE001 - reported below
            failures.append(error)

    threads = [threading.Thread(target=attempt) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert count(stores[0], tables.schema) == 1
    for store in stores:
        store.close()


def test_tables_can_be_made_on_postgresql():
    """Kills a type or default that only SQLite knows."""
    dialect = postgresql.dialect()
    for table in tables.metadata.sorted_tables:
        text = str(sa.schema.CreateTable(table).compile(dialect=dialect))
        assert "AUTOINCREMENT" not in text
    assert "BIGSERIAL" in str(sa.schema.CreateTable(tables.levels).compile(dialect=dialect))


def test_a_database_without_an_encoding_is_used_as_any_other():
    """SQL_ASCII, as of a server that was made without a locale: it answered in bytes."""
    name = f"creak_{uuid.uuid4().hex}"
    with place("postgresql", None):  # skips where there is no server
        server = sa.create_engine(SERVER, isolation_level="AUTOCOMMIT")
        with server.connect() as connection:
            connection.exec_driver_sql(
                f"CREATE DATABASE {name} ENCODING 'SQL_ASCII' LC_COLLATE 'C' LC_CTYPE 'C' TEMPLATE template0"
            )
        try:
            url = sa.make_url(SERVER).set(database=name)
            store = open_store(url.render_as_string(hide_password=False))
            with store.write() as connection:
                connection.execute(sa.insert(leases).values(name="x", owner="Gehäuse µ", until_at=1))
            with store.read() as connection:
                assert connection.execute(sa.select(leases.c.owner)).scalar_one() == "Gehäuse µ"
            store.close()
        finally:
            with server.connect() as connection:
                connection.exec_driver_sql(f"DROP DATABASE {name} WITH (FORCE)")
            server.dispose()
