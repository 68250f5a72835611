"""The permissives while the test runs: one that is lost ends it, and so does somebody else who takes the device."""

from __future__ import annotations

import time
from typing import Final

from drivers.device import ValveDevice
from drivers.outcome import Sample
from valve.errors import DeviceError

_LOST: Final = 2  # samples in a row: a scan may catch a contact while it bounces
_PERIOD_S: Final = 1.0  # between looks at what a sample does not show
_REASONS: Final = {
    "manual": "the loop is no longer in manual: somebody else commands the valve",
    "interlock": "an interlock became active",
    "supply": "the air supply left its limits: check it",
}


class PermissiveWatch:
    """Watches one test. ``permitted`` tells that a permit stands for the manual mode."""

    def __init__(self, device: ValveDevice, *, permitted: bool) -> None:
        self._device = device
        rules = device.wiring.permissives
        self._needs_manual = not permitted and not rules.manual_waived
        self._lost = 0
        self._next_s = time.monotonic() + _PERIOD_S

    def judge(self, sample: Sample) -> DeviceError | None:
        """Return why the test must end, by what one sample shows."""
        live = self._device.unit.map.live
        lost = ""
        if live is not None:
            wired = self._device.conditions_elsewhere
            if self._needs_manual and "manual" not in wired and not sample.status & live.manual_mask:
                lost = "manual" if live.manual_mask else ""
            if "interlock" not in wired and sample.status & live.interlock_mask:
                lost = "interlock"
            if sample.status & live.supply_low_mask or ("supply" not in wired and self._bad_supply(sample.supply_pa)):
                lost = "supply"
        self._lost = self._lost + 1 if lost else 0
        return self._error(lost) if self._lost >= _LOST else None

    async def look(self, sample: Sample) -> DeviceError | None:
        """Look at what a sample does not show, where it is time to. Raises WireError or DeviceError."""
        if time.monotonic() < self._next_s:
            return None
        self._next_s = time.monotonic() + _PERIOD_S
        return await self._foreign_owner() or await self._lost_elsewhere(sample)

    async def _foreign_owner(self) -> DeviceError | None:
        device, owner = self._device, 0
        for _ in range(_LOST):
            shown = await device.owner()
            if shown is None or shown == device.run_number:
                return None
            owner = shown
        if owner == 0:
            return DeviceError(
                f"{device.tag}: {device.unit.subject} is no longer ours: its watchdog tripped, it restarted or "
                "another master released it"
            )
        return DeviceError(f"{device.tag}: run {owner} took {device.unit.subject}: another master is on the bus")

    async def _lost_elsewhere(self, sample: Sample) -> DeviceError | None:
        device, wired, lost = self._device, self._device.conditions_elsewhere, ""
        for _ in range(_LOST):
            lost = ""
            if self._needs_manual and "manual" in wired and await device.loop_in_manual(sample) is not True:
                lost = "manual"
            if "interlock" in wired and await device.interlocked(sample) is not False:
                lost = "interlock"
            if "supply" in wired and self._bad_supply(await device.supply_pa(sample)):
                lost = "supply"
            if not lost:
                return None
        return self._error(lost)

    def _bad_supply(self, supply_pa: float) -> bool:
        limits = self._device.wiring.permissives.supply_pa
        return limits is not None and not limits[0] <= supply_pa <= limits[1]  # an unknown supply is a bad one too

    def _error(self, lost: str) -> DeviceError:
        return DeviceError(f"{self._device.tag}: permissive lost: {_REASONS[lost]}")
