"""The coming night as the pages show it."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from service.parts import Parts
from service.schedules.calendar import next_occurrence
from service.schedules.nightly import wall_clock
from service.schedules.views import night


@dataclass(frozen=True, slots=True)
class NightCheck:
    """One valve in the night's list."""

    valve: str
    due_at: datetime
    state: str
    reason: str
    test_id: str | None


@dataclass(frozen=True, slots=True)
class NightSchedule:
    """One schedule and when it is due next."""

    name: str
    next_due: datetime | None
    zone: str
    sequence: str | None
    valves: tuple[str, ...]


async def night_of(parts: Parts) -> tuple[Sequence[NightCheck], Sequence[NightSchedule]]:
    """Return the last and the coming night valve by valve, and the schedules; both empty where none is planned."""
    now = wall_clock()
    entries = await asyncio.to_thread(night, parts.plant, parts.store.schedule_runs, now)
    zones = {one.name: one.zone for one in parts.plant.schedules}
    checks = [
        NightCheck(one.valve, one.due_at.astimezone(zones.get(one.schedule)), one.state.value, one.reason, one.test_id)
        for one in entries
    ]
    schedules = []
    for one in parts.plant.schedules:
        coming = next_occurrence(one, now)
        due_at = None if coming is None else coming.due_at.astimezone(one.zone)
        schedules.append(NightSchedule(one.name, due_at, one.zone.key, one.sequence, one.valves))
    return checks, schedules


def due_checks(parts: Parts) -> dict[str, datetime]:
    """Return when each valve is due next; valves without a schedule are left out."""
    now = wall_clock()
    due: dict[str, datetime] = {}
    for schedule in parts.plant.schedules:
        coming = next_occurrence(schedule, now)
        if coming is not None:
            due_at = coming.due_at.astimezone(schedule.zone)
            for tag in schedule.valves:
                due[tag] = min(due_at, due.get(tag, due_at))
    return due
