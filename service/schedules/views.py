"""Schedules and nights as the REST interface and the tablet show them."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any, Final

from pydantic import BaseModel, Field

from service.config.plant import Plant
from service.model.check import Check, CheckState
from service.model.schedule import Schedule, next_occurrence
from service.schedules.plan import PlannedCheck, plan_night
from service.store.schedule_run_table import ScheduleRunTable
from valve.messages import say

_TOO_LATE: Final = say(
    "turn_after_window", "its turn will come after its window: shorten the tests, or widen the window"
)
# The night that a person means: what was due since yesterday noon or so, and what is due until tomorrow.
LAST: Final = timedelta(hours=20)
COMING: Final = timedelta(hours=24)


class LastRun(BaseModel):
    """How a schedule's newest occurrence went."""

    occurrence: str = Field(description="the plant's own clock at which it was due")
    due_at: datetime
    requested_by: str = Field(description="who ran it by hand; empty where the clock did")
    states: dict[str, int] = Field(description="how many valves stand in each state")


class ScheduleView(BaseModel):
    """One schedule."""

    name: str
    cron: str
    zone: str
    valves: list[str]
    sequence: str
    overrides: dict[str, Any]
    until: dict[str, Any] | None = Field(description="what each test is to know to end before its sequence does")
    window_s: float = Field(description="how late a valve's test may start")
    next_due: datetime | None
    last: LastRun | None


class ScheduleList(BaseModel):
    """All schedules of the plant."""

    schedules: list[ScheduleView]


class NightEntry(BaseModel):
    """One valve in a night."""

    valve: str
    schedule: str
    sequence: str
    gateway: str
    bus: str
    due_at: datetime
    starts_at: datetime | None = Field(description="of a planned check: when its turn will come, about")
    window_ends_at: datetime
    state: CheckState
    reason: str
    test_id: str | None


def last_run(checks: list[Check]) -> LastRun | None:
    """Return how an occurrence went, by its checks."""
    if not checks:
        return None
    states = [check.state for check in checks]
    counts = {state.value: states.count(state) for state in CheckState if state in states}
    return LastRun(
        occurrence=checks[0].occurrence, due_at=checks[0].due_at, requested_by=checks[0].requested_by, states=counts
    )


def schedule_view(schedule: Schedule, checks: list[Check], now: datetime) -> ScheduleView:
    """Return a schedule with its newest checks."""
    coming = next_occurrence(schedule, now)
    return ScheduleView(
        name=schedule.name,
        cron=schedule.cron,
        zone=schedule.zone.key,
        valves=list(schedule.valves),
        sequence=schedule.sequence,
        overrides=dict(schedule.overrides),
        until=None if schedule.until is None else dict(schedule.until),
        window_s=schedule.window_s,
        next_due=None if coming is None else coming.due_at,
        last=last_run(checks),
    )


def night(plant: Plant, table: ScheduleRunTable, now: datetime) -> list[NightEntry]:
    """Return the last night's checks and the coming night's, valve by valve. Blocks."""
    done = [_done(check) for check in table.between(now - LAST, now + timedelta(seconds=1))]
    return done + [_planned(check) for check in plan_night(plant, now, now + COMING)]


def _done(check: Check) -> NightEntry:
    ends_at, state, reason = check.ends_at, check.state, check.reason
    return NightEntry(
        **_shared(check), starts_at=None, window_ends_at=ends_at, state=state, reason=reason, test_id=check.test_id
    )


def _planned(check: PlannedCheck) -> NightEntry:
    reason = "" if check.fits else _TOO_LATE
    starts_at, ends_at, state = check.starts_at, check.window_ends_at, CheckState.PLANNED
    return NightEntry(
        **_shared(check), starts_at=starts_at, window_ends_at=ends_at, state=state, reason=reason, test_id=None
    )


def _shared(check: Check | PlannedCheck) -> dict[str, Any]:
    return {name: getattr(check, name) for name in ("valve", "schedule", "sequence", "gateway", "bus", "due_at")}


def due_checks(plant: Plant, now: datetime) -> dict[str, datetime]:
    """Return when each valve is due next; valves without a schedule are left out."""
    due: dict[str, datetime] = {}
    for schedule in plant.schedules:
        coming = next_occurrence(schedule, now)
        if coming is not None:
            for tag in schedule.valves:
                due[tag] = min(coming.due_at, due.get(tag, coming.due_at))
    return due
