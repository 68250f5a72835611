"""Tablets that look and programs that ask, as a process of its own that costs little beside the service.

``python -m tests.bench.benchmarks.callers`` takes one line of JSON on standard input (``port``, ``tests``, ``tablets``,
``requests_per_s``, ``device``: the port of one that no test uses), calls until standard input closes, and answers with
one line: ``answers_s``, ``failed``, ``events``, ``bytes``, ``device_s``, ``used_s``.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import sys
import time
from collections import deque
from functools import partial
from typing import Any, Final, cast

import uvloop

from tests.bench.benchmarks.device_probe import probe

_HEADERS_END: Final = b"\r\n\r\n"
_LENGTH: Final = b"content-length:"
_OK: Final = b"HTTP/1.1 200 "


class Tablet(asyncio.Protocol):
    """One live view: a stream of events that is counted and not parsed."""

    def __init__(self, request: bytes) -> None:
        self._request = request
        self._before = b""
        self.events = 0
        self.bytes = 0
        self.failed = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Ask for the stream."""
        cast("asyncio.WriteTransport", transport).write(self._request)

    def data_received(self, data: bytes) -> None:
        """Count the events; one that came in two pieces counts once."""
        if self.bytes == 0 and not data.startswith(_OK):
            self.failed = 1
        whole = self._before + data
        self.events += whole.count(b"\nevent:")
        self._before = whole[-6:]  # shorter than what is counted, so nothing counts twice
        self.bytes += len(data)


class Line(asyncio.Protocol):
    """A connection that is kept: one request after the other, each answered by as many bytes as its length says."""

    def __init__(self, callers: Callers) -> None:
        self._callers = callers
        self._transport: asyncio.WriteTransport | None = None
        self._received = b""
        self._missing: int | None = None
        self._due_s: float | None = None
        self._ok = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin with nothing under way."""
        self._transport = cast("asyncio.WriteTransport", transport)  # uvloop's own is no subclass of it

    def ask(self, request: bytes, due_s: float) -> None:
        """Send a request that was due at ``due_s``."""
        assert self._transport is not None
        self._due_s, self._received, self._missing = due_s, b"", None
        self._transport.write(request)

    def data_received(self, data: bytes) -> None:
        """Take a piece of the answer."""
        if self._missing is None:
            self._received += data
            head, found, body = self._received.partition(_HEADERS_END)
            if not found:
                return
            self._ok = head.startswith(_OK)
            lengths = [line[len(_LENGTH) :] for line in head.lower().split(b"\r\n") if line.startswith(_LENGTH)]
            self._missing = int(lengths[0]) - len(body)
        else:
            self._missing -= len(data)
        if self._missing <= 0 and self._due_s is not None:
            due_s, self._due_s = self._due_s, None
            self._callers.answered(due_s, ok=self._ok)
            self._callers.idle.append(self)

    def connection_lost(self, _error: Exception | None) -> None:
        """A request that was under way has failed; an idle line is not used again."""
        if self._due_s is not None:
            self._callers.answered(self._due_s, ok=False)
        elif self in self._callers.idle:
            self._callers.idle.remove(self)


class Callers:
    """Requests by the clock, whether the one before was answered or not; an answer's time counts from then."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._asking: set[asyncio.Task[None]] = set()
        self.idle: deque[Line] = deque()
        self.open: list[float] = []
        self.answers_s: list[float] = []
        self.failed = 0

    def answered(self, due_s: float, *, ok: bool) -> None:
        """Note an answer that has come, or never will."""
        self.open.remove(due_s)
        self.answers_s.append(asyncio.get_running_loop().time() - due_s)
        self.failed += not ok

    async def _ask(self, request: bytes, due_s: float) -> None:
        self.open.append(due_s)
        try:
            line = self.idle.pop() if self.idle else await self._new_line()
        except OSError:
            self.answered(due_s, ok=False)
            return
        line.ask(request, due_s)

    async def _new_line(self) -> Line:
        _, line = await asyncio.get_running_loop().create_connection(partial(Line, self), "127.0.0.1", self._port)
        return line

    async def run(self, requests: list[bytes], per_s: float) -> None:
        """Ask until cancelled; what is still waiting then took at least so long."""
        loop = asyncio.get_running_loop()
        began_s = loop.time()
        try:
            for number, request in enumerate(itertools.cycle(requests)):
                due_s = began_s + number / per_s
                await asyncio.sleep(max(0.0, due_s - loop.time()))
                task = loop.create_task(self._ask(request, due_s))
                self._asking.add(task)
                task.add_done_callback(self._asking.discard)
        finally:
            self.answers_s += [loop.time() - due_s for due_s in self.open]


def _get(path: str, port: int) -> bytes:
    return f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAccept: */*\r\n\r\n".encode()


async def _call(wanted: dict[str, Any]) -> dict[str, Any]:
    loop, port, tests = asyncio.get_running_loop(), int(wanted["port"]), list(wanted["tests"])
    ended = loop.run_in_executor(None, sys.stdin.read)
    tablets: list[Tablet] = []
    for number in range(int(wanted["tablets"])):
        making = partial(Tablet, _get(f"{tests[number % len(tests)]}/events", port))
        _, tablet = await loop.create_connection(making, "127.0.0.1", port)
        tablets.append(tablet)
    paths = ["/valves", "/valves/FV-3", "/tests", tests[0], "/healthz", "/", tests[-1], "/valves/FV-9"]
    callers = Callers(port)
    device_s: list[float] = []
    calling = [asyncio.create_task(probe(int(wanted["device"]), device_s))]
    if wanted["requests_per_s"]:
        requests = [_get(path, port) for path in paths]
        calling.append(asyncio.create_task(callers.run(requests, float(wanted["requests_per_s"]))))
    await ended
    for one in calling:
        one.cancel()
    ends = await asyncio.gather(*calling, return_exceptions=True)
    assert all(isinstance(end, asyncio.CancelledError) for end in ends), ends
    return {
        "answers_s": callers.answers_s,
        "failed": callers.failed + sum(one.failed for one in tablets),
        "events": sum(one.events for one in tablets),
        "bytes": sum(one.bytes for one in tablets),
        "device_s": device_s,
    }


def main() -> None:
    """Call, and say what came."""
    called = uvloop.run(_call(json.loads(sys.stdin.readline())))
    print(json.dumps({**called, "used_s": time.process_time()}), flush=True)


if __name__ == "__main__":
    main()
