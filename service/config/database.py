"""``service.database``: where metadata is kept, if not in the store's own folder. No password stands in plant.toml."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from service.config.secret_file import read_secret
from valve.messages import say

if TYPE_CHECKING:
    from sqlalchemy import URL

    from service.config.errors import Findings

PASSWORD_VARIABLE: Final = "BREAKAWAY_DATABASE_PASSWORD"
DRIVER: Final = "postgresql+psycopg"
_EXAMPLE: Final = f"{DRIVER}://breakaway@127.0.0.1/breakaway"


@dataclass(frozen=True, slots=True)
class DatabaseAddress:
    """A PostgreSQL database, without its password, and the file that holds it, if any."""

    url: str
    password_file: Path | None = None

    def with_password(self, environment: Mapping[str, str] = os.environ) -> URL:
        """Return the address with its password: of the file, else of the environment, else without one.

        Raises ConfigurationError where the file cannot be read or others may read it; no message holds the password.
        """
        from sqlalchemy import make_url

        url = make_url(self.url)
        if "client_encoding" not in url.query:  # a server whose own is SQL_ASCII would answer in bytes
            url = url.update_query_dict({"client_encoding": "utf8"})
        if self.password_file is None:
            password = environment.get(PASSWORD_VARIABLE)
        else:
            password = read_secret(self.password_file, "service.database_password_file")
        return url.set(password=password) if password else url


def database_address(
    findings: Findings, url: str | None, password_file: str | None, folder: Path
) -> DatabaseAddress | None:
    """Return what plant.toml says of the database; None where it names none or a fault was noted."""
    key = ("service", "database")
    file = None if password_file is None else (folder / password_file).resolve()
    if url is None:
        if file is not None:
            findings.add(
                ("service", "database_password_file"),
                password_file,
                say("no_service_database", "there is no service.database"),
                say("remove_it", "remove it"),
            )
        return None
    from sqlalchemy import make_url
    from sqlalchemy.exc import ArgumentError

    try:
        parsed = make_url(url)
    except (ArgumentError, ValueError):
        findings.add(
            key,
            "(not shown)",
            say("no_database_address", "it is no database address"),
            say("give_database_address", "give one such as {example}", example=_EXAMPLE),
        )
        return None
    shown = parsed.render_as_string(hide_password=True)
    if parsed.password is not None:
        findings.add(
            key,
            shown,
            say("password_in_address", "a password stands in it, and plant.toml is no secret"),
            say(
                "move_the_password",
                "remove it and set {variable}, or name a file of mode 0600 as service.database_password_file",
                variable=PASSWORD_VARIABLE,
            ),
        )
    elif parsed.drivername != DRIVER or not parsed.database:
        findings.add(
            key,
            shown,
            say("no_driver_address", "it is no {driver} address with a database's name", driver=DRIVER),
            say(
                "give_address_or_none",
                "give one such as {example}; without service.database the metadata is kept by SQLite in service.store",
                example=_EXAMPLE,
            ),
        )
    else:
        return DatabaseAddress(url, file)
    return None
