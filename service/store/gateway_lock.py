"""One process a gateway on one PostgreSQL: a lock of the server's that ends with the connection of its holder."""

from __future__ import annotations

import hashlib
import time
from typing import Final

from sqlalchemy import Connection, Engine, text

from valve.errors import BusyError
from valve.messages import say

_GONE_WITHIN_S: Final = 2.0  # a server under load notices so late that the service before this one has ended
_ASKS_EVERY_S: Final = 0.05


class GatewayLock:
    """Holds a gateway's name from ``acquire`` to ``release``, in whichever folder the other process may live."""

    def __init__(self, engine: Engine, gateway: str) -> None:
        self._engine = engine
        self._gateway = gateway
        digest = hashlib.sha256(b"breakaway gateway " + gateway.encode()).digest()
        self._key = int.from_bytes(digest[:8], "big", signed=True)
        self._connection: Connection | None = None

    def acquire(self) -> None:
        """Take the lock, after a moment if need be. Raises BusyError where another process holds it."""
        connection = self._engine.connect().execution_options(isolation_level="AUTOCOMMIT")
        until_s = time.monotonic() + _GONE_WITHIN_S
        while not (has := self._tried(connection)) and time.monotonic() < until_s:
            time.sleep(_ASKS_EVERY_S)
        if not has:
            connection.close()
            name = (
                say("gateway_named", "gateway {gateway}", gateway=repr(self._gateway))
                if self._gateway
                else say("service_without_gateway", "a service without a gateway's name")
            )
            raise BusyError(
                say(
                    "gateway_runs_already",
                    "{database}: {name} runs on this database already: stop that one first, or give this one "
                    "another service.gateway",
                    database=self._engine.url.render_as_string(hide_password=True),
                    name=name,
                )
            )
        self._connection = connection

    def _tried(self, connection: Connection) -> bool:
        asked = connection.execute(text("SELECT pg_try_advisory_lock(:key)"), {"key": self._key})
        return bool(asked.scalar_one())

    def release(self) -> None:
        """Give the lock back; nothing happens where it is not held."""
        if self._connection is not None:
            self._connection.invalidate()  # the server drops the lock with the connection, whatever state it is in
            self._connection.close()
            self._connection = None
