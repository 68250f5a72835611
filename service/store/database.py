"""The database: opened, checked and brought to the present schema."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from alembic.util import CommandError
from sqlalchemy import Engine, create_engine, event, make_url, text
from sqlalchemy.exc import SQLAlchemyError

from valve.errors import ConfigurationError


def _keep_sqlite_durable(connection: Any, _record: object) -> None:
    cursor = connection.cursor()
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA foreign_keys=ON")
    # FULL: a commit has reached the disk, so an intent that was answered survives a power cut.
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.close()


def migrate(engine: Engine) -> None:
    """Bring the database to the newest revision; nothing happens where it is there already."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent / "migrations").replace("%", "%%"))
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, "head")


def open_database(url: str) -> Engine:
    """Open the database at a SQLAlchemy ``url``, check it and migrate it.

    Raises ConfigurationError where it cannot be opened, is damaged or is newer than this version.
    """
    parsed = make_url(url)
    subject = parsed.database or parsed.render_as_string(hide_password=True)
    is_sqlite = parsed.get_backend_name() == "sqlite"
    engine = create_engine(
        parsed,
        connect_args={"timeout": 10.0} if is_sqlite else {},
        json_serializer=partial(json.dumps, allow_nan=False),  # what is no number is null, and said so by its writer
    )
    try:
        if is_sqlite:
            event.listen(engine, "connect", _keep_sqlite_durable)
            with engine.connect() as connection:
                verdict = connection.execute(text("PRAGMA quick_check")).scalar_one()
            if verdict != "ok":
                raise ConfigurationError(f"{subject}: the database is damaged ({verdict}): restore it from a backup")
        migrate(engine)
    except (SQLAlchemyError, CommandError) as error:
        engine.dispose()
        reason = str(getattr(error, "orig", None) or error).split("\n", maxsplit=1)[0]
        raise ConfigurationError(
            f"{subject}: the database cannot be used ({reason}): restore it from a backup, "
            "or name another folder as service.store"
        ) from error
    except ConfigurationError:
        engine.dispose()
        raise
    return engine
