"""What a test needs of a valve on its wires: who it is, whose it is, look at it, move it, make it safe."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Final

from drivers.addresses import ValveWiring
from drivers.bus import Bus, Exchange
from drivers.capabilities import Fence
from drivers.capture_buffer import CaptureBuffer
from drivers.device_watchdog import DeviceWatchdog
from drivers.identity import require_identity
from drivers.outcome import SafeOutcome, Sample
from drivers.registers import Block
from drivers.sampler import Sampler
from drivers.wiring import Signal, Unit, Wired, WiredContact, wire
from valve.errors import BusyError, ConfigurationError, DeviceError, EquipmentError, ValveError
from valve.messages import fault_words, joined, message_of, say

_SAFE_ATTEMPTS: Final = 3
_APART_SHARE: Final = 0.1  # of the limits' span, by which a gauge and an I/P may differ
_LOOK_PAUSE_S: Final = 0.1
_SAFE_DEADLINE_S: Final = 6.0  # then only the device's own watchdog can act, and the outcome says "not confirmed"
_SETTLING_S: Final = 0.6  # a PLC's scan and its output card; the valve may take longer, the command may not
_SETTLED_READS: Final = 2  # a slave that wakes up may still carry out an older write: one fitting read is too few
_UNSEEN_READS: Final = 3  # looks in a row that failed; a lost answer costs a serial line longer than the settling
_READ_PAUSE_S: Final = 0.02
_LOST_ANSWERS: Final = 1.4  # a quarter of the time that a place may stay unread passes before it is asked again
_UNREAD_SLACK_S: Final = 0.15


def _goes_on() -> None:
    """Do not end what is under way."""


class ValveDevice:
    """One valve on its devices. Buses are opened, closed and shared by the caller."""

    def __init__(self, wiring: ValveWiring, wired: Wired) -> None:
        self.wiring = wiring
        self.safe_value_pa = math.nan if wiring.safe_value_pa == "entry" else wiring.safe_value_pa
        self.in_force_pa = math.nan  # what was written last and confirmed; NaN while nobody knows
        self._asked_pa = math.nan
        self.run_number = 0
        #: Whether anything that can move the valve was sent: set before the first such write, never taken back.
        self.commanded = False
        self.last_seen: Sample | None = None
        self._wired = wired
        self._sampler = Sampler(wiring.tag, wired)
        places = {"manual": wired.manual, "interlock": wired.interlock, "supply": wired.supply}
        self._elsewhere = {name: place for name, place in places.items() if place is not None}
        self.tolerance_pa = wired.tolerance_pa(wiring.limits)
        self._watchdog = DeviceWatchdog(wiring.tag, self.unit, wiring.watchdog.timeout_s, self.tolerance_pa)
        capture = self.unit.map.capture
        self.buffer = None if capture is None else CaptureBuffer(wiring.tag, self.unit, capture)

    @property
    def tag(self) -> str:
        """Tag of the valve."""
        return self.wiring.tag

    @property
    def unit(self) -> Unit:
        """Device that the valve is commanded through."""
        return self._wired.command.unit

    @property
    def writes(self) -> int:
        """Write requests that went to the device's bus since it was opened."""
        return self.unit.bus.writes

    @property
    def captures(self) -> bool:
        """Whether the device can play a waveform and sample by its own clock."""
        return self.buffer is not None

    @property
    def conditions_elsewhere(self) -> frozenset[str]:
        """Which of manual, interlock and supply are read at a place of their own, which a sample does not show."""
        return frozenset(self._elsewhere)

    def place_of(self, condition: str) -> str:
        """Return where a condition elsewhere is read, in words: contact or register, device and bus."""
        place = self._elsewhere[condition]
        name = place.contact.register if isinstance(place, WiredContact) else place.register.name
        return say("place_on_device", "{register} of {device}", register=name, device=place.unit.subject)

    def unread_s(self, condition: str) -> float:
        """Return for how long a condition elsewhere may stay unread, s: as the rules say, or as its bus needs.

        On a slow line one lost answer must not be enough.
        """
        said_s = self.wiring.permissives.unread_s
        return max(said_s, _LOST_ANSWERS * self._elsewhere[condition].unit.bus.lost_answer_s + _UNREAD_SLACK_S)

    @property
    def has_watchdog(self) -> bool:
        """Whether the device has a watchdog and the wiring says how long it waits."""
        return self._watchdog.is_used

    # ---- who and whose

    async def identify(self) -> str:
        """Make sure that each device is the one that is configured. Returns words that name it.

        Raises DeviceError where it is another, ConfigurationError where the wiring asks for what it has not.
        """
        if self.wiring.watchdog.timeout_s is not None and self.unit.map.watchdog is None:
            raise ConfigurationError(
                say(
                    "map_without_watchdog",
                    "{tag}: map {map} has no watchdog: say watchdog.waived = the reason to go without",
                    tag=self.tag,
                    map=self.unit.map.name,
                )
            )
        for unit in self._wired.units:
            await require_identity(self.tag, unit)
        units = self._wired.units
        return joined(
            ", ", [say("map_on_device", "{map} ({unit})", map=one.map.name, unit=one.subject) for one in units]
        )

    async def identify_commanded(self) -> None:
        """Make sure that the device that is commanded is the one that is configured. Raises as ``identify`` does."""
        await require_identity(self.tag, self.unit)

    async def take_ownership(self, run_number: int) -> None:
        """Fence the device: no other run's blocks count. Nothing is written where the map has no fence.

        Raises BusyError where another run owns it.
        """
        if not 0 < run_number <= 0xFFFFFFFF:
            raise ConfigurationError(
                say(
                    "run_number_outside",
                    "{tag}: run number {run_number} is outside 1 to 4294967295",
                    tag=self.tag,
                    run_number=run_number,
                )
            )
        fence = self.unit.map.fence
        if fence is not None:
            owner = round(await self.unit.value(fence.owner))
            if owner == 0:
                await self._claim(fence, run_number, fence.take)
                owner = round(await self.unit.value(fence.owner))
            if owner != run_number:
                raise BusyError(
                    say(
                        "device_owned_by_run",
                        "{tag}: run {owner} owns {device}, run {run_number} cannot have it: wait for its end or for "
                        "the device's watchdog, or restart the device where that run is dead",
                        tag=self.tag,
                        owner=owner,
                        device=self.unit.subject,
                        run_number=run_number,
                    )
                )
        self.run_number = run_number
        self.in_force_pa = self._asked_pa = math.nan  # what an earlier run wrote may have been undone since

    async def release(self, run_number: int | None = None) -> None:
        """Give the device back, its watchdog off: from now on nothing of this run counts.

        ``run_number`` is that of the owner by default. Raises DeviceError where the device stays with that run.
        """
        fence, number = self.unit.map.fence, self.run_number if run_number is None else run_number
        self.run_number = 0
        if fence is None:
            await self.disarm_watchdog()
            return
        await self._claim(fence, number, fence.release)
        watchdog = self.unit.map.watchdog
        if round(await self.unit.value(fence.owner)) == number:
            raise DeviceError(
                say(
                    "device_stays_owned",
                    "{tag}: {device} stays with run {run} after it was released",
                    tag=self.tag,
                    device=self.unit.subject,
                    run=number,
                )
            )
        if watchdog is not None and await self.unit.value(watchdog.state) == watchdog.armed:
            raise DeviceError(
                say(
                    "watchdog_stays_armed",
                    "{tag}: the watchdog of {device} stays armed after the release",
                    tag=self.tag,
                    device=self.unit.subject,
                )
            )

    async def _claim(self, fence: Fence, run_number: int, claim: int) -> None:
        await self.unit.write({fence.claim_run: run_number, fence.claim: claim})

    # ---- watchdog

    async def arm_watchdog(self) -> None:
        """Set the safe value and the timeout, and read both back. Raises DeviceError where they do not stick."""
        await self._watchdog.arm(self.run_number, self.safe_value_pa)

    async def disarm_watchdog(self) -> None:
        """Switch the watchdog off. Raises DeviceError where it stays on."""
        await self._watchdog.disarm(self.run_number, self.safe_value_pa)

    async def watchdog_armed(self) -> bool:
        """Whether the device's watchdog runs; False where it has none. Raises WireError or DeviceError."""
        watchdog = self.unit.map.watchdog
        return watchdog is not None and await self.unit.value(watchdog.state) == watchdog.armed

    async def feed_watchdog(self) -> None:
        """Change the heartbeat where nothing has fed the watchdog for a quarter of its timeout."""
        await self._watchdog.feed(self.run_number, self.safe_value_pa)

    # ---- look and move

    async def read(self, *, priority: bool = False) -> Sample:
        """Take one sample. Raises WireError or DeviceError where there is none: that is a gap."""
        self.last_seen = await self._sampler.look(priority=priority)
        return self.last_seen

    async def output_pa(self) -> float:
        """Read what the device shows as its output, Pa, and nothing else. Raises WireError or DeviceError."""
        return await self._alone(self._wired.readback)

    async def checked_output_pa(self) -> float:
        """Read the output, Pa, of the device that is configured and of nothing else.

        Raises WireError or DeviceError.
        """
        await self.identify_commanded()
        output_pa = await self._sampler.output()
        if not math.isfinite(output_pa):
            raise DeviceError(
                say(
                    "output_not_shown",
                    "{tag}: {device} does not show its output: look at the device",
                    tag=self.tag,
                    device=self.unit.subject,
                )
            )
        return output_pa

    async def position_m(self) -> float:
        """Read the stem's position, m, of the device that is configured and of nothing else; NaN where it is not valid.

        Raises WireError or DeviceError.
        """
        position = self._wired.position
        if isinstance(position, Signal):
            await require_identity(self.tag, position.unit)
        return await self._sampler.stem_m()

    async def supply_pa(self, sample: Sample | None) -> float:
        """Air supply, Pa: read at its own place where there is one, otherwise as the sample has it; NaN unknown."""
        signal = self._wired.supply
        if signal is not None:
            return await self._alone(signal)
        return math.nan if sample is None else sample.supply_pa

    async def _alone(self, signal: Signal) -> float:
        block = Block((signal.register,), signal.register.address, signal.register.words, signal.register.table)
        words = (await signal.unit.bus.read(signal.unit.device_id, block)).words
        return signal.register.decode(words)

    async def loop_in_manual(self, sample: Sample | None) -> bool | None:
        """Whether the loop is in manual, by its contact or the device's status; None where nothing says so."""
        if self._wired.manual is not None:
            return await self._wired.manual.says()
        live = self.unit.map.live
        if sample is None or live is None or not live.manual_mask:
            return None
        return bool(sample.status & live.manual_mask)

    async def interlocked(self, sample: Sample | None) -> bool | None:
        """Whether an interlock is active, by its contact or the device's status; None where nothing says so."""
        if self._wired.interlock is not None:
            return await self._wired.interlock.says()
        live = self.unit.map.live
        if sample is None or live is None or not live.interlock_mask:
            return None
        return bool(sample.status & live.interlock_mask)

    async def owner(self) -> int | None:
        """Return the run that owns the device; None where the map has no fence."""
        fence = self.unit.map.fence
        return None if fence is None else round(await self.unit.value(fence.owner))

    async def number(self) -> int | None:
        """Return the number that the installer gave the device; None where it shows none."""
        name = self.unit.map.number
        return None if name is None else round(await self.unit.value(name))

    def takes(self, pressure_pa: float) -> bool:
        """Whether the device can be told this pressure."""
        return self._wired.command.register.holds(pressure_pa)

    def drives_safe_itself(self, sample: Sample) -> bool:
        """Whether the device says that it has left us and drives its safe value."""
        return bool(sample.status & self._sampler.at_safe_mask)

    async def drive(self, pressure_pa: float, *, priority: bool = False) -> Exchange | None:
        """Write a command, once; None where exactly it is in force already. The look that follows reads it back.

        Raises WireError or DeviceError: then nobody knows what is in force until it is read back.
        """
        register = self._wired.command.register
        words = register.encode(pressure_pa)
        value_pa = register.decode(words)
        if value_pa == self.in_force_pa and not priority:
            return None
        self.in_force_pa, self._asked_pa = math.nan, value_pa
        self.commanded = True
        exchange = await self._write_command(words, priority)
        self.in_force_pa, self._watchdog.fed_s = value_pa, exchange.sent_s
        return exchange

    def adopt(self, sample: Sample) -> None:
        """Take a write whose answer was lost for carried out where the device shows it: it is not written again."""
        if math.isnan(self.in_force_pa) and abs(sample.output_pa - self._asked_pa) <= self.tolerance_pa:
            self.in_force_pa = self._asked_pa

    async def _write_command(self, words: tuple[int, ...], priority: bool) -> Exchange:
        unit, register, fence = self.unit, self._wired.command.register, self.unit.map.fence
        if fence is None:
            return await unit.bus.write(
                unit.device_id, register.address, words, priority=priority, function=unit.map.write_function
            )
        number = unit.map.register(fence.run_number)
        both = [*number.encode(self.run_number), *words]
        return await unit.bus.write(unit.device_id, number.address, both, priority=priority)

    async def command(self, pressure_pa: float, *, after_each: Callable[[], None] = _goes_on) -> None:
        """Write a command, once, and wait until the device shows it.

        ``after_each`` is called after every transaction, and ends the waiting by what it raises. Raises DeviceError
        where the output does not follow.
        """
        await self.drive(pressure_pa)
        after_each()
        if not (await self.confirmation(pressure_pa, reads=1, after_each=after_each)).confirmed:
            raise DeviceError(
                say(
                    "command_not_shown",
                    "{tag}: {commanded:g Pa} were commanded and {device} does not show them within "
                    "{time:g s}: check that it is in automatic and the map fits",
                    tag=self.tag,
                    commanded=pressure_pa,
                    device=self.unit.subject,
                    time=_SETTLING_S,
                )
            )

    async def go_safe(self) -> SafeOutcome:
        """Send the valve to its safe value at once, ahead of everything queued; return what it reached and why not.

        It raises nothing, whatever fails. A further attempt is made only where reading back shows that the one before
        did not take effect.
        """
        found = SafeOutcome(False, reason=say("safe_not_reached_in_time", "it was not reached in time"))
        if not math.isfinite(self.safe_value_pa):
            return replace(
                found,
                reason=say("safe_value_unknown", "its safe value is not known, as the output at entry was never read"),
            )
        try:
            async with asyncio.timeout(_SAFE_DEADLINE_S):
                for _ in range(_SAFE_ATTEMPTS):
                    found = await self._safe_now()
                    if found.confirmed:
                        break
        except TimeoutError:
            return replace(
                found,
                reason=say(
                    "safe_given_up",
                    "{why}; given up after {time:g s}",
                    why=found.reason,
                    time=_SAFE_DEADLINE_S,
                ),
            )
        except Exception as error:  # noqa: BLE001  - whoever makes a valve safe must hear how it stands, whatever fails
            return replace(found, confirmed=False, reason=fault_words(error))
        return found

    async def _safe_now(self) -> SafeOutcome:
        # A write without an answer may have been carried out all the same, and one that cannot be encoded may not be
        # needed: look.
        refused = ""
        try:
            await self.drive(self.safe_value_pa, priority=True)
        except ValveError as error:
            refused = message_of(error)
        found = await self.confirmation(self.safe_value_pa, priority=True)
        if found.confirmed or not refused:
            return found
        return replace(found, reason=say("safe_refused", "{refused}; {why}", refused=refused, why=found.reason))

    async def confirmation(
        self,
        pressure_pa: float,
        *,
        reads: int = _SETTLED_READS,
        priority: bool = False,
        after_each: Callable[[], None] = _goes_on,
    ) -> SafeOutcome:
        """Look whether the device shows this command within the settling time, so many looks in a row.

        ``after_each`` is called after every look. Only its output is read: a position or a pressure that cannot be had
        says nothing about it.
        """
        fitting, unseen, until_s = 0, 0, time.monotonic() + _SETTLING_S
        shown_pa, problem = math.nan, ""
        while fitting < reads:
            try:
                output_pa = await self._sampler.output(priority=priority)
            except EquipmentError as error:
                unseen += 1  # a look that failed says nothing, neither yes nor no
                problem = message_of(error)
            else:
                fits = abs(output_pa - pressure_pa) <= self.tolerance_pa
                fitting, unseen, shown_pa = (fitting + 1 if fits else 0), 0, output_pa
            after_each()
            if fitting < reads:
                if time.monotonic() > until_s and (fitting == unseen == 0 or unseen >= _UNSEEN_READS):
                    shows = say(
                        "shows_another_output",
                        "the device shows {shown:g Pa} and not {wanted:g Pa}",
                        shown=shown_pa,
                        wanted=pressure_pa,
                    )
                    return SafeOutcome(False, shown_pa, problem if unseen else shows)
                await asyncio.sleep(_READ_PAUSE_S)
        return SafeOutcome(True, shown_pa)

    async def pressure_apart(self, within_s: float) -> float:
        """Return the actuator's pressure, Pa, where it is not at the safe value after so long; NaN where it is.

        NaN too where nothing measures it. Raises EquipmentError where the device does not answer.
        """
        low_pa, high_pa = self.wiring.limits.pressure_pa
        until_s = time.monotonic() + within_s
        while True:
            pressure_pa = (await self.read()).pressure_pa
            if not abs(pressure_pa - self.safe_value_pa) > _APART_SHARE * (high_pa - low_pa):
                return math.nan
            if time.monotonic() > until_s:
                return pressure_pa
            await asyncio.sleep(_LOOK_PAUSE_S)


def connect_valve(wiring: ValveWiring, buses: Mapping[str, Bus]) -> ValveDevice:
    """Join a valve to its buses by name; nothing is sent yet. Raises ConfigurationError where the wiring is wrong."""
    return ValveDevice(wiring, wire(wiring, buses))
