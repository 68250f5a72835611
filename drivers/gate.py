"""Who may use a bus next: one at a time, in order of arrival, a stop before all others."""

from __future__ import annotations

import asyncio
from collections import deque


class Gate:
    """A lock with two queues; whoever waits in the priority lane gets it first."""

    def __init__(self) -> None:
        self._held = False
        self._urgent: deque[asyncio.Future[None]] = deque()
        self._ordinary: deque[asyncio.Future[None]] = deque()

    def hold(self, *, priority: bool = False) -> Turn:
        """Return a turn: ``async with`` it, to hold the gate for the length of the block."""
        return Turn(self, self._urgent if priority else self._ordinary)

    async def acquire(self, lane: deque[asyncio.Future[None]]) -> None:
        """Wait for the turn in one of the lanes."""
        if not self._held:
            self._held = True
            return
        turn: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        lane.append(turn)
        try:
            await turn
        except asyncio.CancelledError:
            if turn.done() and not turn.cancelled():
                self.release()  # the turn came in the same instant as the cancellation: pass it on
            else:
                lane.remove(turn)
            raise

    def release(self) -> None:
        """Pass the turn on."""
        for lane in (self._urgent, self._ordinary):
            while lane:
                turn = lane.popleft()
                if not turn.done():
                    turn.set_result(None)
                    return
        self._held = False


class Turn:
    """A turn at a gate, as a context."""

    __slots__ = ("_gate", "_lane")

    def __init__(self, gate: Gate, lane: deque[asyncio.Future[None]]) -> None:
        self._gate = gate
        self._lane = lane

    async def __aenter__(self) -> None:
        """Wait for it."""
        await self._gate.acquire(self._lane)

    async def __aexit__(self, *_: object) -> None:
        """Pass it on."""
        self._gate.release()
