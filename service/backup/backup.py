"""A backup: one archive with all that a store holds, made while the service runs or not.

::

    FILE (tar, gzip)
    ├── breakaway.db            the database, always as SQLite, whichever kind the plant has
    ├── recordings/ID.parquet   each recording that the database names and that this gateway has
    ├── journals/ID.journal     samples of tests that were under way
    ├── audit/GATEWAY.audit     the audit log
    ├── plant.toml              as it was, to be read: a restore does not write it
    └── manifest.json           the last one: bytes and SHA-256 of each of the others

An archive without its manifest was cut short. It holds the hashes of passwords and tokens, so it is of mode 0600.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import shutil
import sqlite3
import tarfile
import tempfile
import time
import zlib
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, Final

from alembic.runtime.migration import MigrationContext
from sqlalchemy import Connection, insert, select
from sqlalchemy.exc import SQLAlchemyError

from drivers.motion.audit_log import SUFFIX, AuditLog
from drivers.motion.synced import sync_folder
from service.config.plant import Plant
from service.store.database import connected, newest_revision, open_database
from service.store.schema import TABLES
from valve.errors import ConfigurationError, NotFoundError, RequestError
from valve.messages import message_of, say

SCHEMA: Final = "breakaway/backup/1"
DATABASE: Final = "breakaway.db"
MANIFEST: Final = "manifest.json"
_PLANT: Final = "plant.toml"
_ID: Final = r"[A-Za-z0-9][A-Za-z0-9._-]{0,80}"
_MEMBER: Final = re.compile(
    rf"breakaway\.db|plant\.toml|recordings/{_ID}\.parquet|journals/{_ID}\.journal|audit/{_ID}\.audit"
)
_ROWS: Final = 500  # copied at once
_BYTES: Final = 1 << 20
_LONGEST_MANIFEST: Final = 1 << 30
_BROKEN: Final = (tarfile.TarError, EOFError, ValueError, KeyError, TypeError, AttributeError, zlib.error)


@dataclass(frozen=True, slots=True)
class Manifest:
    """What an archive holds. ``files``: by name its bytes and SHA-256 (hex), in the archive's order.

    ``missing`` and ``damaged`` are recordings that the database names and that are not there, or are not what they
    were when they were stored.
    """

    made_at: datetime
    software: str
    gateway: str
    revision: str
    files: Mapping[str, tuple[int, str]]
    missing: tuple[str, ...] = ()
    damaged: tuple[str, ...] = ()

    @property
    def recordings(self) -> int:
        """How many recordings there are."""
        return sum(name.startswith("recordings/") for name in self.files)

    def to_json(self) -> dict[str, Any]:
        """Return it as it stands in the archive."""
        return {
            "schema": SCHEMA,
            "made_at": self.made_at.isoformat(),
            "software": self.software,
            "gateway": self.gateway,
            "revision": self.revision,
            "missing": self.missing,
            "damaged": self.damaged,
            "files": {name: {"bytes": size, "sha256": sha256} for name, (size, sha256) in self.files.items()},
        }


def _manifest(document: Mapping[str, Any]) -> Manifest:
    if document["schema"] != SCHEMA:
        raise ValueError(
            say(
                "manifest_schema",
                "its schema is {found}, this version reads {known}",
                found=str(document["schema"]),
                known=SCHEMA,
            )
        )
    return Manifest(
        made_at=datetime.fromisoformat(document["made_at"]),
        software=str(document["software"]),
        gateway=str(document["gateway"]),
        revision=str(document["revision"]),
        files={str(name): (int(one["bytes"]), str(one["sha256"])) for name, one in document["files"].items()},
        missing=tuple(document["missing"]),
        damaged=tuple(document["damaged"]),
    )


class _Hashed:
    """A file that is read once, with what it hashes to and how long it was."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._sha256 = hashlib.sha256()
        self.size = 0

    def read(self, size: int = -1) -> bytes:
        """Return the next bytes."""
        data = self._file.read(size)
        self._sha256.update(data)
        self.size += len(data)
        return data

    @property
    def found(self) -> tuple[int, str]:
        """Bytes and SHA-256 of what was read."""
        return self.size, self._sha256.hexdigest()


@dataclass(slots=True)
class _Archive:
    """An archive that is being written."""

    tar: tarfile.TarFile
    files: dict[str, tuple[int, str]] = field(default_factory=dict)

    def add(self, name: str, file: IO[bytes], size: int) -> str:
        """Add the first ``size`` bytes of a file; return their SHA-256."""
        about = tarfile.TarInfo(name)
        about.size, about.mode, about.mtime = size, 0o600, int(time.time())
        hashed = _Hashed(file)
        self.tar.addfile(about, hashed)
        self.files[name] = hashed.found
        return hashed.found[1]

    def add_path(self, name: str, path: Path) -> str:
        """Add a whole file; return its SHA-256. Raises FileNotFoundError."""
        with path.open("rb") as file:
            return self.add(name, file, os.fstat(file.fileno()).st_size)


def make_backup(plant: Plant, target: Path, *, software: str, who: str) -> Manifest:
    """Write a backup of a plant's store to ``target``, whole and durable, or not at all; a service may run meanwhile.

    The order makes it one moment: journals first, then the database, then the recordings that it names, which are on
    disk before the database names them. Raises RequestError where ``target`` is there or cannot be written,
    NotFoundError where there is no store, ConfigurationError where its database cannot be read.
    """
    settings = plant.service
    if settings.database is None and not (settings.store / DATABASE).is_file():
        raise NotFoundError(
            say(
                "no_store_yet",
                "{database}: there is no store yet: its service makes it",
                database=str(settings.store / DATABASE),
            )
        )
    if target.exists():
        raise RequestError(
            say(
                "backup_exists",
                "{target}: it is there already, nothing is written over: name another file",
                target=str(target),
            )
        )
    try:
        with tempfile.TemporaryDirectory(prefix=".breakaway-backup-", dir=target.absolute().parent) as name:
            part = Path(name) / "archive"
            with _new_archive(part) as archive:
                made = _written(archive, plant, Path(name), software=software, who=who)
            part.rename(target)
            sync_folder(target.absolute().parent)
    except OSError as error:
        raise RequestError(
            say(
                "backup_unwritable",
                "{target}: the backup cannot be written ({place}: {reason}): free disk space, or name a file in "
                "another folder",
                target=str(target),
                place=str(error.filename or target),
                reason=str(error.strerror),
            )
        ) from error
    return made


@contextmanager
def _new_archive(path: Path) -> Iterator[_Archive]:
    with path.open("xb") as file:
        path.chmod(0o600)
        with tarfile.open(fileobj=file, mode="w:gz", compresslevel=1) as tar:
            yield _Archive(tar)
        file.flush()
        os.fsync(file.fileno())


def _written(archive: _Archive, plant: Plant, room: Path, *, software: str, who: str) -> Manifest:
    settings, made_at = plant.service, datetime.now(UTC)
    gateway = settings.gateway or "gateway"
    AuditLog(settings.store / "audit", gateway).append("backup.made", who=who, details={"software": software})
    journals = _copied_journals(settings.store / "journals", room / "journals")
    revision = _snapshot(plant, room / DATABASE)
    archive.add_path(DATABASE, room / DATABASE)
    missing, damaged, recorded = [], [], set()
    for run_id, name, sha256, is_ours in _recordings(room / DATABASE, settings.gateway):
        try:
            if archive.add_path(f"recordings/{name}", settings.store / "recordings" / name) != sha256:
                damaged.append(run_id)
        except FileNotFoundError:
            if is_ours:
                missing.append(run_id)
        recorded.add(run_id)
    for journal in journals:
        if journal.stem not in recorded:  # it became a recording in the meantime
            archive.add_path(f"journals/{journal.name}", journal)
    for log in sorted((settings.store / "audit").glob(f"*{SUFFIX}")):
        _add_whole_lines(archive, f"audit/{log.name}", log)
    archive.add_path(_PLANT, plant.file)
    made = Manifest(made_at, software, settings.gateway, revision, archive.files, tuple(missing), tuple(damaged))
    document = json.dumps(made.to_json(), indent=1).encode()
    archive.add(MANIFEST, io.BytesIO(document), len(document))
    del archive.files[MANIFEST]
    return made


def _copied_journals(folder: Path, room: Path) -> list[Path]:
    room.mkdir()
    for journal in sorted(folder.glob("*.journal")):
        try:
            shutil.copyfile(journal, room / journal.name)
        except FileNotFoundError:  # its test has just ended
            (room / journal.name).unlink(missing_ok=True)
    return sorted(room.iterdir())


def _add_whole_lines(archive: _Archive, name: str, log: Path) -> None:
    """Add a file that grows, up to the end of its last whole line: who writes to it holds it locked for one line."""
    data = log.read_bytes()
    data = data[: data.rfind(b"\n") + 1]
    archive.add(name, io.BytesIO(data), len(data))


def _snapshot(plant: Plant, target: Path) -> str:
    """Copy the database as it is at one moment, into a SQLite file; return its revision."""
    address = plant.service.database
    if address is None:
        return _copy_sqlite(plant.service.store / DATABASE, target)
    engine, copy = connected(address.with_password()), open_database(f"sqlite:///{target}")
    try:
        with engine.connect().execution_options(isolation_level="REPEATABLE READ") as source:
            revision = ", ".join(MigrationContext.configure(source).get_current_heads())
            if revision != newest_revision():
                raise ConfigurationError(
                    say(
                        "schema_other",
                        "{url}: its schema is {revision}, this version copies {newest}: make the backup with the "
                        "version that serves it",
                        url=address.url,
                        revision=revision or "none",
                        newest=newest_revision(),
                    )
                )
            with copy.begin() as connection:
                copy_rows(source, connection)
    except SQLAlchemyError as error:
        reason = " ".join(str(getattr(error, "orig", None) or error).split())
        raise ConfigurationError(
            say(
                "database_unreadable",
                "{url}: the database cannot be read ({reason}): start the server, or correct service.database",
                url=address.url,
                reason=reason,
            )
        ) from error
    finally:
        engine.dispose()
        copy.dispose()
    return revision


def _copy_sqlite(source: Path, target: Path) -> str:
    try:
        with closing(sqlite3.connect(source, timeout=10.0)) as live, closing(sqlite3.connect(target)) as copy:
            live.backup(copy)  # in one step: whoever writes meanwhile goes on, and is not in it
            copy.execute("PRAGMA journal_mode=DELETE")
            (verdict,) = copy.execute("PRAGMA quick_check").fetchone()
            if verdict != "ok":
                raise sqlite3.DatabaseError(verdict)
            return str(copy.execute("SELECT version_num FROM alembic_version").fetchone()[0])
    except sqlite3.Error as error:
        raise ConfigurationError(
            say(
                "database_uncopied",
                "{source}: the database cannot be copied ({why}): restore it from an earlier backup",
                source=str(source),
                why=message_of(error),
            )
        ) from error


def copy_rows(source: Connection, target: Connection) -> None:
    """Copy every row of every table into one that is empty; both are of this version's schema."""
    for table in TABLES:
        found = source.execution_options(stream_results=True, yield_per=_ROWS).execute(select(table))
        for rows in found.mappings().partitions():
            target.execute(insert(table), [dict(row) for row in rows])


def _recordings(database: Path, gateway: str) -> list[tuple[str, str, str, bool]]:
    """Return test, file, SHA-256 of each recording that a database names, and whether this gateway made it."""
    with closing(sqlite3.connect(database)) as connection:
        names = {row[1] for row in connection.execute("PRAGMA table_info(tests)")}
        made_by = "gateway" if "gateway" in names else "''"  # older than several gateways
        found = connection.execute(
            f"SELECT id, recording_file, recording_sha256, {made_by} FROM tests "
            "WHERE recording_file IS NOT NULL ORDER BY number"
        )
        return [(row[0], row[1], row[2], row[3] in ("", gateway)) for row in found]


def verified(file: Path) -> Manifest:
    """Read an archive to its end and return its manifest; nothing is written.

    Raises NotFoundError where there is no file, RequestError where it is none of ours, cut short or changed.
    """
    return _read(file, None)


def unpack(file: Path, folder: Path) -> Manifest:
    """Write what an archive holds into a folder, durable, and check it again. Raises as ``verified``, and OSError."""
    return _read(file, folder)


def _read(file: Path, folder: Path | None) -> Manifest:
    if not file.is_file():
        raise NotFoundError(say("no_backup_file", "{file}: there is no such file: name a backup", file=str(file)))
    found: dict[str, tuple[int, str]] = {}
    try:
        with file.open("rb") as raw, tarfile.open(fileobj=raw, mode="r|gz") as tar:
            for member in tar:
                content = tar.extractfile(member)
                if content is None or not member.isreg():
                    raise ValueError(say("member_no_file", "{name} is no file", name=repr(member.name)))
                if member.name == MANIFEST:
                    made = _manifest(json.loads(content.read(_LONGEST_MANIFEST)))
                    break
                if _MEMBER.fullmatch(member.name) is None or member.name in found:
                    raise ValueError(say("member_foreign", "{name} does not belong there", name=repr(member.name)))
                found[member.name] = _taken(content, None if folder is None else folder / member.name)
            else:
                raise ValueError(say("manifest_missing", "it was cut short, its manifest is missing"))
        wrong = [name for name in {*found, *made.files} if found.get(name) != made.files.get(name)]
        if wrong or DATABASE not in found:
            raise ValueError(
                say("not_as_manifest", "{name} is not what the manifest says", name=min(wrong, default=DATABASE))
            )
    except (*_BROKEN, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:  # the disk, not the archive
            raise
        reason = message_of(error) or type(error).__name__
        raise RequestError(
            say(
                "backup_not_whole",
                "{file}: it is no whole backup ({reason}): take another one",
                file=str(file),
                reason=reason,
            )
        ) from error
    return made


def _taken(content: IO[bytes], target: Path | None) -> tuple[int, str]:
    """Read one file of an archive, and write it where there is a target; return its bytes and SHA-256."""
    hashed = _Hashed(content)
    if target is None:
        while hashed.read(_BYTES):
            pass
        return hashed.found
    target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    with target.open("xb") as out:
        target.chmod(0o600)
        shutil.copyfileobj(hashed, out, _BYTES)
        out.flush()
        os.fsync(out.fileno())
    return hashed.found
