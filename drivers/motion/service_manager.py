"""What a service manager is told: ready, alive, ending (sd_notify(3)). Without one that listens nothing is said."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Mapping
from typing import Final

import structlog

_LOG = structlog.get_logger(__name__)
_BEATS_A_PERIOD: Final = 3.0  # sd_watchdog_enabled(3) asks for two


class ServiceManager:
    """Speaks to the socket that the environment names."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{address[1:]}" if address.startswith("@") else address
        watched = environment.get("WATCHDOG_USEC", "")
        for_us = environment.get("WATCHDOG_PID") in (None, str(os.getpid()))
        self._period_s = 1e-6 * int(watched) if watched.isdigit() and for_us else 0.0

    @property
    def listens(self) -> bool:
        """Whether there is a manager."""
        return bool(self._address)

    def say(self, state: str) -> None:
        """Tell one state, such as ``READY=1``. A manager that cannot be reached is no reason to end."""
        if not self._address:
            return
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as line:
                line.connect(self._address)
                line.send(state.encode())
        except OSError as error:
            _LOG.warning("service manager not reached", state=state, reason=str(error))

    async def keep_alive(self) -> None:
        """Say that the event loop turns, as often as the manager asks; end at once where it does not."""
        while self.listens and self._period_s > 0.0:
            self.say("WATCHDOG=1")
            await asyncio.sleep(self._period_s / _BEATS_A_PERIOD)
