"""``breakaway backup``: all that a store holds, in one file."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer


def backup(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The archive, a new file.", show_default=False)],
) -> None:
    """Write database, recordings, journals and audit log into one archive; the service may run meanwhile."""
    from service.backup.backup import make_backup
    from service.cli.accounts import caller
    from service.config.settings import load_plant
    from valve.errors import RecordingError

    made = make_backup(load_plant(config), file, software=f"breakaway {version('breakaway')}", who=caller())
    sys.stdout.write(f"{file}: {made.recordings} recordings, {len(made.files)} files, {file.stat().st_size:,} bytes\n")
    faults = [f"the recording of {run_id} is no longer in the store" for run_id in made.missing]
    faults += [f"the recording of {run_id} is not what was stored" for run_id in made.damaged]
    for fault in faults[1:]:
        sys.stderr.write(f"breakaway: {fault}\n")
    if faults:
        raise RecordingError(f"{faults[0]}: the backup was made, look for it in an earlier one ({len(faults)} in all)")
