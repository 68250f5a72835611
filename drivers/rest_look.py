"""A look at a valve that a motion has left: its output and its stem, each by itself; nothing is written."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from typing import Final

from drivers.device import ValveDevice
from drivers.stands_at import StandsAt, stands_at
from valve.errors import DeviceError, EquipmentError
from valve.messages import Message, left_out, message_of, say

_LOOKS: Final = 2  # a device whose clock stands still shows the same sample twice
_LOOK_PAUSE_S: Final = 0.1
_LOOK_S: Final = 3.0  # one answer that is lost and the recovery of a serial line fit in
_TAGGED: Final = "{tag}: "
_FRESH_S: Final = 2.0  # an older sample does not show where a motion that just ended left the valve


async def look_at_rest(device: ValveDevice, *, confirmed: bool | None, after_s: float) -> StandsAt:
    """Return where a valve stands ``after_s`` seconds after its motion ended; what cannot be read is said.

    ``confirmed`` is whether its safe value was read back then, None where nothing was commanded. A device on a dead
    bus hides nothing of the others.
    """
    (signal_pa, signal_unread), (stem_m, stem_unread) = await asyncio.gather(
        _within(device, say("the_output", "the output"), device.checked_output_pa),
        _within(device, say("the_position", "the position"), lambda: _stem(device)),
    )
    safe_pa = device.safe_value_pa
    return stands_at(
        device.wiring.rest,
        after_s=after_s,
        safe_pa=safe_pa if math.isfinite(safe_pa) else None,
        confirmed=confirmed,
        signal_pa=signal_pa,
        signal_tolerance_pa=device.tolerance_pa,
        signal_unread=signal_unread,
        stem_m=stem_m,
        stem_unread=stem_unread,
    )


def seen_last(device: ValveDevice, *, confirmed: bool | None) -> StandsAt:
    """Return where the last sample of a motion that ends now showed the valve: its stem may still move."""
    sample, safe_pa = device.last_seen, device.safe_value_pa
    if sample is not None and time.monotonic() - sample.received_s > _FRESH_S:
        sample = None
    return stands_at(
        device.wiring.rest,
        after_s=0.0,
        safe_pa=safe_pa if math.isfinite(safe_pa) else None,
        confirmed=confirmed,
        signal_pa=safe_pa if confirmed else None,
        stem_m=None if sample is None or not math.isfinite(sample.position_m) else sample.position_m,
        is_over=False,
    )


async def _within(device: ValveDevice, what: str, read: Callable[[], Awaitable[float]]) -> tuple[float | None, str]:
    """Return what was read, or None and why not."""
    try:
        async with asyncio.timeout(_LOOK_S):
            return await read(), ""
    except EquipmentError as error:
        return None, _untagged(message_of(error), device.tag)
    except TimeoutError:
        return None, say(
            "not_read_in_time",
            "{what} was not read within {time:g s}: look at the device and its wire",
            what=what,
            time=_LOOK_S,
        )


def _untagged(text: str, tag: str) -> str:
    """Return what an error of a valve says without the valve, where it is known anyhow whose it is."""
    if not isinstance(text, Message) or text.values.get("tag") != tag or not text.template.startswith(_TAGGED):
        return text
    return left_out(text, ("tag",))


async def _stem(device: ValveDevice) -> float:
    """Return the stem's position, m. Raises WireError and DeviceError, the latter too for what no stem can show."""
    position_m = math.nan
    for look in range(_LOOKS):
        if look:
            await asyncio.sleep(_LOOK_PAUSE_S)
        position_m = await device.position_m()
    if not math.isfinite(position_m):
        raise DeviceError(
            say("position_not_valid", "{tag}: the position is not valid: check the position sensor", tag=device.tag)
        )
    span_m = device.wiring.permissives.position_m
    if span_m is not None and not span_m[0] <= position_m <= span_m[1]:
        raise DeviceError(
            say(
                "position_where_no_stem_is",
                "{tag}: {position:.4g mm} is shown, and the stem can only be at {low:.4g in mm} to {high:.4g mm}: "
                "check the position sensor and its scaling",
                tag=device.tag,
                position=position_m,
                low=span_m[0],
                high=span_m[1],
            )
        )
    return position_m
