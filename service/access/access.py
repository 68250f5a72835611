"""Access to one service: its users, sessions and tokens, and what is written down of them."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from datetime import timedelta
from functools import partial
from typing import Any, Final, ParamSpec, TypeVar

from sqlalchemy import Engine

from drivers.motion.audit_log import AuditLog
from service.access.principal import Principal, Role
from service.access.sessions import Session, Sessions, sha256
from service.access.stop_grants import StopGrants
from service.access.throttle import Throttle
from service.access.tokens import Token, Tokens
from service.access.users import User, Users
from service.config.plant import AccessSettings
from service.model.refusals import NotSignedInError
from service.model.requester import RequesterKind
from valve.messages import say

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

_LOOK_UPS: Final = 4  # at once; threads of their own, so that a database that hangs takes none from the tests


def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_LOOK_UPS, "access")


@dataclass(frozen=True, slots=True)
class Access:
    """What routes and commands do with accounts; all of it is in the audit log when the caller is answered.

    What is no coroutine may block.
    """

    settings: AccessSettings
    users: Users
    sessions: Sessions
    tokens: Tokens
    audit: AuditLog
    throttle: Throttle = field(default_factory=Throttle)
    grants: StopGrants = field(default_factory=StopGrants)
    _look_ups: ThreadPoolExecutor = field(default_factory=_threads)
    _one_at_a_time: asyncio.Lock = field(default_factory=asyncio.Lock)

    async def asked(
        self, look_up: Callable[Parameters, Result], *args: Parameters.args, **kwargs: Parameters.kwargs
    ) -> Result:
        """Return what a look-up in the database finds, in a thread that is for these alone."""
        return await asyncio.get_running_loop().run_in_executor(self._look_ups, partial(look_up, *args, **kwargs))

    async def person(self, secret: str, *, active: bool) -> Principal | None:
        """Return whose session it is, as ``Sessions.principal``; who is known may stop the tests that run."""
        person = await self.asked(self.sessions.principal, secret, active=active)
        if person is not None:
            self.grants.note(sha256(secret), person)
        return person

    async def machine(self, secret: str) -> tuple[Principal | None, str]:
        """Return whose token it is, as ``Tokens.principal``; who is known may stop the tests that run."""
        machine, why = await self.asked(self.tokens.principal, secret)
        if machine is not None:
            self.grants.note(sha256(secret), machine)
        return machine, why

    async def note_known(self) -> None:
        """Keep in memory who may stop a test: every session and token that is valid now."""
        for holders in (self.sessions.valid, self.tokens.valid):
            self.grants.note_all(await self.asked(holders))

    def close(self) -> None:
        """Take no further look-up; what hangs is not waited for."""
        self._look_ups.shutdown(wait=False, cancel_futures=True)

    async def sign_in(self, name: str, password: str, address: str) -> Session:
        """Begin a session. Raises NotSignedInError where name and password do not fit, ThrottledError."""
        user = await self.known(name, password, address)
        await asyncio.to_thread(self.audit.append, "session.began", who=user.name, details={"address": address})
        return await asyncio.to_thread(self.sessions.begin, user, address)

    async def known(self, name: str, password: str, address: str) -> User:
        """Return the user whom name and password fit. Raises NotSignedInError, ThrottledError.

        One at a time: a flood of guesses costs one core at most, and none slips past the count.
        """
        async with self._one_at_a_time:
            self.throttle.check(name, address)
            user = await asyncio.to_thread(self.users.with_password, name, password)
            if user is not None:
                self.throttle.succeeded(name, address)
                return user
            self.throttle.failed(name, address)
        about = {"name": name[:64], "address": address}
        await asyncio.to_thread(self.audit.append, "session.refused", who="", details=about)
        raise NotSignedInError(
            say("wrong_sign_in", "name or password is wrong, or the user is disabled: try again, or ask an admin")
        )

    def sign_out(self, secret: str, who: str) -> None:
        """End a session."""
        self.grants.end(sha256(secret))
        self.sessions.end(secret)
        self.audit.append("session.ended", who=who)

    def add_user(self, name: str, role: Role, password: str, *, by: str) -> User:
        """Add a user."""
        user = self.users.add(name, role, password, by=by)
        self.audit.append("user.added", who=by, details={"name": name, "role": role.value})
        return user

    def change_user(
        self, name: str, *, by: str, role: Role | None = None, password: str | None = None, disabled: bool | None = None
    ) -> User:
        """Change a user; their sessions end."""
        changes: dict[str, Any] = {} if role is None else {"role": role.value}
        changes |= ({} if password is None else {"password": "new"}) | (
            {} if disabled is None else {"disabled": disabled}
        )
        user = self.users.change(name, role=role, password=password, disabled=disabled)
        if disabled:
            self.grants.end_of(name, RequesterKind.PERSON)
        self.audit.append("user.changed", who=by, details={"name": name, **changes})
        return user

    def remove_user(self, name: str, *, by: str) -> User:
        """Remove a user; their sessions end, and what the audit log says of them stays."""
        user = self.users.remove(name)
        self.grants.end_of(name, RequesterKind.PERSON)
        self.audit.append("user.removed", who=by, details={"name": name, "role": user.role.value})
        return user

    def create_token(
        self, name: str, role: Role, *, by: str, lasts: timedelta, valves: list[str] | None
    ) -> tuple[Token, str]:
        """Create a token; its secret is shown now and never again."""
        token, secret = self.tokens.create(name, role, by=by, lasts=lasts, valves=valves)
        about = {"id": token.id, "name": name, "role": role.value, "valves": valves, "days": lasts.days}
        self.audit.append("token.created", who=by, details=about)
        return token, secret

    def revoke_token(self, token_id: str, *, by: str) -> Token:
        """End a token at once."""
        token = self.tokens.revoke(token_id)
        self.grants.end_of(token.name, RequesterKind.MACHINE)
        self.audit.append("token.revoked", who=by, details={"id": token.id, "name": token.name})
        return token


def access_of(engine: Engine, settings: AccessSettings, audit: AuditLog) -> Access:
    """Return the access to a service whose accounts stand in this database."""
    return Access(settings, Users(engine), Sessions(engine), Tokens(engine), audit)
