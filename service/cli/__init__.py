"""The command line. A command's module is imported when the command is called: ``--help`` stays quick."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from typing import Annotated, Any, Final

import typer

from service.cli.command import Command, CommandGroup
from valve.errors import ValveError

# Name of each command and what the list of commands says of it; its module is service.cli.NAME, with "_" for "-".
COMMANDS: Final = {
    "demo": "Simulated valves and the service, each valve tested through REST, truth beside estimate.",
    "init": "A plant file from questions, or from options alone.",
    "import-valves": "Valves of a CSV file into a plant file, all of them or none.",
    "check": "All faults of a plant file at once; with --live every device is read, none is written to.",
    "motion": "The process that moves the valves of a plant file; the service asks it.",
    "serve": "The service of the plant that a plant file describes.",
    "reload": "A running service reads its plant file again.",
    "simulate": "The valves of a plant file as Modbus slaves.",
    "run": "One test of one valve through the REST interface of a running service.",
    "stop": "Stop a test, or whatever test uses a valve: it goes to its safe value at once.",
    "acknowledge": "Say that somebody looked at a valve whose test ended badly.",
    "schedule": "The coming night valve by valve, or a schedule run at once.",
    "plan": "What a test would tell of a valve, by sequence, before anything moves.",
    "analyze": "Estimates from recordings that exist already, with no service or device.",
    "reanalyze": "Stored recordings of a time analysed anew by a running service.",
    "watch": "Friction, dead band and travel from a historian's or logger's file; without a stem, whether to test.",
    "export": "Tests out of the store as CSV, Parquet or MAT, with no service.",
    "backup": "All that the store holds in one file, while the service runs or not.",
    "restore": "An empty store filled from a backup, while no service runs on it.",
    "user": "People who may sign in: add, list, change, remove.",
    "token": "Machines that may call the service: create, list, revoke.",
    "audit": "The audit log: show it, and verify that nobody changed it.",
    "paper": "Tables and figures of Romano and Garcia (2007), ours beside the printed values.",
}
TRACEBACK_VARIABLE: Final = "BREAKAWAY_TRACEBACK"
_THREADS_VARIABLE: Final = "OPENBLAS_NUM_THREADS"


class _LazyGroup(CommandGroup):
    """Knows every command by name and one line, and loads the one that is called."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """Return the command that is called, loaded."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command if name is None else _loaded(name), rest


def _module(name: str) -> str:
    return name.replace("-", "_")


def _loaded(name: str) -> Any:
    single = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    module = import_module(f"service.cli.{_module(name)}")
    if hasattr(module, "GROUP"):  # a command with commands of its own
        return typer.main.get_command(module.GROUP)
    single.command(name, cls=getattr(module, "COMMAND_CLASS", Command))(getattr(module, _module(name)))
    return typer.main.get_command(single)


def _named(name: str, line: str) -> Callable[[], None]:
    def command() -> None:
        """Stand in the list of commands; what is called is loaded."""

    command.__name__, command.__doc__ = name, line
    return command


app = typer.Typer(
    name="breakaway",
    help="Vendor-neutral control-valve diagnostics over Modbus.",
    cls=_LazyGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"breakaway {version('breakaway')}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Take what stands before a command."""


for _name, _line in COMMANDS.items():
    app.command(_name)(_named(_name, _line))


def main() -> None:
    """Run the command line: 0 done, 1 the work failed (one sentence on standard error), 2 wrong usage."""
    # before a command loads numpy: on small matrices a second thread of the linear algebra only spins
    os.environ.setdefault(_THREADS_VARIABLE, "1")
    try:
        app()
    except ValveError as error:
        sys.stderr.write(f"breakaway: {error}\n")
        sys.exit(1)
    except Exception as error:
        if os.environ.get(TRACEBACK_VARIABLE):
            raise
        sys.stderr.write(
            f"breakaway: a fault of ours ({type(error).__name__}: {error}): "
            f"report it with what {TRACEBACK_VARIABLE}=1 shows\n"
        )
        sys.exit(1)
