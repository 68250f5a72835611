"""A look at one more device by the clock, which tells how soon the devices themselves answer."""

from __future__ import annotations

import asyncio
import time
from typing import Final

_PERIOD_S: Final = 0.02
_LIVE: Final = bytes.fromhex("0000 0000 0006 01 03 0010 000d")  # a read of the reference map's live block
_ANSWER_BYTES: Final = 9 + 2 * 13


async def probe(port: int, answers_s: list[float]) -> None:
    """Read the live block of the device at a port once a period until cancelled, and note how long each took, s."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    due_s = time.monotonic()  # an event loop's own clock may count whole milliseconds
    try:
        while True:
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))
            sent_s = time.monotonic()
            writer.write(_LIVE)
            await reader.readexactly(_ANSWER_BYTES)
            answers_s.append(time.monotonic() - sent_s)
            due_s = max(due_s + _PERIOD_S, time.monotonic())
    finally:
        writer.close()
