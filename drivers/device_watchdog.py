"""The watchdog of a device: armed with a safe value, fed by a changed heartbeat, switched off."""

from __future__ import annotations

import math
import time

from drivers.capabilities import Watchdog
from drivers.wiring import Unit
from valve.errors import DeviceError
from valve.messages import say


class DeviceWatchdog:
    """The timer in a valve's device; without one, or without ``timeout_s``, nothing is ever written.

    Every write says whose it is (``run_number``) and what is driven where the timer runs out (``safe_value_pa``).
    """

    def __init__(self, tag: str, unit: Unit, timeout_s: float | None, tolerance_pa: float) -> None:
        self.fed_s = -math.inf  # when a command or a heartbeat last fed it, by time.monotonic
        self._tag = tag
        self._unit = unit
        self._timeout_s = timeout_s
        self._tolerance_pa = tolerance_pa
        self._heartbeat = 0

    @property
    def is_used(self) -> bool:
        """Whether the device has a watchdog and the wiring says how long it waits."""
        return self._unit.map.watchdog is not None and self._timeout_s is not None

    async def arm(self, run_number: int, safe_value_pa: float) -> None:
        """Set the safe value and the timeout, and read both back. Raises DeviceError where they do not stick."""
        watchdog, timeout_s = self._unit.map.watchdog, self._timeout_s
        if watchdog is None or timeout_s is None:
            return
        self._heartbeat = round(await self._unit.value(watchdog.heartbeat))
        await self._write(watchdog, timeout_s, run_number, safe_value_pa)
        shown = await self._unit.values(watchdog.timeout, watchdog.state, watchdog.safe_value)
        timeout = self._unit.map.register(watchdog.timeout)
        if (
            shown[watchdog.state] != watchdog.armed
            or abs(shown[watchdog.timeout] - timeout.nearest(timeout_s)) > timeout.resolution
            or not abs(shown[watchdog.safe_value] - safe_value_pa) <= self._tolerance_pa
        ):
            raise DeviceError(
                say(
                    "watchdog_not_armed",
                    "{tag}: {time:g s} and {safe:g Pa} were written to the watchdog of {device} and it is not "
                    "armed with them: check the device",
                    tag=self._tag,
                    time=timeout_s,
                    safe=safe_value_pa,
                    device=self._unit.subject,
                )
            )

    async def disarm(self, run_number: int, safe_value_pa: float) -> None:
        """Switch the watchdog off. Raises DeviceError where it stays on."""
        watchdog = self._unit.map.watchdog
        if watchdog is None or not self.is_used:
            return
        await self._write(watchdog, 0.0, run_number, safe_value_pa)
        if await self._unit.value(watchdog.state) == watchdog.armed:
            raise DeviceError(
                say(
                    "watchdog_not_switched_off",
                    "{tag}: the watchdog of {device} stays armed after it was switched off",
                    tag=self._tag,
                    device=self._unit.subject,
                )
            )

    async def feed(self, run_number: int, safe_value_pa: float) -> None:
        """Change the heartbeat where nothing has fed the watchdog for a quarter of its timeout."""
        watchdog, timeout_s = self._unit.map.watchdog, self._timeout_s
        if watchdog is None or timeout_s is None or time.monotonic() - self.fed_s < 0.25 * timeout_s:
            return
        await self._write(watchdog, timeout_s, run_number, safe_value_pa)

    async def _write(self, watchdog: Watchdog, timeout_s: float, run_number: int, safe_value_pa: float) -> None:
        self._heartbeat = (self._heartbeat + 1) & 0xFFFF
        whose = {} if watchdog.run is None else {watchdog.run: float(run_number)}
        exchange = await self._unit.write(
            whose
            | {
                watchdog.timeout: timeout_s,
                watchdog.heartbeat: self._heartbeat,
                watchdog.safe_value: safe_value_pa,
            }
        )
        self.fed_s = exchange.sent_s
