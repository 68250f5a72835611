"""Many valves in service behind Modbus TCP ports, in a process of their own: reads are answered at once.

Each has the reference map, and stands on its loop's output as a valve with a dead band does: it rests, and then slips
after it. Any function but 3 is refused with exception 1, which whoever asked counts as failed.
"""

from __future__ import annotations

import asyncio
import random
import signal
import struct
import sys
import time
from typing import Final

from drivers.crc import words_crc16
from drivers.maps.reference import CANARY_VALUE

SPAN_PA: Final = 82_737.0
TRAVEL_M: Final = 0.1016
_DEAD_BAND: Final = 0.04  # of the travel
_NOISE_M: Final = 2.0e-5
_LOOP_S: Final = 120.0
_IDENTITY: Final = (CANARY_VALUE >> 16, CANARY_VALUE & 0xFFFF, 1, 0, 1, 1)


class _Valve:
    """One valve: where its loop asks it to be, and where it stands."""

    def __init__(self, number: int) -> None:
        self._phase_s = number * 7.3
        self._random = random.Random(number)
        self._stands = 0.5
        self._counter = 0

    def live(self) -> tuple[int, ...]:
        """Words 16 to 28 of the map, as they are now."""
        now_s = time.monotonic()
        share = abs(((now_s + self._phase_s) / _LOOP_S) % 2.0 - 1.0)
        if abs(share - self._stands) > _DEAD_BAND:
            self._stands = share
        self._counter = (self._counter + 1) & 0xFFFF
        clock_us = int(now_s * 1.0e6) & 0xFFFFFFFF
        position_m = TRAVEL_M * self._stands + self._random.gauss(0.0, _NOISE_M)
        packed = struct.pack(">I4f2H", clock_us, position_m, SPAN_PA * share, SPAN_PA * share, 2.0e5, 0, self._counter)
        words = struct.unpack(">12H", packed)
        return (*words, words_crc16(words))


class _Port(asyncio.Protocol):
    """One connection to a port; ``valves`` by device id."""

    def __init__(self, valves: dict[int, _Valve]) -> None:
        self._valves = valves
        self._heard = b""
        self._transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self._heard += data
        while len(self._heard) >= 12:
            head, self._heard = self._heard[:12], self._heard[12:]
            unit, function, address, count = struct.unpack(">BBHH", head[6:12])
            if function != 3:
                self._transport.write(head[:4] + b"\0\3" + bytes((unit, function | 0x80, 1)))
                continue
            words = self._valves[unit].live() if address == 16 else _IDENTITY[address : address + count]
            answer = struct.pack(f">BBB{count}H", unit, 3, 2 * count, *words)
            self._transport.write(head[:4] + len(answer).to_bytes(2, "big") + answer)


async def serve(ports: list[int], valves: int) -> None:
    """Serve so many valves on each port until a signal ends it."""
    loop, ending = asyncio.get_running_loop(), asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ending.set)
    for place, port in enumerate(ports):
        of_port = {unit: _Valve(place * valves + unit) for unit in range(1, valves + 1)}
        await loop.create_server(lambda of_port=of_port: _Port(of_port), "127.0.0.1", port)  # type: ignore[misc]
    print("serving", file=sys.stderr, flush=True)
    await ending.wait()


if __name__ == "__main__":
    asyncio.run(serve([int(one) for one in sys.argv[2:]], int(sys.argv[1])))
