"""The database: opened, checked and brought to the present schema. SQLite in the store's folder, or PostgreSQL."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any, Final

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import URL, Connection, Engine, create_engine, event, make_url, text
from sqlalchemy.exc import SQLAlchemyError

from valve.errors import ConfigurationError
from valve.messages import say

_CONNECT_TIMEOUT_S: Final = 10
_POOL: Final = 10
# A server that is lost without a word frees the threads that ask it after half a minute (libpq, 34.1.2).
_LOST_LINE: Final = {
    "keepalives_idle": 10,
    "keepalives_interval": 5,
    "keepalives_count": 4,
    "tcp_user_timeout": 30_000,
}
_LONGEST_STATEMENT_MS: Final = 60_000
# Own choice of a number that nobody else in the database locks: "breakaw" in ASCII.
_MIGRATION_LOCK: Final = 0x627265616B6177


def _keep_sqlite_durable(connection: Any, _record: object) -> None:
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA foreign_keys=ON")
    # FULL: a commit has reached the disk, so an intent that was answered survives a power cut.
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.close()


def _config(connection: Connection | None = None) -> Config:
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations").replace("%", "%%"))
    if connection is not None:
        config.attributes["connection"] = connection
    return config


def newest_revision() -> str:
    """Return the schema's revision that this version makes."""
    return str(ScriptDirectory.from_config(_config()).get_current_head())


def refuse_newer(revision: str, subject: str) -> None:
    """Raise ConfigurationError where a database of this revision was made by a newer version of this software."""
    script = ScriptDirectory.from_config(_config())
    if revision not in {known.revision for known in script.walk_revisions()}:
        raise ConfigurationError(
            say(
                "database_too_new",
                "{subject}: a newer version of breakaway made this database (its schema is {revision}, this "
                "version knows up to {known}): install that version, or name another store",
                subject=subject,
                revision=revision,
                known=str(script.get_current_head()),
            )
        )


def connected(url: str | URL) -> Engine:
    """Return an engine for a database as it is: nothing is checked, and nothing migrated."""
    return _engine(make_url(url))


def migrate(engine: Engine) -> None:
    """Bring the database to the newest revision; nothing happens where it is there already.

    Raises ConfigurationError where a newer version of this software made it.
    """
    with engine.begin() as connection:
        if engine.dialect.name == "postgresql":  # two gateways may start at once
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _MIGRATION_LOCK})
        config = _config(connection)
        for head in MigrationContext.configure(connection).get_current_heads():
            refuse_newer(head, _subject(engine.url))
        command.upgrade(config, "head")


def _subject(url: URL) -> str:
    return str(url.database) if url.get_backend_name() == "sqlite" else url.render_as_string(hide_password=True)


def _engine(url: URL) -> Engine:
    serializer = partial(json.dumps, allow_nan=False)  # what is no number is null, and said so by its writer
    if url.get_backend_name() == "sqlite":
        engine = create_engine(url, connect_args={"timeout": 10.0}, json_serializer=serializer)
        event.listen(engine, "connect", _keep_sqlite_durable)
        return engine
    options = f"-c statement_timeout={_LONGEST_STATEMENT_MS} -c synchronous_commit=on -c timezone=UTC"
    return create_engine(
        url,
        connect_args={
            "connect_timeout": _CONNECT_TIMEOUT_S,
            "options": options,
            "application_name": "breakaway",
            **_LOST_LINE,
        },
        pool_size=_POOL,
        pool_pre_ping=True,  # a server that was restarted in the meantime is no fault of the request
        json_serializer=serializer,
    )


def open_database(url: str | URL) -> Engine:
    """Open the database at a SQLAlchemy ``url``, check it and migrate it.

    Raises ConfigurationError where it cannot be opened, is damaged or is newer than this version; no message holds a
    password.
    """
    parsed = make_url(url)
    is_sqlite = parsed.get_backend_name() == "sqlite"
    engine = _engine(parsed)
    try:
        if is_sqlite:
            with engine.connect() as connection:
                verdict = connection.execute(text("PRAGMA quick_check")).scalar_one()
            if verdict != "ok":
                raise ConfigurationError(
                    say(
                        "database_damaged",
                        "{subject}: the database is damaged ({verdict}): restore it from a backup",
                        subject=_subject(parsed),
                        verdict=verdict,
                    )
                )
        migrate(engine)
    except (SQLAlchemyError, CommandError) as error:
        engine.dispose()
        reason = " ".join(str(getattr(error, "orig", None) or error).split("\n", maxsplit=1)[0].split())
        remedy = say(
            "start_or_correct_database",
            "start the server, create the database or correct service.database and its password",
        )
        if is_sqlite:
            remedy = say("restore_database", "restore it from a backup, or name another folder as service.store")
        raise ConfigurationError(
            say(
                "database_unusable",
                "{subject}: the database cannot be used ({why}): {remedy}",
                subject=_subject(parsed),
                why=reason,
                remedy=remedy,
            )
        ) from error
    except ConfigurationError:
        engine.dispose()
        raise
    return engine
