"""The parts of a running service, as the routes reach them."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field
from typing import Final

from fastapi import Request

from drivers.motion.audit_log import AuditLog
from drivers.motion.orders import MotionLink, Unread
from service.access.access import Access
from service.config.settings import Plant
from service.figures.drawer import Drawer
from service.health.earlier import EarlierResults
from service.health.staleness import Staleness
from service.meters import Meters
from service.recordings.conversion import Converter
from service.runs.analyst import Analyst
from service.runs.motion_watch import MotionWatch
from service.runs.reanalyses import Reanalyses
from service.runs.service import Runs
from service.schedules.nightly import Nightly
from service.store.store import Store
from valve.errors import ValveError

_ANSWER_S: Final = 1.0  # a page waits no longer for a motion process that hangs


@dataclass(frozen=True, slots=True)
class Parts:
    """Made once at the start by ``service.app``."""

    plant: Plant
    store: Store
    runs: Runs
    analyst: Analyst
    converter: Converter
    version: str
    access: Access
    audit: AuditLog
    nightly: Nightly
    staleness: Staleness
    meters: Meters
    motion: MotionLink
    reanalyses: Reanalyses
    motion_watch: MotionWatch
    drawer: Drawer = field(default_factory=Drawer)
    earlier: EarlierResults = field(default_factory=EarlierResults)


async def parts_of(request: Request) -> Parts:
    """Return the parts of the service that got this request; a coroutine, as FastAPI calls a function in a thread."""
    parts = request.app.state.parts
    assert isinstance(parts, Parts)
    return parts


async def unread_of(parts: Parts, tag: str) -> Unread | None:
    """Return why a watched valve cannot be read now; None where it is, or the motion process does not say."""
    if parts.plant.valves[tag].wiring.watch is None:
        return None
    try:
        async with asyncio.timeout(_ANSWER_S):
            return (await parts.motion.unread()).get(tag)
    except (ValveError, TimeoutError):  # it is gone, or older than this question
        return None
