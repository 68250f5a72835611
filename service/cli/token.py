"""``breakaway token``: machines that may call the service."""

from __future__ import annotations

import json
import sys
from datetime import UTC, datetime, timedelta
from typing import Annotated, Final

import typer

from service.access.principal import Role
from service.access.tokens import Token
from service.cli.accounts import AsJson, Config, accounts, caller
from service.cli.command import Command, CommandGroup
from valve.errors import NotFoundError
from valve.messages import say

GROUP: Final = typer.Typer(
    name="token",
    help="Machines that may call the service: create, list, revoke. Works whether the service runs or not.",
    cls=CommandGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
_DAYS: Final = 365


@GROUP.command(cls=Command)
def create(
    config: Config,
    name: Annotated[str, typer.Argument(metavar="NAME", help="What calls: it stands in tests and in the audit log.")],
    role: Annotated[
        Role, typer.Option(metavar="ROLE", help="viewer, operator, engineer or scheduler.", show_default=False)
    ],
    *,
    days: Annotated[int, typer.Option(metavar="DAYS", help="When it expires.")] = _DAYS,
    valve: Annotated[
        list[str] | None, typer.Option(metavar="TAG", help="A valve that it may move; repeat it. All by default.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Create a token and print it, this once."""
    with accounts(config) as (access, plant):
        unknown = sorted(set(valve or ()) - set(plant.valves))
        if unknown:
            raise NotFoundError(
                say(
                    "option_valve_unknown",
                    "--valve {valve}: no valve has this tag: choose one of {known:, }",
                    valve=unknown[0],
                    known=tuple(plant.valves),
                )
            )
        token, secret = access.create_token(
            name, role, by=caller(), lasts=timedelta(days=max(0, min(days, 10_000))), valves=valve or None
        )
    if as_json:
        about = {"id": token.id, "name": name, "role": role.value, "expires_at": token.expires_at.isoformat()}
        sys.stdout.write(json.dumps({**about, "token": secret}) + "\n")
        return
    sys.stderr.write(
        say(
            "token_shown_once",
            "token {token} of {name}, {role}, until {until}; shown this once:\n",
            token=token.id,
            name=name,
            role=role.value,
            until=f"{token.expires_at:%Y-%m-%d}",
        )
    )
    sys.stdout.write(f"{secret}\n")


def _state(token: Token) -> str:
    if token.revoked_at is not None:
        return f"revoked {token.revoked_at:%Y-%m-%d}"
    return ("expired " if token.expires_at <= datetime.now(UTC) else "until ") + f"{token.expires_at:%Y-%m-%d}"


@GROUP.command("list", cls=Command)
def list_tokens(config: Config, as_json: AsJson = False) -> None:
    """List all tokens, without their secrets."""
    with accounts(config) as (access, _):
        tokens = access.tokens.all()
    if as_json:
        rows = [
            {
                "id": token.id,
                "name": token.name,
                "role": token.role.value,
                "valves": token.valves,
                "expires_at": token.expires_at.isoformat(),
                "revoked": token.revoked_at is not None,
            }
            for token in tokens
        ]
        sys.stdout.write(json.dumps({"tokens": rows}) + "\n")
        return
    for token in tokens:
        valves = "all valves" if token.valves is None else ", ".join(token.valves)
        sys.stdout.write(f"{token.id:<10}{token.name:<24}{token.role.value:<12}{_state(token):<20}{valves}\n")


@GROUP.command(cls=Command)
def revoke(
    config: Config, token_id: Annotated[str, typer.Argument(metavar="ID", help="As breakaway token list shows it.")]
) -> None:
    """End a token at once."""
    with accounts(config) as (access, _):
        token = access.revoke_token(token_id, by=caller())
    print(say("token_ends_here", "token {token} of {name} ends here", token=token.id, name=token.name))
