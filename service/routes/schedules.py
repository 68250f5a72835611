"""``/schedules``: the nightly checks, the night valve by valve, and a schedule run by hand."""

from __future__ import annotations

import asyncio
from functools import partial
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Request

from service.access.needs import Asks, needs
from service.access.principal import Right
from service.http.problems import PROBLEMS
from service.parts import Parts, parts_of
from service.routes.lists import KNOWN_KEYS, OR_CSV, Form, csv_answer, dated, wants_csv
from service.schedules.nightly import wall_clock
from service.schedules.views import LastRun, NightEntry, ScheduleList, last_run, night, schedule_view

router = APIRouter(prefix="/schedules", tags=["schedules"], responses=PROBLEMS)
PartsOf = Annotated[Parts, Depends(parts_of)]


@router.get("", dependencies=[needs(Right.VIEW), KNOWN_KEYS])
async def list_schedules(parts: PartsOf) -> ScheduleList:
    """List the nightly checks, when each runs next and how it went last."""
    table, now = parts.store.schedule_runs, wall_clock()
    views = [
        schedule_view(schedule, await asyncio.to_thread(table.latest, schedule.name), now)
        for schedule in parts.plant.schedules
    ]
    return ScheduleList(schedules=views)


@router.get("/night", dependencies=[needs(Right.VIEW), KNOWN_KEYS], response_model=list[NightEntry], responses=OR_CSV)
async def get_night(request: Request, parts: PartsOf, form: Form = None) -> object:
    """Return the last night's checks and the coming night's, valve by valve."""
    entries = await asyncio.to_thread(night, parts.plant, parts.store.schedule_runs, wall_clock())
    if not wants_csv(request, form):
        return entries
    columns = tuple(NightEntry.model_fields)
    return csv_answer(columns, ([getattr(one, name) for name in columns] for one in entries), dated("night"))


@router.post("/{name}/run", status_code=HTTPStatus.ACCEPTED, dependencies=[needs(Right.SCHEDULE)])
async def run_schedule(name: str, parts: PartsOf, asks: Asks) -> LastRun | None:
    """Queue the checks of a schedule now; each waits for its turn within the schedule's window.

    A valve of another gateway is not checked by this one: its own gateway is asked. Null where this has none.
    """
    schedule = parts.nightly.schedule(name)
    note = partial(parts.audit.append, "schedule.run", who=asks.name, details={"schedule": schedule.name})
    await asyncio.to_thread(note)
    checks = await parts.nightly.run_now(name, asks.name)
    return last_run(checks)
