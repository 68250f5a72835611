"""A valve that a dead process left: it is read, and sent to safe only where it was commanded and may be moved now."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass, replace
from typing import Final

from drivers.device import ValveDevice
from drivers.outcome import SafeOutcome
from drivers.permissives import missing_words, read_permissives
from valve.errors import EquipmentError

_STEADY_S: Final = 0.5  # a waveform that a device plays by itself may pass its safe value


@dataclass(frozen=True, slots=True)
class Recovered:
    """How a valve was found, or left: ``safe`` says whether its device shows the safe value, and if not why not.

    ``sent`` is whether a command for it was written.
    """

    safe: SafeOutcome
    sent: bool = False


async def recover_valve(device: ValveDevice, run_number: int, *, commanded: bool) -> Recovered:
    """Look at a valve that run ``run_number`` left, and send it to safe where that is due and allowed now.

    Nothing that moves is written where the run commanded nothing, where the device shows the safe value, and where a
    permissive is missing at this moment: a permit that was named for the test counts no more.

    Raises WireError and DeviceError where the device cannot be asked, BusyError where another run owns it.
    """
    await device.identify_commanded()
    shown = await _steadily_safe(device)
    if shown.confirmed or not commanded:
        await _let_go(device, run_number)
        return Recovered(shown if shown.confirmed else replace(shown, reason="the test commanded nothing"))
    missing = missing_words((await read_permissives(device, owner=run_number)).permissives)
    if missing:
        return Recovered(replace(shown, reason=f"{shown.reason}; it was not sent there, as {missing}"))
    await device.take_ownership(run_number)
    found = await device.go_safe()
    if found.confirmed:
        try:
            await device.release()
        except EquipmentError as error:
            found = replace(found, reason=f"the device was not released: {error}")
    return Recovered(found, sent=True)


async def _steadily_safe(device: ValveDevice) -> SafeOutcome:
    """Whether the device shows its safe value, twice and some time apart."""
    first = await device.confirmation(device.safe_value_pa)
    if not first.confirmed:
        return first
    await asyncio.sleep(_STEADY_S)
    return await device.confirmation(device.safe_value_pa)


async def _let_go(device: ValveDevice, run_number: int) -> None:
    """Give a device back that the dead run still owns and whose watchdog will not: that moves nothing."""
    with contextlib.suppress(EquipmentError):
        if await device.owner() == run_number and not await device.watchdog_armed():
            await device.release(run_number)
