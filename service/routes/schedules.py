"""``/schedules``: the nightly checks, the night valve by valve, and a schedule run by hand."""

from __future__ import annotations

import asyncio
from functools import partial
from http import HTTPStatus

from fastapi import APIRouter, Request

from drivers.motion.audit_log import AuditLog
from service.access.needs import Asks, needs
from service.access.principal import Right
from service.config.plant import Plant
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.routes.lists import KNOWN_KEYS, OR_CSV, Form, csv_answer, dated, wants_csv
from service.schedules.nightly import Nightly, wall_clock
from service.schedules.views import LastRun, NightEntry, ScheduleList, last_run, night, schedule_view
from service.store.store import Store

router = APIRouter(prefix="/schedules", tags=["schedules"], responses=PROBLEMS)


@router.get("", dependencies=[needs(Right.VIEW), KNOWN_KEYS])
async def list_schedules(plant: Given[Plant], store: Given[Store]) -> ScheduleList:
    """List the nightly checks, when each runs next and how it went last."""
    table, now = store.schedule_runs, wall_clock()
    views = [
        schedule_view(schedule, await asyncio.to_thread(table.latest, schedule.name), now)
        for schedule in plant.schedules
    ]
    return ScheduleList(schedules=views)


@router.get("/night", dependencies=[needs(Right.VIEW), KNOWN_KEYS], response_model=list[NightEntry], responses=OR_CSV)
async def get_night(request: Request, plant: Given[Plant], store: Given[Store], form: Form = None) -> object:
    """Return the last night's checks and the coming night's, valve by valve."""
    entries = await asyncio.to_thread(night, plant, store.schedule_runs, wall_clock())
    if not wants_csv(request, form):
        return entries
    columns = tuple(NightEntry.model_fields)
    return csv_answer(columns, ([getattr(one, name) for name in columns] for one in entries), dated("night"))


@router.post("/{name}/run", status_code=HTTPStatus.ACCEPTED, dependencies=[needs(Right.SCHEDULE)])
async def run_schedule(name: str, nightly: Given[Nightly], audit: Given[AuditLog], asks: Asks) -> LastRun | None:
    """Queue the checks of a schedule now; each waits for its turn within the schedule's window.

    A valve of another gateway is not checked by this one: its own gateway is asked. Null where this has none.
    """
    schedule = nightly.schedule(name)
    note = partial(audit.append, "schedule.run", who=asks.name, details={"schedule": schedule.name})
    await asyncio.to_thread(note)
    checks = await nightly.run_now(name, asks.name)
    return last_run(checks)
