"""Why a valve that is watched in service cannot be read now, as the motion process says."""

from __future__ import annotations

import asyncio
from typing import Final

from drivers.motion.orders import MotionLink, Unread
from service.config.plant import PlantValve
from valve.errors import ValveError

_ANSWER_S: Final = 1.0  # a page waits no longer for a motion process that hangs


async def unread_of(motion: MotionLink, tag: str, valve: PlantValve) -> Unread | None:
    """Return why a watched valve cannot be read now; None where it is, or the motion process does not say."""
    if valve.wiring.watch is None:
        return None
    try:
        async with asyncio.timeout(_ANSWER_S):
            return (await motion.unread()).get(tag)
    except (ValveError, TimeoutError):  # it is gone, or older than this question
        return None
