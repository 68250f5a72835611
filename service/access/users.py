"""Users: people with a name, a role and a password of their own. The audit log goes on naming one who is removed."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from sqlalchemy import Engine, Row, delete, insert, select, update
from sqlalchemy.exc import IntegrityError

from service.access.passwords import fits, hashed
from service.access.principal import Role
from service.store.schema_access import SESSIONS, USERS
from valve.errors import BusyError, NotFoundError, RequestError
from valve.messages import say

NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._@-]{0,62}")
USER_ROLES: Final = (Role.VIEWER, Role.OPERATOR, Role.ENGINEER, Role.ADMIN)
_RESERVED: Final = frozenset({"local", "scheduler", "service", "audit"})


def now() -> datetime:
    """Return the present instant."""
    return datetime.now(UTC)


def checked_name(name: str) -> str:
    """Return ``name`` where it may be one. Raises RequestError."""
    if NAME.fullmatch(name) is None or name.casefold() in _RESERVED:
        raise RequestError(
            say(
                "user_name_unusable",
                "the name {name} cannot be used: take 1 to 63 letters, digits or . _ @ -, none of {reserved:, }",
                name=repr(name[:80]),
                reserved=tuple(sorted(_RESERVED)),
            )
        )
    return name


@dataclass(frozen=True, slots=True)
class User:
    """One person. ``disabled_at`` is None while they may sign in."""

    name: str
    role: Role
    created_at: datetime
    created_by: str
    disabled_at: datetime | None


def _user(row: Row[Any]) -> User:
    return User(row.name, Role(row.role), row.created_at, row.created_by, row.disabled_at)


class Users:
    """Users in the database; every method is one transaction and may block."""

    def __init__(self, engine: Engine, clock: Callable[[], datetime] = now) -> None:
        self._engine = engine
        self._clock = clock

    def add(self, name: str, role: Role, password: str, *, by: str) -> User:
        """Store a new user. Raises RequestError for a name, role or password that cannot be, BusyError for a double."""
        checked_name(name)
        _checked_role(name, role)
        row = {
            "name": name,
            "role": role.value,
            "password_hash": hashed(name, password),
            "created_at": self._clock(),
            "created_by": by,
        }
        try:
            with self._engine.begin() as connection:
                connection.execute(insert(USERS).values(row))
        except IntegrityError:
            raise BusyError(
                say("user_exists", "user {name} exists already: choose another name, or change this one", name=name)
            ) from None
        return self.get(name)

    def all(self) -> list[User]:
        """Return every user by name, the disabled ones too."""
        with self._engine.connect() as connection:
            return [_user(row) for row in connection.execute(select(USERS).order_by(USERS.c.name))]

    def get(self, name: str) -> User:
        """Return one user. Raises NotFoundError."""
        row = self._row(name)
        if row is None:
            raise NotFoundError(
                say("user_unknown", "user {name} is unknown: breakaway user list shows all", name=repr(name[:64]))
            )
        return _user(row)

    def _row(self, name: str) -> Row[Any] | None:
        if NAME.fullmatch(name) is None:  # what no user can be called is never asked of a database
            return None
        with self._engine.connect() as connection:
            return connection.execute(select(USERS).where(USERS.c.name == name)).one_or_none()

    def with_password(self, name: str, password: str) -> User | None:
        """Return the user whom name and password fit and who may sign in; None otherwise, after the same time."""
        row = self._row(name)
        if not fits(None if row is None else row.password_hash, password) or row is None:
            return None
        return None if row.disabled_at is not None else _user(row)

    def change(
        self, name: str, *, role: Role | None = None, password: str | None = None, disabled: bool | None = None
    ) -> User:
        """Change a user and end their sessions. Raises NotFoundError, RequestError."""
        known = self.get(name)
        values: dict[str, Any] = {}
        if role is not None:
            values["role"] = _checked_role(name, role).value
        if password is not None:
            values["password_hash"] = hashed(name, password)
        if disabled is not None:
            values["disabled_at"] = (known.disabled_at or self._clock()) if disabled else None
        if values:
            with self._engine.begin() as connection:
                connection.execute(update(USERS).where(USERS.c.name == name).values(values))
                connection.execute(delete(SESSIONS).where(SESSIONS.c.user_name == name))
        return self.get(name)

    def remove(self, name: str) -> User:
        """Delete a user and end their sessions; return who it was. Raises NotFoundError."""
        known = self.get(name)
        with self._engine.begin() as connection:
            connection.execute(delete(SESSIONS).where(SESSIONS.c.user_name == name))
            connection.execute(delete(USERS).where(USERS.c.name == name))
        return known


def _checked_role(name: str, role: Role) -> Role:
    if role not in USER_ROLES:
        raise RequestError(
            say(
                "no_user_role",
                "user {name}: nobody can be {role}: choose one of {roles:, }",
                name=name,
                role=role.value,
                roles=tuple(USER_ROLES),
            )
        )
    return role
