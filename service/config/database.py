"""``service.database``: where metadata is kept, if not in the store's own folder. No password stands in plant.toml."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from service.config.plant import PASSWORD_VARIABLE, DatabaseAddress
from valve.messages import say

if TYPE_CHECKING:
    from service.config.errors import Findings

DRIVER: Final = "postgresql+psycopg"
_EXAMPLE: Final = f"{DRIVER}://breakaway@127.0.0.1/breakaway"


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
