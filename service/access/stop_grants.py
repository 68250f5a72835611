"""Who may stop a test, kept in memory: Stop waits for no database, and holds when a session is over.

Whoever was known while a test ran may stop that test until it ends, whatever becomes of the session or the token
meanwhile; only signing out, and an admin who disables the user or revokes the token here, end it before. A test that
begins later needs a credential that is valid then.
"""

from __future__ import annotations

import asyncio
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Final

import structlog
from sqlalchemy.exc import SQLAlchemyError

from service.access.principal import Principal, Right
from service.model.requester import RequesterKind

_KEPT: Final = 10_000  # credentials; the longest unheard of goes first
#: A page that was opened so shortly before its test began is one that watches it.
JUST_BEFORE_S: Final = 20.0
_LOOK_PERIOD_S: Final = 5.0
_LOG = structlog.get_logger(__name__)


class StopGrants:
    """Callers by the SHA-256 of their session's secret or token, with the instant when they were last known."""

    def __init__(self, clock_s: Callable[[], float] = time.monotonic) -> None:
        self._clock_s = clock_s
        self._holders: OrderedDict[str, tuple[Principal, float]] = OrderedDict()

    def note(self, secret_sha256: str, principal: Principal) -> None:
        """Keep that this credential was valid now."""
        if not principal.may(Right.STOP):
            return
        self._holders[secret_sha256] = (replace(principal, csrf_token=None), self._clock_s())
        self._holders.move_to_end(secret_sha256)
        while len(self._holders) > _KEPT:
            self._holders.popitem(last=False)

    def note_all(self, holders: Iterable[tuple[str, Principal]]) -> None:
        """Keep that these were valid now."""
        for secret_sha256, principal in holders:
            self.note(secret_sha256, principal)

    def holder(self, secret_sha256: str, since_s: float) -> Principal | None:
        """Return whose credential this is, where it was valid while a test ran that began at ``since_s``."""
        principal, known_s = self._holders.get(secret_sha256, (None, 0.0))
        return principal if known_s >= since_s - JUST_BEFORE_S else None

    def end(self, secret_sha256: str) -> None:
        """Forget one credential: its session was ended."""
        self._holders.pop(secret_sha256, None)

    def end_of(self, name: str, kind: RequesterKind) -> None:
        """Forget every credential of a user or a token that may do nothing any more."""
        for secret_sha256, (principal, _) in list(self._holders.items()):
            if (principal.name, principal.kind) == (name, kind):
                self._holders.pop(secret_sha256, None)


@asynccontextmanager
async def stoppers_known(under_way: Callable[[], bool], look: Callable[[], Awaitable[None]]) -> AsyncIterator[None]:
    """While tests are ``under_way``, ``look`` every few seconds who may stop them: also one who has asked nothing yet.

    A database that is lost changes nothing of what is known.
    """

    async def keep_looking() -> None:
        while True:
            if under_way():
                try:
                    await look()
                except SQLAlchemyError as error:
                    _LOG.warning("who may stop is known as it was", reason=type(error).__name__)
            await asyncio.sleep(_LOOK_PERIOD_S)

    looking = asyncio.create_task(keep_looking())
    try:
        yield
    finally:
        looking.cancel()
