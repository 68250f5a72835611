"""HTTP on the wire: uvicorn on httptools, with the limits that it leaves open.

A request's head is limited in size and in time, and connections in number: who opens many and says nothing takes
neither the service's file descriptors, which buses and journals need, nor the place of somebody who wants to stop.
"""

from __future__ import annotations

import asyncio
import resource
from typing import Any, ClassVar, Final

import structlog
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol, RequestResponseCycle

LONGEST_HEAD_BYTES: Final = 64 * 1024  # uvicorn's own limit where it reads by h11
HEAD_LIMIT_S: Final = 10.0  # as for a body
#: At once; 50 tablets hold 100 to 300. Then the one goes that has owed a complete request for longest.
MOST_CONNECTIONS: Final = 1024
_FILES_WANTED: Final = 65_536
_FILES_KEPT_FREE: Final = 256  # for buses, journals, recordings and the database
_LOG = structlog.get_logger(__name__)


class BoundedHttp(HttpToolsProtocol):
    """A connection; one whose request line and headers are too long, or come too slowly, is closed."""

    most_connections: ClassVar[int] = MOST_CONNECTIONS
    head_limit_s: ClassVar[float] = HEAD_LIMIT_S

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self._in_head = False
        self._head_bytes = 0
        self._head_limit: asyncio.TimerHandle | None = None
        self._owes_since_s = 0.0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin a connection; where there are too many, the one that owes a request for longest makes room.

        That is this one only where all others are being answered.
        """
        super().connection_made(transport)
        self._owes_since_s = self.loop.time()
        self._wait_for_head()
        if len(self.connections) > self.most_connections:
            owing = [one for one in self.connections if isinstance(one, BoundedHttp) and one.owes_a_request]
            _LOG.warning("connection closed for another", most=self.most_connections)
            min(owing, key=lambda one: one._owes_since_s).give_way()

    def connection_lost(self, exc: Exception | None) -> None:
        """End a connection."""
        self._stop_waiting()
        super().connection_lost(exc)

    @property
    def is_silent(self) -> bool:
        """Whether nothing is asked on it now."""
        cycle: RequestResponseCycle | None = self.cycle
        return cycle is None or cycle.response_complete

    @property
    def owes_a_request(self) -> bool:
        """Whether it is silent, or the body of what it asks is not complete: nothing would be lost with it."""
        cycle: RequestResponseCycle | None = self.cycle
        return self.is_silent or (cycle is not None and cycle.more_body)

    def give_way(self) -> None:
        """Close it at once, whatever it may still have to say."""
        self.connections.discard(self)
        self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Take what came; a head that goes on from the piece before is counted."""
        went_on = self._in_head
        super().data_received(data)
        if self.transport.is_closing():
            return
        if self.is_silent:  # empty lines, or a body that nobody reads any more: they end uvicorn's own waiting
            self._wait_for_head()
        if not self._in_head:
            return
        self._head_bytes = len(data) + (self._head_bytes if went_on else 0)
        if self._head_bytes > LONGEST_HEAD_BYTES:
            self.send_400_response(f"The request's head is longer than {LONGEST_HEAD_BYTES // 1024} KiB: send less.")

    def on_message_begin(self) -> None:
        """Begin a request."""
        self._in_head = True
        self._wait_for_head()
        super().on_message_begin()

    def on_headers_complete(self) -> None:
        """Begin its body."""
        self._in_head = False
        self._owes_since_s = self.loop.time()
        self._stop_waiting()
        super().on_headers_complete()

    def on_response_complete(self) -> None:
        """End an answer."""
        self._owes_since_s = self.loop.time()
        super().on_response_complete()

    def _wait_for_head(self) -> None:
        if self._head_limit is None:
            self._head_limit = self.loop.call_later(self.head_limit_s, self._too_slow)

    def _stop_waiting(self) -> None:
        if self._head_limit is not None:
            self._head_limit.cancel()
            self._head_limit = None

    def _too_slow(self) -> None:
        self._head_limit = None
        if self.transport.is_closing():
            return
        if self._in_head and self.is_silent:
            said = f"The request's head was not complete after {self.head_limit_s:g} s: send it faster."
            head = "HTTP/1.1 408 Request Timeout\r\ncontent-type: text/plain; charset=utf-8\r\nconnection: close\r\n"
            self.transport.write(f"{head}content-length: {len(said)}\r\n\r\n{said}".encode("ascii"))
        self.transport.close()


def provide_files() -> int:
    """Raise the limit of open files as far as the system allows; return how many connections leave enough of them."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = resource.RLIM_INFINITY
    wanted = _FILES_WANTED if hard == unlimited else min(hard, _FILES_WANTED)
    if soft != unlimited and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
        soft = wanted
    return MOST_CONNECTIONS if soft == unlimited else most_connections(soft)


def most_connections(files: int) -> int:
    """Return how many connections leave enough of so many open files."""
    return max(16, min(MOST_CONNECTIONS, files - _FILES_KEPT_FREE))
