"""Where the store's tests run: a file, and a schema of its own on a real PostgreSQL server."""

import contextlib
import os
import uuid

import pytest
import sqlalchemy as sa
from sqlalchemy.exc import OperationalError

SERVER = os.environ.get("CREAK_TEST_POSTGRES", "postgresql+psycopg://postgres@127.0.0.1:5432/test")
PLACES = ("sqlite", "postgresql")


@contextlib.contextmanager
def place(kind, directory):
    """The URL of an empty database."""
    if kind == "sqlite":
        yield f"sqlite:///{directory}/var/creak.db"
        return
    schema = f"creak_{uuid.uuid4().hex}"
    server = sa.create_engine(SERVER, connect_args={"connect_timeout": 3})
    try:
        with server.begin() as connection:
            connection.exec_driver_sql(f"CREATE SCHEMA {schema}")
    except (OperationalError, ImportError) as error:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(f"no PostgreSQL server to test with: {str(error).splitlines()[0]}")
    try:
        yield f"{SERVER}?options=-csearch_path%3D{schema}"
    finally:
        with server.begin() as connection:
            connection.exec_driver_sql(f"DROP SCHEMA {schema} CASCADE")
        server.dispose()
