"""A displacement gauge on a serial line: an ASCII request, an ASCII answer, one position."""

from __future__ import annotations

import asyncio
import math
import re
import termios
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Final, TypeVar

import serial

from drivers.addresses import GaugeAddress
from drivers.bus import Reading
from drivers.bus_queue import BusQueue
from drivers.faults import BadAnswerError, ConnectionLostError, NoAnswerError
from drivers.serial_port import why_not_opened
from valve.errors import WireError
from valve.messages import message_of, say
from valve.units import SI_FACTORS

_Result = TypeVar("_Result")

_LONGEST_ANSWER_BYTES: Final = 256
_SLICE_S: Final = 0.02  # longest wait inside one call of pyserial, so that our own deadline is kept


class SerialGauge:
    """A gauge that answers one request at a time; pyserial works in a thread of its own."""

    def __init__(self, address: GaugeAddress) -> None:
        self.address = address
        self._pattern = re.compile(address.pattern)
        self._queue = BusQueue()
        self._thread: ThreadPoolExecutor | None = None
        self._line: serial.Serial | None = None
        self._wanted = False
        self._quiet_until_s = 0.0

    @property
    def name(self) -> str:
        """Name of the bus in the configuration."""
        return self.address.name

    async def open(self) -> None:
        """Open the line. Raises ConnectionLostError where that fails."""
        self._wanted = True
        if self._thread is None:
            self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix=f"gauge-{self.name}")
        async with self._queue.hold():
            await self._in_thread(self._open)

    async def close(self) -> None:
        """Close the line; a reading under way ends at its deadline first."""
        self._wanted = False
        thread, self._thread = self._thread, None
        if thread is not None:
            await asyncio.get_running_loop().run_in_executor(thread, self._close)
            thread.shutdown(wait=False)

    async def read(self, *, priority: bool = False) -> Reading:
        """Ask once. Raises WireError where no answer came in time or it is no position."""
        async with self._queue.hold(priority=priority):
            if not self._wanted:
                raise ConnectionLostError(say("bus_closed", "bus {bus}: it is closed, open it first", bus=self.name))
            return await self._in_thread(self._ask)

    async def _in_thread(self, work: Callable[[], _Result]) -> _Result:
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    # ---- in the thread

    def _open(self) -> None:
        self._close()
        address = self.address
        try:
            self._line = serial.Serial(
                address.serial_port,
                baudrate=address.baud_rate,
                parity=address.parity.value,
                stopbits=address.stop_bits,
                timeout=_SLICE_S,
                write_timeout=address.timeout_s,
                exclusive=True,
            )
        except (OSError, ValueError, termios.error) as error:
            reason = why_not_opened(address.serial_port, error)
            raise ConnectionLostError(
                say(
                    "gauge_cannot_be_opened",
                    "bus {bus}: {port} cannot be opened: {why}",
                    bus=self.name,
                    port=address.serial_port,
                    why=reason,
                )
            ) from error

    def _close(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            line.close()

    def _ask(self) -> Reading:
        try:
            return self._asked()
        except WireError:
            # The answer may still be under way: it must not meet the next request.
            self._quiet_until_s = time.monotonic() + self.address.timeout_s
            raise
        except (OSError, termios.error, TypeError) as error:
            # TypeError: pyserial reads from a line that was closed under it.
            self._close()
            raise ConnectionLostError(
                say(
                    "gauge_line_broke",
                    "bus {bus}: the line broke ({why}): check the gauge",
                    bus=self.name,
                    why=message_of(error),
                )
            ) from error

    def _asked(self) -> Reading:
        if self._line is None:
            self._open()
        line = self._line
        if line is None:
            raise ConnectionLostError(say("gauge_not_open", "bus {bus}: it is not open", bus=self.name))
        while time.monotonic() < self._quiet_until_s:
            line.read(_LONGEST_ANSWER_BYTES)
        line.reset_input_buffer()
        sent_s = time.monotonic()
        line.write(self.address.request.encode("ascii"))
        answer = self._until_terminator(line, sent_s + self.address.timeout_s)
        return Reading(self._position_m(answer), sent_s, time.monotonic())

    def _until_terminator(self, line: serial.Serial, deadline_s: float) -> bytes:
        terminator = self.address.terminator.encode("ascii")
        heard = b""
        while not heard.endswith(terminator):
            if time.monotonic() >= deadline_s or len(heard) > _LONGEST_ANSWER_BYTES:
                raise NoAnswerError(
                    say(
                        "gauge_no_answer",
                        "bus {bus}: {bytes} bytes and no whole answer within {time:g s}: check the gauge, its "
                        "request and its terminator",
                        bus=self.name,
                        bytes=len(heard),
                        time=self.address.timeout_s,
                    )
                )
            heard += line.read(1)
        return heard.removesuffix(terminator)

    def _position_m(self, answer: bytes) -> float:
        text = answer.decode("ascii", "replace")
        match = self._pattern.search(text)
        try:
            value = math.nan if match is None else float(match["value"])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise BadAnswerError(
                say(
                    "gauge_answer_without_position",
                    "bus {bus}: the answer {answer} does not hold a position: check the pattern",
                    bus=self.name,
                    answer=repr(text),
                )
            )
        return value * SI_FACTORS[self.address.unit][1]
