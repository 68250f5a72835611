"""The permissives while the test runs: one that is lost ends it, and so does somebody else who takes the device.

What a sample shows is judged with the sample. What stands elsewhere is read beside the test, each by itself: neither
does a contact's dead bus hold up the valve's samples, nor do those hide that it is dead.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable
from typing import Final

from drivers.device import ValveDevice
from drivers.outcome import Sample
from drivers.recent import WINDOW_S, Recent
from valve.errors import DeviceError, EquipmentError
from valve.messages import message_of, say

_LOST: Final = 2  # looks within the window: a scan may catch a contact while it bounces
_READS: Final = 4.0  # of a place elsewhere within the time that it may stay unread: one may be lost
_AGAIN_S: Final = 0.05  # until it is read again where it was not read or does not hold
_HANGS: Final = 3.0  # times the time that it may stay unread, without even a failure: then reading itself hangs
_OWNER_PERIOD_S: Final = 1.0
_REASONS: Final = {
    "manual": say("loop_left_manual", "the loop is no longer in manual: somebody else commands the valve"),
    "interlock": say("interlock_became_active", "an interlock became active"),
    "supply": say("supply_left_limits", "the air supply left its limits: check it"),
}


class PermissiveWatch:
    """Watches one test. ``permitted`` tells that a permit stands for the manual mode.

    ``on_lost`` is called, while ``run`` reads, where one of those that no sample shows is lost: nobody waits for the
    next sample then.
    """

    def __init__(
        self,
        device: ValveDevice,
        *,
        permitted: bool,
        within_s: float = WINDOW_S,
        on_lost: Callable[[], None] = lambda: None,
    ) -> None:
        self._on_lost = on_lost
        self._device = device
        rules = device.wiring.permissives
        self._needs_manual = not permitted and not rules.manual_waived
        self._within_s = within_s
        self._shown_lost = Recent(_LOST, within_s)
        self._elsewhere = [
            name for name in sorted(device.conditions_elsewhere) if name != "manual" or self._needs_manual
        ]
        self._held_s: dict[str, float] = {}  # when each place elsewhere was last seen to permit, monotonic
        self._unread: dict[str, str] = {}  # why it was not read since
        self._lost: DeviceError | None = None
        self._ended = asyncio.Event()

    # ---- what a sample shows

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
        return self._error(lost) if lost and self._shown_lost.note(sample.received_s) else None

    # ---- what it does not show

    def lost(self) -> DeviceError | None:
        """Return why the test must end, by what was read elsewhere, or could not be; nothing is asked for it."""
        if self._lost is not None:
            return self._lost
        now_s = time.monotonic()
        for name, held_s in self._held_s.items():
            unread_s, may_s = now_s - held_s, self._device.unread_s(name)
            if unread_s > may_s and (name in self._unread or unread_s > _HANGS * may_s):
                return DeviceError(
                    say(
                        "permissive_unread",
                        "{tag}: permissive lost: {name}: {place} could not be read for {unread:.2g s}, {may:.2g s} "
                        "are allowed ({why}): check that bus and its device",
                        tag=self._device.tag,
                        name=name,
                        place=self._device.place_of(name),
                        unread=unread_s,
                        may=may_s,
                        why=self._unread.get(name, say("unanswered", "no answer")),
                    )
                )
        return None

    def begin(self) -> None:
        """Count from now: everything elsewhere was read a moment ago, and permitted."""
        self._held_s = dict.fromkeys(self._elsewhere, time.monotonic())

    def end(self) -> None:
        """Ask for nothing more; ``run`` returns when the last reading has come back."""
        self._ended.set()

    async def run(self) -> None:
        """Read what stands elsewhere, until ``end``."""
        await asyncio.gather(self._watch_owner(), self._watch_time(), *(self._watch(name) for name in self._elsewhere))

    async def _paused(self, pause_s: float) -> bool:
        """Wait; return whether the watch goes on."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(pause_s):
                await self._ended.wait()
        return not self._ended.is_set()

    async def _watch(self, name: str) -> None:
        lost, pause_s = Recent(_LOST, self._within_s), self._device.unread_s(name) / _READS
        while await self._paused(pause_s):
            pause_s = _AGAIN_S
            asked_s = time.monotonic()
            try:
                holds = await self._holds(name)
            except EquipmentError as error:
                self._unread[name] = message_of(error)
                continue
            if holds is None:
                self._unread[name] = say("no_valid_value", "it shows no valid value")
            elif holds:
                self._unread.pop(name, None)
                self._held_s[name], pause_s = asked_s, self._device.unread_s(name) / _READS
            elif lost.note(asked_s):
                self._lose(self._error(name))

    async def _holds(self, name: str) -> bool | None:
        """Whether a place elsewhere permits the test; None where what it shows is not valid."""
        if name == "manual":
            return await self._device.loop_in_manual(None)
        if name == "interlock":
            active = await self._device.interlocked(None)
            return None if active is None else not active
        return not self._bad_supply(await self._device.supply_pa(None))

    async def _watch_owner(self) -> None:
        foreign = Recent(_LOST, self._within_s)
        pause_s = _OWNER_PERIOD_S
        while await self._paused(pause_s):
            pause_s = _OWNER_PERIOD_S
            try:
                shown = await self._device.owner()
            except EquipmentError:
                continue  # the samples of the same device tell that it does not answer
            if shown is None:
                return
            if shown != self._device.run_number:
                pause_s = _AGAIN_S
                if foreign.note(time.monotonic()):
                    self._lose(self._foreign(shown))

    async def _watch_time(self) -> None:
        """Hear of a place that was not read for too long; also where reading itself hangs."""
        while self._elsewhere and await self._paused(_AGAIN_S):
            if self.lost() is not None:
                self._on_lost()

    def _lose(self, error: DeviceError) -> None:
        self._lost = self._lost or error
        self._on_lost()

    def _foreign(self, owner: int) -> DeviceError:
        device = self._device
        if owner == 0:
            return DeviceError(
                say(
                    "device_no_longer_ours",
                    "{tag}: {device} is no longer ours: its watchdog tripped, it restarted or another master "
                    "released it",
                    tag=device.tag,
                    device=device.unit.subject,
                )
            )
        return DeviceError(
            say(
                "device_taken_by_run",
                "{tag}: run {run} took {device}: another master is on the bus",
                tag=device.tag,
                run=owner,
                device=device.unit.subject,
            )
        )

    def _bad_supply(self, supply_pa: float) -> bool:
        limits = self._device.wiring.permissives.supply_pa
        return limits is not None and not limits[0] <= supply_pa <= limits[1]  # an unknown supply is a bad one too

    def _error(self, lost: str) -> DeviceError:
        return DeviceError(
            say("permissive_lost", "{tag}: permissive lost: {reasons}", tag=self._device.tag, reasons=_REASONS[lost])
        )
