"""A displacement gauge on a serial line that does not exist: an ASCII request, the stem's position as text."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import tty
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from simulator.faults import FaultKind
from simulator.plant import SoftwareValve
from simulator.serial_line import SerialLine
from valve.errors import ConfigurationError
from valve.messages import say
from valve.units import SI_FACTORS

# What gauges print; the first form that the configured pattern reads back is used.
_FORMS: Final = ("{value:+.4f} {unit}", "{value:.4f} {unit}", "{value:+.4f}{unit}", "{value:+.4f}", "{value:.4f}")
_LONGEST_REQUEST: Final = 256


@dataclass(frozen=True, slots=True)
class GaugeListener:
    """A gauge's line: where the master opens it, and what is said on it. ``pattern`` has a group ``value``."""

    link_path: Path
    request: str
    pattern: str
    terminator: str = "\r\n"
    unit: str = "mm"


def answer_form(listener: GaugeListener) -> str:
    """Return a form of answer that the listener's pattern reads. Raises ConfigurationError where none is known."""
    for form in _FORMS:
        found = re.search(listener.pattern, form.format(value=12.3456, unit=listener.unit))
        if found is not None and float(found["value"]) == 12.3456:
            return form
    raise ConfigurationError(
        say(
            "gauge_pattern_unmatched",
            "{link}: pattern {pattern} reads no answer of the simulated gauge as 12.3456: use one for {format}",
            link=str(listener.link_path),
            pattern=repr(listener.pattern),
            format=repr(_FORMS[0].format(value=12.3456, unit=listener.unit)),
        )
    )


class Gauge:
    """Shows one valve's position on one serial line, from ``start`` to ``stop``."""

    def __init__(self, listener: GaugeListener, valve: SoftwareValve, now_s: Callable[[], float]) -> None:
        self.listener = listener
        self.tag = valve.settings.tag
        self._form = answer_form(listener)
        self._valve, self._now_s = valve, now_s
        self.line: SerialLine | None = None
        self._port = -1
        self._received = b""

    async def start(self) -> str:
        """Answer requests; return the path of the line. Raises ConfigurationError where it cannot be made."""
        self.line = SerialLine(self.listener.link_path)
        self._port = os.open(self.line.device_port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._port)
        asyncio.get_running_loop().add_reader(self._port, self._answer)
        return str(self.listener.link_path)

    async def stop(self) -> None:
        """Remove the line."""
        if self.line is not None:
            asyncio.get_running_loop().remove_reader(self._port)
            os.close(self._port)
            self.line.close()
            self.line = None

    def _answer(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._received = (self._received + os.read(self._port, _LONGEST_REQUEST))[-_LONGEST_REQUEST:]
        if not self._received.endswith(self.listener.request.encode()):
            return
        self._received = b""
        self._valve.look(self._now_s())
        if self._valve.fault(FaultKind.SILENCE) is not None:
            return
        value = self._valve.read_position_m() / SI_FACTORS[self.listener.unit][1]
        text = self._form.format(value=value, unit=self.listener.unit) + self.listener.terminator
        with contextlib.suppress(BlockingIOError):
            os.write(self._port, text.encode())
