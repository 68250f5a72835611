"""``breakaway import-valves``: the valves of a CSV file into a plant file, all of them or none."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from service.cli.check import faults_counted
from valve.errors import ConfigurationError
from valve.messages import say


def import_valves(
    table: Annotated[Path, typer.Argument(metavar="VALVES.CSV", help="A row a valve; the first names the columns.")],
    config: Annotated[
        Path, typer.Option("--config", metavar="FILE", help="The plant file that takes them.", show_default=False)
    ],
    like: Annotated[
        str | None, typer.Option("--like", metavar="TAG", help="A valve of the plant file: what rows leave open.")
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say all faults and write nothing.")] = False,
) -> None:
    """Add valves to a plant file. All faults are told at once; nothing is written where there is one.

    A column is called like its key in plant.toml (docs/plant.md): tag, travel, safe_value, limits.pressure and so on.
    """
    from service.config.valve_import import import_valves as imported

    try:
        data = table.read_bytes()
    except OSError as error:
        raise ConfigurationError(
            say(
                "table_unreadable",
                "{table}: it cannot be read ({reason}): give an existing file",
                table=str(table),
                reason=str(error.strerror),
            )
        ) from None
    before = config.stat() if config.exists() else None
    found = imported(data, table.name, config, like)
    if found.faults:
        sys.stdout.writelines(f"{fault}\n" for fault in found.faults)
        raise ConfigurationError(
            say(
                "correct_and_import",
                "{table}: {number}, no valve was imported: correct the file, then import it again",
                table=str(table),
                number=faults_counted(len(found.faults)),
            )
        )
    valves = "1 valve" if len(found.tags) == 1 else f"{len(found.tags)} valves"
    if dry_run:
        print(
            say(
                "no_fault_nothing_written",
                "{table}: no fault: {valves}, nothing was written",
                table=str(table),
                valves=valves,
            )
        )
        return
    now = config.stat()
    if before is None or (now.st_mtime_ns, now.st_size) != (before.st_mtime_ns, before.st_size):
        raise ConfigurationError(
            say("plant_file_changed", "{config}: somebody else changed it just now: import again", config=str(config))
        )
    _replace(config, found.text)
    them = "it" if len(found.tags) == 1 else "them"
    print(f"{config}: {valves} added. Next: `breakaway reload`, so that a service that runs takes {them}.")


def _replace(file: Path, text: str) -> None:
    """Give a file another text, whole or not at all; what it may be read by stays."""
    file = file.resolve()
    try:
        handle, name = tempfile.mkstemp(dir=file.parent, prefix=f".{file.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as new:
                new.write(text)
                new.flush()
                os.fsync(new.fileno())
            shutil.copymode(file, name)
            Path(name).replace(file)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        raise ConfigurationError(
            say(
                "plant_file_unwritable",
                "{file}: it cannot be written ({reason}), no valve was imported: see to its folder",
                file=str(file),
                reason=str(error.strerror),
            )
        ) from None
