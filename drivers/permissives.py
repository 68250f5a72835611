"""What must hold before the first move: read fresh from the device, each with its value, its limit and what to do.

Here no route or schedule can go around them: ``drivers.sequence`` asks before it writes anything.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from drivers.capabilities import Role
from drivers.device import ValveDevice
from drivers.outcome import Sample
from drivers.permissive import Permissive, require_met
from valve.errors import ConfigurationError, DeviceError, EquipmentError
from valve.messages import Message, message_of, say

_NOBODY: Final = say("nobody", "nobody")
_NONE: Final = say("none_there", "none")
_ACTIVE: Final = say("contact_active", "active")
#: What to do where a device cannot be read at all.
UNREACHABLE: Final = say("look_at_device_and_wire", "look at the device and its wire")
_LOOKS: Final = 4  # a sample may be lost and the stem must still be seen at rest
_LOOK_PERIOD_S: Final = 0.05
_STILL_M: Final = 1.0e-3  # where the plant file and the nameplate say nothing
FRESH_S: Final = 0.5  # that permissives may be old at the first write, or one round of reading them


@dataclass(frozen=True, slots=True)
class Readiness:
    """All permissives of one valve, the sample that they were judged by and how restless the position was, m.

    ``round_s`` is how long it took to read them once.
    """

    permissives: tuple[Permissive, ...]
    entry: Sample | None = None
    unrest_m: float = math.nan
    round_s: float = math.nan

    def require(self, tag: str) -> None:
        """Raise PermissiveError where one is missing."""
        require_met(tag, self.permissives)

    @property
    def fresh_until_s(self) -> float:
        """Until when a first write may follow them (monotonic); minus infinity where nothing was read."""
        if self.entry is None:
            return -math.inf
        return self.entry.sent_s + (max(FRESH_S, self.round_s) if math.isfinite(self.round_s) else FRESH_S)

    @property
    def is_fresh(self) -> bool:
        """Whether a first write may follow them now."""
        return time.monotonic() <= self.fresh_until_s


async def read_permissives(device: ValveDevice, permit: str | None = None, *, owner: int = 0) -> Readiness:
    """Read everything that decides whether this valve may move; nothing is written.

    What cannot be read is a missing permissive with the reason. The run ``owner`` may own the device, 0 is nobody.
    """
    try:
        identity = await device.identify()
        samples = await _looks(device)
        judged = (
            Permissive("device", True, identity, say("device_of_plant_file", "the device that plant.toml names")),
            *await _free(device, owner),
            *await _judged(device, samples, permit),
        )
    except (EquipmentError, ConfigurationError) as error:
        remedy = UNREACHABLE if isinstance(error, EquipmentError) else say("correct_plant_file", "correct plant.toml")
        return Readiness(
            (
                Permissive(
                    "device",
                    False,
                    message_of(error),
                    say("device_of_plant_file", "the device that plant.toml names"),
                    remedy,
                ),
            )
        )
    return Readiness(judged, samples[-1], _unrest_m(samples))


async def judge_entry(device: ValveDevice, permit: str | None, *, feed: bool = False) -> Readiness:
    """Return the same for a device that was identified just now. Raises WireError and DeviceError as they come.

    ``feed`` where it is ours and its watchdog armed: on a slow line the looks take as long as that waits.
    """
    begun_s = time.monotonic()
    samples = await _looks(device, feed=feed)
    if not math.isfinite(samples[-1].output_pa):
        raise DeviceError(
            say(
                "output_not_shown_at_start",
                "{tag}: {device} does not show its output: nothing is moved from there",
                tag=device.tag,
                device=device.unit.subject,
            )
        )
    if not math.isfinite(samples[-1].position_m):
        raise DeviceError(
            say(
                "position_not_valid_at_start",
                "{tag}: there is no valid position before the test: check the position sensor",
                tag=device.tag,
            )
        )
    judged = await _judged(device, samples, permit)
    return Readiness(judged, samples[-1], _unrest_m(samples), time.monotonic() - begun_s)


async def _judged(device: ValveDevice, samples: Sequence[Sample], permit: str | None) -> tuple[Permissive, ...]:
    return (
        *await _own_number(device),
        await _manual(device, samples[-1], permit),
        *_permit(device, permit),
        await _interlock(device, samples[-1]),
        *_position(device, samples),
        _output(device, samples[-1]),
        *await _supply(device, samples[-1]),
        _watchdog(device),
    )


async def _looks(device: ValveDevice, *, feed: bool = False) -> list[Sample]:
    """Look a few times; a look that fails is left out. Raises the last error where fewer than two came."""
    samples: list[Sample] = []
    problem: EquipmentError | None = None
    for _ in range(_LOOKS):
        try:
            if feed:
                await device.feed_watchdog()
            samples.append(await device.read())
        except EquipmentError as error:
            problem = error
        await asyncio.sleep(_LOOK_PERIOD_S)
    if len(samples) < 2 and problem is not None:
        raise problem
    return samples


def _mm(length_m: float) -> Message:
    return say("length", "{length:.3f mm}", length=length_m)


def _kpa(pressure_pa: float) -> Message:
    return say("pressure_read", "{pressure:.2f kPa}", pressure=pressure_pa)


def _between(low: Message, high: Message) -> Message:
    return say("between", "{low} to {high}", low=low, high=high)


def _unrest_m(samples: Sequence[Sample]) -> float:
    seen = [sample.position_m for sample in samples if math.isfinite(sample.position_m)]
    return max(seen) - min(seen) if len(seen) > 1 else math.nan


async def _own_number(device: ValveDevice) -> list[Permissive]:
    wanted = device.wiring.permissives.device_number
    if wanted is None:
        return []
    number = await device.number()
    value = say("shows_no_number", "it shows no number") if number is None else str(number)
    return [
        Permissive(
            "device_number",
            number == wanted,
            value,
            str(wanted),
            say(
                "another_device_answers",
                "another device answers: correct the bus, device_id or permissives.device_number",
            ),
        )
    ]


async def _free(device: ValveDevice, allowed: int) -> list[Permissive]:
    owner = await device.owner()
    if owner is None:
        return []
    value = _NOBODY if owner == 0 else say("owned_by_run", "run {run}", run=owner)
    remedy = say(
        "wait_for_run",
        "wait for the end of that run or for the device's watchdog, or restart the device where that run is dead",
    )
    return [Permissive("owner", owner in (0, allowed), value, _NOBODY, remedy)]


async def _manual(device: ValveDevice, sample: Sample, permit: str | None) -> Permissive:
    rules = device.wiring.permissives
    shown = await device.loop_in_manual(sample)
    wanted = say("loop_in_manual", "the loop in manual")
    if shown:
        return Permissive("loop_in_manual", True, say("in_manual", "in manual"), wanted)
    if rules.permit and permit:
        return Permissive(
            "loop_in_manual",
            True,
            say("permit_named", "permit {permit}", permit=permit),
            say("loop_in_manual_or_permit", "the loop in manual or a permit"),
        )
    if rules.manual_waived:
        return Permissive("loop_in_manual", True, say("waived", "waived: {why}", why=rules.manual_waived), wanted)
    if shown is None and rules.manual is None:
        return Permissive(
            "loop_in_manual",
            False,
            say("nothing_shows_it", "nothing shows it"),
            wanted,
            say(
                "name_manual_or_permit",
                "name permissives.manual, demand a permit (permissives.permit = true) or say permissives.manual_waived",
            ),
        )
    value = (
        say("contact_not_valid", "its contact is not valid") if shown is None else say("not_in_manual", "not in manual")
    )
    return Permissive(
        "loop_in_manual",
        False,
        value,
        wanted,
        say("put_loop_in_manual", "put the valve's loop in manual, then start again"),
    )


def _permit(device: ValveDevice, permit: str | None) -> list[Permissive]:
    if not device.wiring.permissives.permit:
        return []
    return [
        Permissive(
            "permit",
            bool(permit),
            permit or _NONE,
            say("permit_number", "a permit number"),
            say("start_with_permit", "start the test with the work permit's number"),
        )
    ]


async def _interlock(device: ValveDevice, sample: Sample) -> Permissive:
    active = await device.interlocked(sample)
    if active is None and device.wiring.permissives.interlock is None:
        return Permissive(
            "no_interlock", None, say("nothing_shows_it", "nothing shows it"), say("no_interlock", "no interlock")
        )
    value = say("contact_not_valid", "its contact is not valid") if active is None else _ACTIVE if active else _NONE
    return Permissive(
        "no_interlock",
        active is False,
        value,
        say("no_interlock", "no interlock"),
        say("clear_interlock", "clear the interlock in the control room"),
    )


def _position(device: ValveDevice, samples: Sequence[Sample]) -> list[Permissive]:
    rules, limits = device.wiring.permissives, device.wiring.limits
    span = rules.position_m or limits.position_m
    position_m, unrest_m = samples[-1].position_m, _unrest_m(samples)
    still_m = _STILL_M if rules.still_m is None else rules.still_m
    limit = say("valid_position", "a valid position") if span is None else _between(_mm(span[0]), _mm(span[1]))
    plausible = math.isfinite(position_m) and (span is None or span[0] <= position_m <= span[1])
    return [
        Permissive(
            "position",
            plausible,
            _mm(position_m),
            limit,
            say("check_position_sensor_scaling", "check the position sensor and its scaling"),
        ),
        Permissive(
            "stem_at_rest",
            unrest_m <= still_m * (1.0 + 1.0e-9),  # one step of a coarse sensor may be all that is allowed
            say("between_looks", "{moved} between looks", moved=_mm(unrest_m)),
            say("at_most", "at most {most}", most=_mm(still_m)),
            say("wait_until_stem_rests", "wait until the stem rests, and check who moves it"),
        ),
    ]


def _output(device: ValveDevice, sample: Sample) -> Permissive:
    low_pa, high_pa = device.wiring.limits.pressure_pa
    slack_pa = 0.05 * (high_pa - low_pa)
    # A read-back may show what cannot be commanded: then no ramp could begin there, and no "entry" be gone back to.
    fits = low_pa - slack_pa <= sample.output_pa <= high_pa + slack_pa and device.takes(sample.output_pa)
    limit = _between(_kpa(low_pa), _kpa(high_pa))
    remedy = say("bring_output_inside", "bring the output inside limits.pressure_pa, or correct the limits")
    return Permissive("output", fits, _kpa(sample.output_pa), limit, remedy)


async def _supply(device: ValveDevice, sample: Sample) -> list[Permissive]:
    rules, live = device.wiring.permissives, device.unit.map.live
    supply_pa = await device.supply_pa(sample)
    low = live is not None and bool(sample.status & live.supply_low_mask)
    remedy = say("check_air_supply", "check the air supply and its regulator")
    if rules.supply_pa is None:
        if live is None or not live.supply_low_mask:
            return []
        value = "low" if low else say("supply_not_low", "not low")
        return [
            Permissive(
                Role.SUPPLY.value,
                not low,
                value,
                say("supply_should_not_be_low", "the device does not call it low"),
                remedy,
            )
        ]
    low_pa, high_pa = rules.supply_pa
    fits = low_pa <= supply_pa <= high_pa and not low
    return [Permissive(Role.SUPPLY.value, fits, _kpa(supply_pa), _between(_kpa(low_pa), _kpa(high_pa)), remedy)]


def _watchdog(device: ValveDevice) -> Permissive:
    choice = device.wiring.watchdog
    if choice.timeout_s is None:
        return Permissive(
            "watchdog",
            True,
            say("waived", "waived: {why}", why=choice.waived),
            say("watchdog_or_waiver", "a watchdog in the device, or a waiver"),
        )
    value = say(
        "watchdog_will_be_armed", "{time:g s}, armed and read back before the first move", time=choice.timeout_s
    )
    return Permissive("watchdog", True, value, say("watchdog_or_waiver", "a watchdog in the device, or a waiver"))
