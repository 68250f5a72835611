"""``breakaway audit``: who did what, and whether the log is whole."""

from __future__ import annotations

import json
import sys
from collections import deque
from pathlib import Path
from typing import Annotated, Final

import typer

from drivers.motion.audit_entries import canonical
from service.audit.verify import Verdict, entries_of, files_of, verify
from service.cli.command import Command, CommandGroup
from valve.errors import ConfigurationError, RequestError
from valve.messages import joined, say

GROUP: Final = typer.Typer(
    name="audit",
    help="The audit log: show it, and verify that nobody changed it.",
    cls=CommandGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
Folder = Annotated[
    Path | None, typer.Argument(metavar="FOLDER", help="A folder with *.audit files.", show_default=False)
]
Config = Annotated[Path | None, typer.Option("--config", metavar="FILE", help="The plant file: the log of its store.")]


def _files(folder: Path | None, config: Path | None) -> list[Path]:
    if (folder is None) == (config is None):
        raise RequestError(
            say("folder_or_config", "name either FOLDER or --config FILE, so that it is known which log is meant")
        )
    if folder is not None:
        return files_of(folder)
    from service.config.settings import load_plant

    assert config is not None
    return files_of(load_plant(config).service.store / "audit")


@GROUP.command("verify", cls=Command)
def verify_log(
    folder: Folder = None,
    config: Config = None,
    head: Annotated[
        str | None,
        typer.Option(metavar="HASH", help="A head that was noted earlier: it must still be in the log (one file)."),
    ] = None,
) -> None:
    """Verify every entry of the log and print its head. Exit code 1 where it was changed."""
    files = _files(folder, config)
    if head is not None and len(files) > 1:
        raise RequestError(
            say(
                "head_of_one_file",
                "--head belongs to one file, here are {count}: verify a folder that holds that one",
                count=len(files),
            )
        )
    changed: list[str] = []
    for file in files:
        found = verify(file, head)
        sys.stdout.write(f"{file.name}: {found.entries} entries, head {found.head}: {found.verdict.value}\n")
        if found.verdict is Verdict.TAMPERED:
            changed.append(
                say(
                    "log_changed",
                    "{file}: {reason}: {verdict}",
                    file=str(file),
                    reason=found.reason,
                    verdict=found.verdict.value,
                )
            )
    if changed:
        raise ConfigurationError(joined("; ", changed))


@GROUP.command(cls=Command)
def show(
    folder: Folder = None,
    config: Config = None,
    *,
    event: Annotated[
        str | None, typer.Option(metavar="START", help="Events that begin so, motion for instance.")
    ] = None,
    who: Annotated[str | None, typer.Option(metavar="NAME", help="What this one did.")] = None,
    valve: Annotated[str | None, typer.Option(metavar="TAG", help="What concerns this valve.")] = None,
    last: Annotated[int, typer.Option(metavar="N", min=1, help="The newest ones, at most.")] = 50,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object a line.")] = False,
) -> None:
    """Show the newest entries, oldest of them first."""
    chosen = [
        entry
        for file in _files(folder, config)
        for entry in deque(
            (
                one
                for one in entries_of(file)
                if (event is None or one.event.startswith(event))
                and who in (None, one.who)
                and valve in (None, one.valve)
            ),
            maxlen=last,
        )
    ]
    for entry in sorted(chosen, key=lambda one: one.at)[-last:]:
        if as_json:
            about = {name: getattr(entry, name) for name in ("at", "event", "who", "valve", "test", "details")}
            sys.stdout.write(json.dumps(about) + "\n")
            continue
        details = canonical(entry.details) if entry.details else ""
        line = f"{entry.at[:19]}Z  {entry.event:<20}{entry.who or '-':<24}{entry.valve:<10}{entry.test}  {details}"
        sys.stdout.write(f"{line.rstrip()}\n")
