"""``--held-out A B C``: an option that takes every file up to the next option."""

from __future__ import annotations

from typing import Any, Final

from service.cli.command import Command

FLAG: Final = "--held-out"


def repeat_flag(arguments: list[str]) -> list[str]:
    """Return the arguments with the flag before each of its files, as the parser wants it.

    Files that follow the flag belong to it, unless no recording stands before it: then only the first one does,
    and the rest are the recordings.
    """
    spread: list[str] = []
    seen_recording = held_out = False
    value_of: str | None = None  # the option whose value comes next
    for argument in arguments:
        if value_of is not None:
            held_out, value_of = value_of == FLAG and seen_recording, None
        elif argument.startswith("-") and argument != "-":
            held_out = False
            value_of = None if "=" in argument or argument == "--help" else argument
        elif held_out:
            spread.append(FLAG)
        else:
            seen_recording = True
        spread.append(argument)
    return spread


class HeldOutCommand(Command):
    """A command whose flag for held-out recordings takes several files at once."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse as usual, with the flag repeated before each file."""
        return super().parse_args(ctx, repeat_flag(args))
