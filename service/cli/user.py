"""``breakaway user``: people who may sign in."""

from __future__ import annotations

import json
import sys
from typing import Annotated, Final

import typer

from service.access.passwords import random_password
from service.access.principal import Role
from service.access.users import User
from service.cli.accounts import AsJson, Config, accounts, asked_password, caller
from service.cli.command import Command, CommandGroup
from valve.messages import say

GROUP: Final = typer.Typer(
    name="user",
    help="People who may sign in: add, list, change, remove. Works whether the service runs or not.",
    cls=CommandGroup,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
Name = Annotated[str, typer.Argument(metavar="NAME", help="The name to sign in with.")]
RoleOption = Annotated[
    Role, typer.Option("--role", metavar="ROLE", help="viewer, operator, engineer or admin.", show_default=False)
]
Generate = Annotated[bool, typer.Option("--generate", help="Make a random password and print it, this once.")]


def _password(name: str, generate: bool) -> str:
    if not generate:
        return asked_password(name)
    password = random_password()
    sys.stdout.write(f"password of {name}: {password}\n")
    return password


@GROUP.command(cls=Command)
def add(config: Config, name: Name, role: RoleOption, generate: Generate = False) -> None:
    """Add a user. The password is typed, or taken from BREAKAWAY_PASSWORD."""
    with accounts(config) as (access, _):
        user = access.add_user(name, role, _password(name, generate), by=caller())
    sys.stdout.write(f"{user.name} is {user.role.value} now\n")


def _state(user: User) -> str:
    return "" if user.disabled_at is None else f"disabled {user.disabled_at:%Y-%m-%d}"


@GROUP.command("list", cls=Command)
def list_users(config: Config, as_json: AsJson = False) -> None:
    """List all users."""
    with accounts(config) as (access, _):
        users = access.users.all()
    if as_json:
        rows = [
            {"name": user.name, "role": user.role.value, "disabled": user.disabled_at is not None} for user in users
        ]
        sys.stdout.write(json.dumps({"users": rows}) + "\n")
        return
    for user in users:
        sys.stdout.write(f"{user.name:<24}{user.role.value:<12}{_state(user)}".rstrip() + "\n")


@GROUP.command(cls=Command)
def passwd(config: Config, name: Name, generate: Generate = False) -> None:
    """Give a user a new password; their sessions end."""
    with accounts(config) as (access, _):
        access.users.get(name)
        access.change_user(name, by=caller(), password=_password(name, generate))
    print(say("has_new_password", "{name} has a new password; every session of theirs has ended", name=name))


@GROUP.command(cls=Command)
def role(config: Config, name: Name, new: RoleOption) -> None:
    """Give a user another role; their sessions end."""
    with accounts(config) as (access, _):
        access.change_user(name, by=caller(), role=new)
    print(say("has_new_role", "{name} is {role} now; every session of theirs has ended", name=name, role=new.value))


@GROUP.command(cls=Command)
def disable(config: Config, name: Name) -> None:
    """Let a user no longer sign in; their sessions end."""
    with accounts(config) as (access, _):
        access.change_user(name, by=caller(), disabled=True)
    print(say("may_not_sign_in", "{name} may no longer sign in; every session of theirs has ended", name=name))


@GROUP.command(cls=Command)
def enable(config: Config, name: Name) -> None:
    """Let a disabled user sign in again."""
    with accounts(config) as (access, _):
        access.change_user(name, by=caller(), disabled=False)
    print(say("may_sign_in_again", "{name} may sign in again", name=name))


@GROUP.command(cls=Command)
def remove(config: Config, name: Name) -> None:
    """Remove a user; their sessions end. The audit log goes on naming them; tokens that they made stay."""
    with accounts(config) as (access, _):
        access.remove_user(name, by=caller())
    print(say("user_is_removed", "{name} is removed; every session of theirs has ended", name=name))
