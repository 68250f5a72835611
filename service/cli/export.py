"""``breakaway export``: tests out of the store as files, with no service."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from service.recordings.export import ExportFormat
from valve.errors import NotFoundError, RecordingError, RequestError, ValveError
from valve.messages import message_of, say

if TYPE_CHECKING:
    from service.config.plant import Plant
    from service.store.run_table import RunTable


def export(  # noqa: PLR0917 - typer takes options by position
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the files.", show_default=False)],
    tests: Annotated[
        list[str] | None, typer.Argument(metavar="[TEST]...", help="Ids of tests.", show_default=False)
    ] = None,
    valve: Annotated[str | None, typer.Option(metavar="TAG", help="All tests of this valve.")] = None,
    since: Annotated[
        datetime | None,
        typer.Option(
            metavar="DATE", formats=["%Y-%m-%d", "%Y-%m-%dT%H:%M:%S"], help="Tests asked for since then, UTC."
        ),
    ] = None,
    form: Annotated[ExportFormat, typer.Option("--format", metavar="csv|parquet|mat", help="How.")] = ExportFormat.CSV,
) -> None:
    """Write recordings and what is known of their tests; each is checked against the hash of when it was stored."""
    if not tests and valve is None and since is None:
        raise RequestError(say("export_needs_tests", "export needs tests: give their ids, --valve TAG or --since DATE"))
    if tests and (valve is not None or since is not None):
        raise RequestError(say("export_ids_or_valve", "export takes ids of tests, or --valve and --since: not both"))
    from service.config.settings import load_plant
    from service.recordings.export import export_test

    plant = load_plant(config)
    failed: list[str] = []
    with _runs(plant) as runs:
        start = None if since is None else since.replace(tzinfo=UTC)
        chosen = tests or runs.ended_since(start, valve=valve)
        if not chosen:
            if valve is not None and valve not in plant.valves:
                raise NotFoundError(
                    say(
                        "option_valve_unknown",
                        "--valve {valve}: no valve has this tag: choose one of {known:, }",
                        valve=valve,
                        known=tuple(plant.valves),
                    )
                )
            subject = valve or say("any_valve", "any valve")
            raise NotFoundError(
                say(
                    "no_recorded_test",
                    "{valve}: the store has no test with a recording: test it first",
                    valve=subject,
                )
                if since is None
                else say(
                    "no_recorded_test_since",
                    "{valve}: the store has no test with a recording since {since}: test it first",
                    valve=subject,
                    since=since,
                )
            )
        _make(out)
        for run_id in chosen:
            try:
                for path in export_test(runs.get(run_id), plant.service.store / "recordings", out, form):
                    sys.stdout.write(f"{path}\n")
            except OSError as error:
                raise RequestError(
                    say(
                        "folder_unwritable",
                        "{folder}: it cannot be written ({reason}): give another folder",
                        folder=str(out),
                        reason=str(error.strerror),
                    )
                ) from error
            except (NotFoundError, RecordingError) as error:
                failed.append(message_of(error))
    for text in failed[:-1]:
        sys.stderr.write(f"breakaway: {text}\n")
    if failed:
        raise ValveError(
            failed[-1]
            if len(failed) == 1
            else say("some_failed", "{why} ({n} of {all} failed)", why=failed[-1], n=len(failed), all=len(chosen))
        )


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RequestError(
            say(
                "folder_unmade",
                "{folder}: it cannot be made ({reason}): give another folder",
                folder=str(folder),
                reason=str(error.strerror),
            )
        ) from error


@contextmanager
def _runs(plant: Plant) -> Iterator[RunTable]:
    """Open the store's table of tests; a service may use it meanwhile."""
    from service.store.database import open_database
    from service.store.run_table import RunTable

    settings = plant.service
    file = settings.store / "breakaway.db"
    if settings.database is None and not file.is_file():
        raise NotFoundError(say("no_store_file", "{file}: there is no store yet: its service makes it", file=str(file)))
    engine = open_database(f"sqlite:///{file}" if settings.database is None else settings.database.with_password())
    try:
        yield RunTable(engine)
    finally:
        engine.dispose()
