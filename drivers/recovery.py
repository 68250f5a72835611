"""A valve that a dead process left: it is read, and sent to safe only where it was commanded and may be moved now."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace
from typing import Final

from drivers.device import ValveDevice
from drivers.outcome import Recovered, SafeOutcome
from drivers.permissive import missing_words
from drivers.permissives import judge_entry, read_permissives
from valve.errors import EquipmentError
from valve.messages import message_of, say

_STEADY_S: Final = 0.5  # a waveform that a device plays by itself may pass its safe value
_FRESH_READS: Final = 3
_NOT_SENT: Final = {
    False: say("nothing_commanded", "the test commanded nothing"),
    None: say(
        "commanded_unknown",
        "its journal is damaged, or of an earlier version, and does not show whether the test "
        "commanded the valve: look at the valve, and bring it to its safe value by hand where it is "
        "not there",
    ),
}


async def recover_valve(device: ValveDevice, run_number: int, *, commanded: bool | None) -> Recovered:
    """Look at a valve that run ``run_number`` left, and send it to safe where that is due and allowed now.

    Nothing that moves is written where the run is not known to have commanded anything (``commanded`` is None where its
    journal cannot say it), where the device shows the safe value, and where a permissive is missing at this moment: a
    permit that was named for the test counts no more. At that write the permissives are as fresh as at a test's first.

    Raises WireError and DeviceError where the device cannot be asked, BusyError where another run owns it.
    """
    await device.identify_commanded()
    shown = await _steadily_safe(device)
    if shown.confirmed or not commanded:
        await _let_go(device, run_number)
        return Recovered(shown if shown.confirmed else replace(shown, reason=_NOT_SENT[commanded]))
    missing = missing_words((await read_permissives(device, owner=run_number)).permissives)
    if missing:
        return Recovered(replace(shown, reason=_withheld(shown, missing)))
    await device.take_ownership(run_number)
    try:
        missing = await _missing_now(device)
    except BaseException:
        await _let_go(device, run_number)
        raise
    if missing:
        await _let_go(device, run_number)
        return Recovered(replace(shown, reason=_withheld(shown, missing)))
    found = await device.go_safe()
    if found.confirmed:
        try:
            await device.release()
        except EquipmentError as error:
            found = replace(
                found, reason=say("not_released", "the device was not released: {why}", why=message_of(error))
            )
    return Recovered(found, sent=True)


def _withheld(shown: SafeOutcome, missing: str) -> str:
    return say("not_sent_to_safe", "{found}; it was not sent there, as {why}", found=shown.reason, why=missing)


async def _missing_now(device: ValveDevice) -> str:
    """Return which permissives are missing, by a reading that is fresh when this returns; "" where none is."""
    for _ in range(_FRESH_READS):
        readiness = await judge_entry(device, None)
        missing = missing_words(readiness.permissives)
        if missing or readiness.is_fresh:
            return missing
    return say(
        "permissives_not_fresh", "the permissives could not be read freshly: this machine or the bus is too busy"
    )


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
