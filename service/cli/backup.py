"""``breakaway backup``: all that a store holds, in one file."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from valve.messages import say


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
    faults = [
        say("recording_is_gone", "the recording of {test} is no longer in the store", test=run_id)
        for run_id in made.missing
    ]
    faults += [
        say("recording_is_other", "the recording of {test} is not what was stored", test=run_id)
        for run_id in made.damaged
    ]
    for fault in faults[1:]:
        sys.stderr.write(f"breakaway: {fault}\n")
    if faults:
        raise RecordingError(
            say(
                "backup_with_faults",
                "{first}: the backup was made, look for it in an earlier one ({count} in all)",
                first=faults[0],
                count=len(faults),
            )
        )
