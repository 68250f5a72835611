"""Databases for tests: SQLite in a folder, and a PostgreSQL database of the test's own, dropped at its end."""

from __future__ import annotations

import os
import secrets
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import psycopg
import pytest
from sqlalchemy import Engine, create_engine, inspect

from service.store.database import migrate

SERVER = os.environ.get("BREAKAWAY_TEST_POSTGRESQL", "postgresql://postgres@127.0.0.1:5432")


@cache
def why_no_server() -> str:
    """Return why no PostgreSQL server can be used; "" where one can."""
    try:
        with psycopg.connect(f"{SERVER}/postgres", connect_timeout=3) as connection:
            row = connection.execute("SELECT rolcreatedb FROM pg_roles WHERE rolname = current_user").fetchone()
    except psycopg.OperationalError as error:
        return " ".join(str(error).split())[:120]
    return "" if row is not None and row[0] else "its user may not create databases"


@contextmanager
def postgresql_database() -> Iterator[str]:
    """Hand out the address of a new, empty database; it is dropped at the end."""
    if why_no_server():
        pytest.skip(f"no PostgreSQL server at {SERVER.rpartition('@')[2]}: {why_no_server()}")
    name = f"breakaway_test_{secrets.token_hex(6)}"
    with psycopg.connect(f"{SERVER}/postgres", autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}" TEMPLATE template0')
    try:
        yield f"{SERVER.replace('postgresql://', 'postgresql+psycopg://')}/{name}"
    finally:
        with psycopg.connect(f"{SERVER}/postgres", autocommit=True) as connection:
            connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


@cache
def _migrated() -> sqlite3.Connection:
    """Return a database in memory that the migrations made."""
    made = sqlite3.connect(":memory:", check_same_thread=False)
    migrate(create_engine("sqlite://", creator=lambda: made))
    return made


def migrate_by_copy(engine: Engine) -> None:
    """Migrate as the service does, an empty SQLite file by a copy: a thousand tests have a store, and few ask how."""
    if engine.dialect.name != "sqlite" or inspect(engine).get_table_names():
        migrate(engine)
        return
    connection = engine.raw_connection()
    try:
        file = connection.driver_connection
        assert isinstance(file, sqlite3.Connection)
        _migrated().backup(file)
    finally:
        connection.close()
