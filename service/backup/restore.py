"""A backup taken back: into an empty store, while no service has it, and so that nothing moves because of it."""

from __future__ import annotations

import shutil
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from sqlalchemy import Connection, Table, delete, func, select, text
from sqlalchemy.exc import SQLAlchemyError

from drivers.motion.audit_log import AuditLog
from drivers.motion.synced import sync_folder
from service.backup.backup import DATABASE, Manifest, copy_rows, unpack, verified
from service.config.plant import Plant
from service.model.analysis import is_to_be_taken_up
from service.model.run import RunState
from service.runs.recovery import mark_interrupted
from service.store.database import open_database, refuse_newer
from service.store.gateway_lock import GatewayLock
from service.store.lock import StoreLock
from service.store.schema import TABLES
from service.store.schema_access import SESSIONS
from service.store.schema_tests import TESTS
from service.store.store import Store
from valve.errors import ConfigurationError, RequestError
from valve.messages import say

_STAGING: Final = ".restore"
_PARTS: Final = ("recordings", "journals", "audit")
# More tests than a plant of 5,000 valves makes in half a year of nights. A device is fenced by a test's number: one
# that was given after the backup must not be given again.
_NUMBERS_LEFT_OUT: Final = 1_000_000
_UNFINISHED: Final = (RunState.QUEUED, RunState.RUNNING, RunState.ANALYZING)
_CUT_OFF: Final = "this test was under way when the backup was made that the store was restored from"
_NOT_SEEN: Final = "; nobody has looked at the valve since: look at it"


def restore_backup(plant: Plant, file: Path, *, who: str, files_only: bool = False) -> Manifest:
    """Make a plant's store of a backup; everything is checked before anything is written.

    ``files_only`` leaves the database alone: recordings, journals and audit log of a gateway whose PostgreSQL database
    is there. Tests that were under way are marked as interrupted: no valve is moved for them later. Sessions are ended.

    Raises BusyError where a service has the store, RequestError where the store is not empty or the archive is not
    whole, ConfigurationError where a newer version made it or the database cannot be used.
    """
    folder, address = plant.service.store, plant.service.database
    if files_only and address is None:
        raise RequestError(
            say(
                "files_only_needs_database",
                "--files-only is for a plant with service.database: SQLite's database is one of the files",
            )
        )
    with ExitStack() as held:
        lock = StoreLock(folder / "lock")
        held.callback(lock.release)
        if (folder / "lock").exists():
            lock.acquire()
        _require_empty(folder)
        made = verified(file)
        refuse_newer(made.revision, str(file))
        if made.gateway != plant.service.gateway:
            raise RequestError(
                say(
                    "backup_of_other_gateway",
                    "{file}: it is of {made_by}, {plant} says {gateway}: take that gateway's backup and its plant file",
                    file=str(file),
                    made_by=_named(made.gateway),
                    plant=plant.file.name,
                    gateway=_named(plant.service.gateway),
                )
            )
        staging = folder / _STAGING
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not (folder / "lock").exists():
                lock.acquire()
            shutil.rmtree(staging, ignore_errors=True)
            held.callback(shutil.rmtree, staging, ignore_errors=True)
            staging.mkdir(mode=0o700)
            unpack(file, staging)
            _settle(staging, made, plant, who=who, files_only=files_only)
            if not files_only and address is not None:
                _fill(plant, staging / DATABASE)
            _move(staging, folder, with_database=address is None)
        except OSError as error:
            raise RequestError(
                say(
                    "store_unwritable",
                    "{folder}: the store cannot be written ({reason}): free disk space or make it writable, empty "
                    "it, and repeat the command",
                    folder=str(folder),
                    reason=str(error.strerror),
                )
            ) from error
    return made


def _named(gateway: str) -> str:
    if not gateway:
        return say("plant_of_one_gateway", "a plant of one gateway")
    return say("gateway_named", "gateway {gateway}", gateway=repr(gateway))


def _require_empty(folder: Path) -> None:
    """Raise RequestError where a store's folder holds anything; the lock and an attempt that was cut off count not."""
    if not folder.is_dir():
        return
    for path in sorted(folder.rglob("*")):
        inner = path.relative_to(folder).parts
        if inner[0] not in ("lock", _STAGING) and (not path.is_dir() or inner[0] not in (*_PARTS, "uploads")):
            raise RequestError(
                say(
                    "store_not_empty",
                    "{folder}: the store is not empty ({inner:/} is there), nothing was restored: move it away, or "
                    "name another folder as service.store",
                    folder=str(folder),
                    inner=tuple(inner),
                )
            )


def _settle(staging: Path, made: Manifest, plant: Plant, *, who: str, files_only: bool) -> None:
    """Bring what was unpacked to rest, and note it in the audit log."""
    if files_only:
        (staging / DATABASE).unlink()
    else:
        with closing(Store(staging)) as store:  # its schema becomes this version's
            _mark_unfinished(store, made.gateway)
            with store.engine.begin() as connection:
                connection.execute(delete(SESSIONS))
                _leave_numbers_out(connection)
    details = {"made_at": made.made_at.isoformat(), "software": made.software, "files_only": files_only}
    gateway = plant.service.gateway or "gateway"
    AuditLog(staging / "audit", gateway).append("backup.restored", who=who, details=details)


def _mark_unfinished(store: Store, gateway: str) -> None:
    """Mark tests that were under way; only a whole recording's analysis is left to the service, which moves nothing."""
    for run in store.runs.in_states(_UNFINISHED):
        if is_to_be_taken_up(run, is_kept=store.recording_path(run.id).is_file()):
            continue
        marked = mark_interrupted(store, run)
        commanded = marked.commanded
        if run.commanded is None and run.gateway not in ("", gateway):
            commanded = None  # the journal that would show it is that gateway's
        unsafe = commanded is not False and run.safe_confirmed is not True
        changes: dict[str, Any] = {"safe_confirmed": False} if unsafe else {}
        error = _CUT_OFF + (_NOT_SEEN if unsafe else "")
        store.runs.save(replace(marked, commanded=commanded, error=error, **changes))


def _leave_numbers_out(connection: Connection) -> None:
    highest = connection.execute(select(func.max(TESTS.c.number))).scalar_one() or 0
    given = connection.execute(text("SELECT max(seq) FROM sqlite_sequence WHERE name = 'tests'")).scalar_one() or 0
    connection.execute(text("DELETE FROM sqlite_sequence WHERE name = 'tests'"))
    values = {"next": max(highest, given) + _NUMBERS_LEFT_OUT}
    connection.execute(text("INSERT INTO sqlite_sequence (name, seq) VALUES ('tests', :next)"), values)


def _fill(plant: Plant, staged: Path) -> None:
    """Copy the rows of a staged database into the plant's own, which is empty; all of them or none."""
    assert plant.service.database is not None
    engine, source = open_database(plant.service.database.with_password()), open_database(f"sqlite:///{staged}")
    lock = GatewayLock(engine, plant.service.gateway)
    shown = engine.url.render_as_string(hide_password=True)
    try:
        lock.acquire()
        with engine.begin() as target, source.connect() as rows:
            for table in TABLES:
                target.execute(text(f"LOCK TABLE {table.name} IN EXCLUSIVE MODE"))
                if target.execute(select(table.primary_key.columns[0]).limit(1)).first() is not None:
                    raise RequestError(
                        say(
                            "database_not_empty",
                            "{database}: the database is not empty (its table {table} has rows), nothing was "
                            "restored: name an empty one as service.database, or say --files-only where the database "
                            "is to stay",
                            database=shown,
                            table=table.name,
                        )
                    )
            copy_rows(rows, target)
            next_test = rows.execute(text("SELECT seq FROM sqlite_sequence WHERE name = 'tests'")).scalar_one()
            for table in TABLES:
                _continue_numbers(target, table, next_test)
    except SQLAlchemyError as error:
        reason = " ".join(str(getattr(error, "orig", None) or error).split())
        raise ConfigurationError(
            say(
                "database_unfilled",
                "{database}: the database cannot be filled ({reason}): mend that, and repeat",
                database=shown,
                reason=reason,
            )
        ) from error
    finally:
        lock.release()
        source.dispose()
        engine.dispose()


def _continue_numbers(target: Connection, table: Table, next_test: int) -> None:
    """Let PostgreSQL number new rows behind those that were copied."""
    key = table.autoincrement_column
    if key is None:
        return
    highest = target.execute(select(func.max(key))).scalar_one() or 0
    name = target.execute(text("SELECT pg_get_serial_sequence(:t, :c)"), {"t": table.name, "c": key.name}).scalar_one()
    last = next_test if table is TESTS else highest
    if name is not None and last > 0:
        target.execute(text("SELECT setval(:name, :last)"), {"name": name, "last": last})


def _move(staging: Path, folder: Path, *, with_database: bool) -> None:
    """Give what is staged its name; the database last, without it a store is not there."""
    for part in _PARTS:
        if (staging / part).is_dir():
            if (folder / part).is_dir():
                shutil.rmtree(folder / part)  # empty, perhaps with empty folders
            (staging / part).rename(folder / part)
    if with_database:
        for path in sorted(staging.glob(f"{DATABASE}*"), reverse=True):  # SQLite's own log of it too, if there is one
            path.rename(folder / path.name)
    for path in (folder, folder.parent):
        sync_folder(path)
