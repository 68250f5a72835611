"""``breakaway restore``: the store of a backup, into an empty folder or database."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from valve.messages import say


def restore(
    config: Annotated[Path, typer.Option("--config", metavar="FILE", help="The plant file.", show_default=False)],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The archive of breakaway backup.", show_default=False)],
    files_only: Annotated[
        bool, typer.Option("--files-only", help="Leave the PostgreSQL database as it is: it is there already.")
    ] = False,
) -> None:
    """Make an empty store of a backup, while no service runs on it. Everything is checked before it is written."""
    from service.backup.restore import restore_backup
    from service.cli.accounts import caller
    from service.config.settings import load_plant

    plant = load_plant(config)
    made = restore_backup(plant, file, who=caller(), files_only=files_only)
    print(
        say(
            "restored_as_it_was",
            "{store}: restored as it was on {made_at:%Y-%m-%d %H:%M:%S}, {recordings} recordings\nUsers and tokens "
            "are those of then: disable and revoke again what was since.",
            store=str(plant.service.store),
            made_at=made.made_at,
            recordings=made.recordings,
        )
    )
