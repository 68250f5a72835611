"""Sessions: a signed-in person on one tablet, known by a secret in a cookie."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Final

from sqlalchemy import Engine, delete, insert, or_, select, update

from service.access.principal import Principal, Role
from service.access.users import User, now
from service.model.requester import RequesterKind
from service.store.schema_access import SESSIONS, USERS

IDLE: Final = timedelta(minutes=15)
LONGEST: Final = timedelta(hours=12)  # one shift: then sign in again, however busy
_NOTED_EVERY: Final = timedelta(seconds=20)  # a lock may come that much early, and a request seldom writes


def sha256(secret: str) -> str:
    """Return what is stored of a secret of 256 random bits (hex)."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


def csrf_token(secret: str) -> str:
    """Return what a page of this session sends as X-CSRF-Token: bound to the session, of no use without its cookie."""
    return hmac.new(secret.encode("utf-8", "surrogatepass"), b"breakaway/csrf/1", hashlib.sha256).hexdigest()


@dataclass(frozen=True, slots=True)
class Session:
    """A session that has just begun; ``secret`` is known to its cookie alone."""

    secret: str
    principal: Principal


def _principal(name: str, role: str, secret: str) -> Principal:
    return Principal(name, Role(role), RequesterKind.PERSON, csrf_token(secret))


class Sessions:
    """Sessions in the database, so that all gateways know them; every method may block."""

    def __init__(self, engine: Engine, clock: Callable[[], datetime] = now) -> None:
        self._engine = engine
        self._clock = clock

    def begin(self, user: User, address: str) -> Session:
        """Begin a session of a user, and clear away those that are over."""
        secret = secrets.token_urlsafe(32)
        at = self._clock()
        over = or_(SESSIONS.c.last_seen_at <= at - IDLE, SESSIONS.c.started_at <= at - LONGEST)
        row = {
            "secret_sha256": sha256(secret),
            "user_name": user.name,
            "started_at": at,
            "last_seen_at": at,
            "address": address[:64],
        }
        with self._engine.begin() as connection:
            connection.execute(delete(SESSIONS).where(over))
            connection.execute(insert(SESSIONS).values(row))
        return Session(secret, _principal(user.name, user.role.value, secret))

    def principal(self, secret: str, *, active: bool = True) -> Principal | None:
        """Return whose session it is; None where it is over, idle for too long or its user disabled.

        ``active`` tells of a person who does something: that keeps the session open.
        """
        known = sha256(secret)
        at = self._clock()
        query = (
            select(USERS.c.name, USERS.c.role, SESSIONS.c.last_seen_at)
            .join(USERS, USERS.c.name == SESSIONS.c.user_name)
            .where(
                SESSIONS.c.secret_sha256 == known,
                SESSIONS.c.last_seen_at > at - IDLE,
                SESSIONS.c.started_at > at - LONGEST,
                USERS.c.disabled_at.is_(None),
            )
        )
        with self._engine.connect() as connection:
            row = connection.execute(query).one_or_none()
        if row is None:
            return None
        if active and at - row.last_seen_at >= _NOTED_EVERY:
            with self._engine.begin() as connection:
                connection.execute(update(SESSIONS).where(SESSIONS.c.secret_sha256 == known).values(last_seen_at=at))
        return _principal(row.name, row.role, secret)

    def valid(self) -> list[tuple[str, Principal]]:
        """Return every session that is not over, by the SHA-256 of its secret; their CSRF tokens need that."""
        at = self._clock()
        query = (
            select(SESSIONS.c.secret_sha256, USERS.c.name, USERS.c.role)
            .join(USERS, USERS.c.name == SESSIONS.c.user_name)
            .where(
                SESSIONS.c.last_seen_at > at - IDLE,
                SESSIONS.c.started_at > at - LONGEST,
                USERS.c.disabled_at.is_(None),
            )
        )
        with self._engine.connect() as connection:
            return [
                (row.secret_sha256, Principal(row.name, Role(row.role), RequesterKind.PERSON))
                for row in connection.execute(query)
            ]

    def end(self, secret: str) -> None:
        """End a session at once."""
        with self._engine.begin() as connection:
            connection.execute(delete(SESSIONS).where(SESSIONS.c.secret_sha256 == sha256(secret)))
