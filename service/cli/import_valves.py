"""``breakaway import-valves``: the valves of a CSV file into a plant file, all of them or none."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from valve.errors import ConfigurationError


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
        raise ConfigurationError(f"{table}: it cannot be read ({error.strerror}): give an existing file") from None
    before = config.stat() if config.exists() else None
    found = imported(data, table.name, config, like)
    if found.faults:
        sys.stdout.writelines(f"{fault}\n" for fault in found.faults)
        number = "1 fault" if len(found.faults) == 1 else f"{len(found.faults)} faults"
        raise ConfigurationError(f"{table}: {number}, no valve was imported: correct the file, then import it again")
    valves = "1 valve" if len(found.tags) == 1 else f"{len(found.tags)} valves"
    if dry_run:
        print(f"{table}: no fault: {valves}, nothing was written")
        return
    now = config.stat()
    if before is None or (now.st_mtime_ns, now.st_size) != (before.st_mtime_ns, before.st_size):
        raise ConfigurationError(f"{config}: somebody else changed it just now: import again")
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
            f"{file}: it cannot be written ({error.strerror}), no valve was imported: see to its folder"
        ) from None
