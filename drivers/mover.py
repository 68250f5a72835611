"""Moving a valve during a test: each step is commanded, looked at and judged; a stop ends it at once."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from typing import Final

from drivers.abort_rules import AbortRules
from drivers.bus import Exchange
from drivers.device import ValveDevice
from drivers.outcome import Sample
from valve.errors import DeviceError, EquipmentError

_RAMP_PERIOD_S: Final = 0.05
_LONGEST_STEP_S: Final = 0.2  # of ramp in one command; a slow serial line needs as long for command and look


class StopAskedError(Exception):
    """Somebody asked for the end."""


class OldPermissivesError(Exception):
    """Too much time went by between the permissives and the first write: they must be read again."""


class Mover:
    """Moves one valve within the rules; ``stop`` ends whatever is under way.

    ``wake`` ends a pause at once: it is set where a stop is asked for and where a permissive is lost.
    """

    def __init__(
        self,
        device: ValveDevice,
        rules: AbortRules,
        stop: asyncio.Event,
        wake: asyncio.Event,
        pressure_rate_pa_per_s: float,
    ) -> None:
        self.device = device
        self.rules = rules
        self.written: Exchange | None = None  # the last step's write; None where it wrote none that was confirmed
        self.first_before_s = math.inf  # until when the first write may go out, by time.monotonic
        self._stop = stop
        self._wake = wake
        self._rate_pa_per_s = pressure_rate_pa_per_s

    async def pause_until(self, until_s: float) -> None:
        """Wait until a time of the monotonic clock, or until this must end. Raises as ``require_leave``.

        Who woke it for a place that answers again meanwhile has woken it for nothing: it waits on.
        """
        while True:
            self.require_leave()
            self._wake.clear()  # nothing is awaited between the judgement and this
            delay_s = until_s - time.monotonic()
            if delay_s <= 0.0:
                return
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(delay_s):
                    await self._wake.wait()

    def require_no_stop(self) -> None:
        """Raise StopAskedError where a stop was asked for."""
        if self._stop.is_set():
            raise StopAskedError

    def require_leave(self) -> None:
        """Raise StopAskedError where a stop was asked for, DeviceError where a permissive is lost."""
        self.require_no_stop()
        lost = self.rules.permissive_lost()
        if lost is not None:
            raise lost

    @property
    def stop_asked(self) -> bool:
        """Whether a stop was asked for."""
        return self._stop.is_set()

    async def step(self, pressure_pa: float) -> Sample | None:
        """Look where the last look is old, command, look, judge.

        None where there is no sample to be believed; raises where the test must end. Nothing is commanded where a look
        that was needed failed. A stop is heard after every transaction: raises StopAskedError. Raises
        OldPermissivesError where the first write is late.
        """
        device = self.device
        sample: Sample | None = None
        self.written = None
        if not await self._looked():
            return None
        self._require_fresh()
        try:
            self.rules.commanded(pressure_pa)
            self.written = await device.drive(pressure_pa)
            await device.feed_watchdog()
            self.require_no_stop()
            sample = await device.read()
            self.require_no_stop()
        except EquipmentError as error:
            self.rules.missed(error)
        self._judge(sample)
        return sample if self.rules.believed else None

    async def _looked(self) -> bool:
        """Look first where nobody knows what is in force, or the last look is old; False where that look failed."""
        device, sample = self.device, None
        unknown = math.isnan(device.in_force_pa)
        if not (unknown or self.rules.look_is_old):
            self.require_leave()
            return True
        try:
            sample = await device.read()
        except EquipmentError as error:
            self.rules.missed(error)
        self.require_no_stop()
        if sample is not None:
            device.adopt(sample)
        self._judge(sample, follows=not unknown)
        return sample is not None

    def _require_fresh(self) -> None:
        if not self.device.commanded and time.monotonic() > self.first_before_s:
            raise OldPermissivesError

    def _judge(self, sample: Sample | None, *, follows: bool = True) -> None:
        fault = self.rules.fault(sample, follows=follows)
        if fault is not None:
            raise fault

    async def glance(self) -> None:
        """Look between two steps whether the output is still ours; raises where it is, again, somebody else's."""
        if math.isnan(self.device.in_force_pa):
            return
        fault: DeviceError | None = None
        try:
            fault = self.rules.foreign(await self.device.output_pa())
        except EquipmentError as error:
            self.rules.missed(error)
        self.require_leave()
        if fault is not None:
            raise fault

    async def ramp_to(self, target_pa: float, from_pa: float | None = None) -> None:
        """Go from where the output is to ``target_pa`` at no more than the allowed rate, and see it there.

        ``from_pa`` is the output where it was read a moment ago.
        """
        pressure_pa = await self._present_output_pa() if from_pa is None else from_pa
        then_s = time.monotonic()
        while pressure_pa != target_pa:
            now_s = time.monotonic()
            # After a disturbance the ramp goes on from where it was: no leap makes up for the time.
            reach_pa = self._rate_pa_per_s * min(now_s - then_s, _LONGEST_STEP_S)
            next_pa = pressure_pa + min(max(target_pa - pressure_pa, -reach_pa), reach_pa)
            if await self.step(next_pa) is not None:
                pressure_pa, then_s = next_pa, now_s
            if pressure_pa != target_pa:
                await self.pause_until(time.monotonic() + _RAMP_PERIOD_S)
        self.require_leave()
        self._require_fresh()
        self.rules.commanded(target_pa)
        await self.device.command(target_pa, after_each=self.require_leave)

    async def _present_output_pa(self) -> float:
        while True:
            sample: Sample | None = None
            try:
                sample = await self.device.read()
            except EquipmentError as error:
                self.rules.missed(error)
            self.require_leave()
            if sample is not None:
                return sample.output_pa
            self._judge(None)
