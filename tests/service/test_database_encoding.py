from __future__ import annotations

import secrets

import psycopg
import pytest

from service.config.plant import DatabaseAddress
from service.store.database import open_database
from tests.support.databases import SERVER, why_no_server


@pytest.mark.skipif(bool(why_no_server()), reason=why_no_server() or "there is one")
def test_a_database_without_an_encoding_of_its_own_is_used_as_any_other() -> None:
    name = f"breakaway_test_{secrets.token_hex(6)}"
    with psycopg.connect(f"{SERVER}/postgres", autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE \"{name}\" TEMPLATE template0 ENCODING 'SQL_ASCII' LOCALE 'C'")
        try:
            address = DatabaseAddress(f"{SERVER.replace('postgresql://', 'postgresql+psycopg://')}/{name}")
            engine = open_database(address.with_password({}))
            with engine.connect() as opened:
                assert opened.exec_driver_sql("SELECT 'Übergabe'").scalar_one() == "Übergabe"
            engine.dispose()
        finally:
            connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


def test_an_encoding_that_the_address_names_stays() -> None:
    address = DatabaseAddress("postgresql+psycopg://b@127.0.0.1/b?client_encoding=latin1")
    assert address.with_password({}).query["client_encoding"] == "latin1"
