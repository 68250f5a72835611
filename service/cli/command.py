"""What every command of ours has in common: help that a newcomer reads without knowing Python's types."""

from __future__ import annotations

from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperGroup


def _without_types(parameters: list[Any]) -> list[Any]:
    """Return the parameters; a flag takes no value, so none is named, and an argument's name says enough."""
    for parameter in parameters:
        if isinstance(parameter, TyperArgument):
            parameter.display_type_rich = _nothing  # type: ignore[method-assign]  # typer has no setting for it
        elif getattr(parameter, "is_flag", False) and parameter.metavar is None:
            parameter.metavar = ""
    return parameters


def _nothing(ctx: Any) -> None:  # noqa: ARG001  - typer's signature
    return None


class Command(TyperCommand):
    """One command."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return options and arguments, as the help lists them."""
        return _without_types(super().get_params(ctx))


class CommandGroup(TyperGroup):
    """The list of commands."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the options, as the help lists them."""
        return _without_types(super().get_params(ctx))
