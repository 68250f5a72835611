"""The store: one folder that holds everything the service must not forget.

::

    plant-data/
    ├── breakaway.db        metadata (SQLite), unless service.database names a PostgreSQL database
    ├── recordings/         ID.parquet: each test's raw recording
    ├── journals/           ID.journal: samples of the test that runs now
    ├── uploads/            recordings that are analysed on request, then removed
    ├── watched/            TAG/DAY.watch: what was read of valves in service, for some days
    └── lock                held while a service uses the folder
"""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import URL, Engine

from service.config.plant import ServiceSettings
from service.model.run import checked_run_id
from service.store.database import open_database
from service.store.figure_table import FigureTable
from service.store.gateway_lock import GatewayLock
from service.store.lock import StoreLock
from service.store.model_table import ModelTable
from service.store.reanalysis_table import ReanalysisTable
from service.store.run_table import RunTable
from service.store.schedule_run_table import ScheduleRunTable
from service.store.state_counts import StateCounts
from service.store.watched_table import WatchedTable
from valve.errors import ConfigurationError, InternalError
from valve.messages import message_of, say
from valve.recording import Recording
from valve.recording_files import file_sha256, write_parquet


class Store:
    """Opens the folder for this process alone; ``close`` gives it back.

    Raises BusyError where another process has it, ConfigurationError where it cannot be used.
    """

    def __init__(self, folder: Path, database_url: str | URL | None = None, *, gateway: str = "") -> None:
        self.folder = folder
        self.gateway = gateway
        try:
            for part in ("recordings", "journals", "uploads"):
                (folder / part).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _unwritable(folder, error) from error
        self._lock = StoreLock(folder / "lock")
        self._gateway_lock: GatewayLock | None = None
        try:
            self._lock.acquire()
            for leftover in (folder / "uploads").iterdir():
                leftover.unlink()
            self._engine: Engine = open_database(database_url or f"sqlite:///{folder / 'breakaway.db'}")
            self._lock_gateway()
        except OSError as error:
            self._lock.release()
            raise _unwritable(folder, error) from error
        except BaseException:
            self._lock.release()
            raise
        self.runs = RunTable(self._engine)
        self.schedule_runs = ScheduleRunTable(self._engine)
        self.reanalyses = ReanalysisTable(self._engine)
        self.models = ModelTable(self._engine)
        self.figures = FigureTable(self._engine)
        self.watched = WatchedTable(self._engine)
        self.state_counts = StateCounts(self._engine)

    def _lock_gateway(self) -> None:
        if self._engine.dialect.name == "postgresql":
            lock = GatewayLock(self._engine, self.gateway)
            try:
                lock.acquire()
            except BaseException:
                self._engine.dispose()
                raise
            self._gateway_lock = lock

    @property
    def engine(self) -> Engine:
        """The database."""
        return self._engine

    def close(self) -> None:
        """Close the database and give the folder back."""
        if self._gateway_lock is not None:
            self._gateway_lock.release()
        self._engine.dispose()
        self._lock.release()

    def journal_path(self, run_id: str) -> Path:
        """Where the samples of a running test go."""
        return self.folder / "journals" / f"{checked_run_id(run_id)}.journal"

    def recording_path(self, run_id: str) -> Path:
        """Where the recording of a test stands once it is written."""
        return self.folder / "recordings" / f"{checked_run_id(run_id)}.parquet"

    @property
    def uploads(self) -> Path:
        """Folder for recordings that are analysed on request."""
        return self.folder / "uploads"

    def write_recording(self, run_id: str, recording: Recording) -> tuple[str, str]:
        """Write a test's recording whole and durable; return its file name and SHA-256 (hex).

        Raises InternalError where the file on disk is not what was hashed.
        """
        path = self.recording_path(run_id)
        sha256 = write_parquet(recording, path)
        on_disk = file_sha256(path)
        if on_disk != sha256:
            raise InternalError(
                say(
                    "recording_reads_otherwise",
                    "test {test}: its recording reads back as {on_disk}, it was {was}: check the disk",
                    test=run_id,
                    on_disk=on_disk,
                    was=sha256,
                )
            )
        return path.name, sha256


def open_store(settings: ServiceSettings) -> Store:
    """Open the store that plant.toml names. Raises as Store, and ConfigurationError where its password is missing."""
    url = None if settings.database is None else settings.database.with_password()
    return Store(settings.store, url, gateway=settings.gateway)


def _unwritable(folder: Path, error: OSError) -> ConfigurationError:
    return ConfigurationError(
        say(
            "store_not_writable",
            "{folder}: the store cannot be written ({why}): make it writable, or name another folder as service.store",
            folder=str(folder),
            why=error.strerror or message_of(error),
        )
    )
