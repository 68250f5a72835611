"""Machine tokens: 256 random bits, shown once, stored as their hash, with a role, valves and an end."""

from __future__ import annotations

import re
import secrets
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any, Final

from sqlalchemy import Engine, Row, insert, select, update

from service.access.principal import Principal, Role
from service.access.sessions import sha256
from service.access.users import checked_name, now
from service.model.requester import RequesterKind
from service.store.schema_access import TOKENS
from valve.errors import NotFoundError, RequestError
from valve.messages import say

PREFIX: Final = "breakaway_"  # so that a scanner of repositories and logs can find one
TOKEN_ROLES: Final = (Role.VIEWER, Role.OPERATOR, Role.ENGINEER, Role.SCHEDULER)
LONGEST: Final = timedelta(days=731)
_ID: Final = re.compile(r"[0-9a-f]{8}")
_FORM: Final = re.compile(rf"{PREFIX}[A-Za-z0-9_-]{{43}}")
_NOTED_EVERY: Final = timedelta(minutes=1)


@dataclass(frozen=True, slots=True)
class Token:
    """One token, without its secret. ``valves`` None: all."""

    id: str
    name: str
    role: Role
    valves: tuple[str, ...] | None
    created_at: datetime
    created_by: str
    expires_at: datetime
    revoked_at: datetime | None
    last_used_at: datetime | None


def _token(row: Row[Any]) -> Token:
    values = dict(row._mapping)
    values.pop("secret_sha256")
    values["role"] = Role(values["role"])
    values["valves"] = None if values["valves"] is None else tuple(values["valves"])
    return Token(**values)


def _principal(token: Token) -> Principal:
    valves = None if token.valves is None else frozenset(token.valves)
    return Principal(token.name, token.role, RequesterKind.MACHINE, valves=valves)


class Tokens:
    """Tokens in the database; every method may block."""

    def __init__(self, engine: Engine, clock: Callable[[], datetime] = now) -> None:
        self._engine = engine
        self._clock = clock

    def create(
        self, name: str, role: Role, *, by: str, lasts: timedelta, valves: Iterable[str] | None = None
    ) -> tuple[Token, str]:
        """Store a new token; return it and its secret, which nobody can show again. Raises RequestError."""
        checked_name(name)
        if role not in TOKEN_ROLES:
            raise RequestError(
                say(
                    "no_machine_role",
                    "token {name}: no machine can be {role}: choose one of {roles:, }",
                    name=name,
                    role=role.value,
                    roles=tuple(TOKEN_ROLES),
                )
            )
        if not timedelta(0) < lasts <= LONGEST:
            raise RequestError(
                say(
                    "token_lasts",
                    "token {name}: {days} days: choose 1 to {most}",
                    name=name,
                    days=lasts.days,
                    most=LONGEST.days,
                )
            )
        secret = f"{PREFIX}{secrets.token_urlsafe(32)}"
        at = self._clock()
        row = {
            "id": secrets.token_hex(4),
            "name": name,
            "secret_sha256": sha256(secret),
            "role": role.value,
            "valves": None if valves is None else sorted(set(valves)),
            "created_at": at,
            "created_by": by,
            "expires_at": at + lasts,
        }
        with self._engine.begin() as connection:
            connection.execute(insert(TOKENS).values(row))
        return self.get(str(row["id"])), secret

    def all(self) -> list[Token]:
        """Return every token, the oldest first, those that are over too."""
        with self._engine.connect() as connection:
            return [_token(row) for row in connection.execute(select(TOKENS).order_by(TOKENS.c.created_at))]

    def get(self, token_id: str) -> Token:
        """Return one token. Raises NotFoundError."""
        row = None
        if _ID.fullmatch(token_id) is not None:
            with self._engine.connect() as connection:
                row = connection.execute(select(TOKENS).where(TOKENS.c.id == token_id)).one_or_none()
        if row is None:
            raise NotFoundError(
                say(
                    "token_unknown",
                    "token {token} is unknown: breakaway token list shows all",
                    token=repr(token_id[:32]),
                )
            )
        return _token(row)

    def revoke(self, token_id: str) -> Token:
        """End a token at once; one that has ended stays as it is. Raises NotFoundError."""
        self.get(token_id)
        with self._engine.begin() as connection:
            connection.execute(
                update(TOKENS)
                .where(TOKENS.c.id == token_id, TOKENS.c.revoked_at.is_(None))
                .values(revoked_at=self._clock())
            )
        return self.get(token_id)

    def valid(self) -> list[tuple[str, Principal]]:
        """Return whom each token that is valid now stands for, by the SHA-256 of its secret."""
        query = select(TOKENS).where(TOKENS.c.revoked_at.is_(None), TOKENS.c.expires_at > self._clock())
        with self._engine.connect() as connection:
            return [(row.secret_sha256, _principal(_token(row))) for row in connection.execute(query)]

    def principal(self, secret: str) -> tuple[Principal | None, str]:
        """Return whose token it is, or None and why it is none, without a word on what was sent."""
        if _FORM.fullmatch(secret) is None:
            return None, say("no_token", "it is no token of this service: breakaway token create makes one")
        with self._engine.connect() as connection:
            row = connection.execute(select(TOKENS).where(TOKENS.c.secret_sha256 == sha256(secret))).one_or_none()
        if row is None:
            return None, say("this_token_unknown", "this token is unknown: breakaway token create makes one")
        token = _token(row)
        at = self._clock()
        if token.revoked_at is not None:
            return None, say(
                "token_revoked", "token {token} ({name}) was revoked: create another", token=token.id, name=token.name
            )
        if token.expires_at <= at:
            return (
                None,
                say(
                    "token_expired",
                    "token {token} ({name}) expired at {at}: create another",
                    token=token.id,
                    name=token.name,
                    at=token.expires_at,
                ),
            )
        if token.last_used_at is None or at - token.last_used_at >= _NOTED_EVERY:
            with self._engine.begin() as connection:
                connection.execute(update(TOKENS).where(TOKENS.c.id == token.id).values(last_used_at=at))
        return _principal(token), ""
