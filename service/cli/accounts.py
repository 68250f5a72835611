"""The store's accounts as the commands ``user`` and ``token`` reach them: the service may run meanwhile, or not.

Both work on the database itself, so whoever may write the store may do it: that is how the first admin is made.
"""

from __future__ import annotations

import getpass
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer

from drivers.motion.audit_log import AuditLog
from service.access.access import Access, access_of
from service.config.plant import Plant
from service.config.settings import load_plant
from service.store.database import open_database
from valve.errors import ConfigurationError, RequestError
from valve.messages import say

Config = Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object.")]
PASSWORD_VARIABLE: Final = "BREAKAWAY_PASSWORD"


@contextmanager
def accounts(config: Path) -> Iterator[tuple[Access, Plant]]:
    """Open the accounts of a plant, and its audit log."""
    plant = load_plant(config)
    settings = plant.service
    try:
        settings.store.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            say(
                "store_folder_unmade",
                "{store}: the folder cannot be made ({reason}): make it, or correct service.store",
                store=str(settings.store),
                reason=str(error.strerror),
            )
        ) from error
    url = None if settings.database is None else settings.database.with_password()
    engine = open_database(url or f"sqlite:///{settings.store / 'breakaway.db'}")
    try:
        audit = AuditLog(settings.store / "audit", settings.gateway or "gateway")
        yield access_of(engine, settings.access, audit), plant
    finally:
        engine.dispose()


def caller() -> str:
    """Return who runs this command, for the audit log."""
    try:
        return f"command line ({getpass.getuser()})"[:64]
    except (KeyError, OSError):  # a container's user without a name
        return f"command line (uid {os.getuid()})"


def asked_password(name: str) -> str:
    """Return a new password: from the environment, or typed twice. Raises RequestError where the two differ."""
    given = os.environ.get(PASSWORD_VARIABLE)
    if given is not None:
        return given
    try:
        first = getpass.getpass(f"New password of {name}: ")
        second = getpass.getpass("The same again: ")
    except EOFError:
        raise RequestError(
            say(
                "no_password_typed",
                "user {name}: no password was typed: type it, set {variable}, or say --generate",
                name=name,
                variable=PASSWORD_VARIABLE,
            )
        ) from None
    if first != second:
        raise RequestError(
            say(
                "passwords_differ",
                "user {name}: the two passwords differ, nothing was changed: repeat the command",
                name=name,
            )
        )
    return first
