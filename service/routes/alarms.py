"""``/alarms``: all that somebody must do something about, of the plant and of its valves."""

from __future__ import annotations

import asyncio
from datetime import datetime

from fastapi import APIRouter
from pydantic import BaseModel, Field

from service.access.needs import needs
from service.access.principal import Right
from service.config.plant import Plant
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.acknowledgement import alarm_of
from service.runs.motion_watch import MotionWatch
from service.runs.service import Runs
from service.store.conditions import valve_standings
from service.store.run_table import ValveHead
from service.store.store import Store
from valve.messages import say

router = APIRouter(prefix="/alarms", tags=["valves"], responses=PROBLEMS)
_OF_A_VALVE = "valve"


class AlarmView(BaseModel):
    """One alarm that stands."""

    alarm: str = Field(
        description="motion_process: it does not answer; plant_file: service and motion process have read different "
        "ones; valve: a test of it ended badly and nobody has acknowledged it"
    )
    since: datetime
    sentence: str
    remedy: str
    valves: list[str] = Field(description="those that it is about; empty: all")


class AlarmList(BaseModel):
    """The alarms that stand now, those of the plant first."""

    alarms: list[AlarmView]


@router.get("", dependencies=[needs(Right.VIEW)])
async def list_alarms(
    plant: Given[Plant], store: Given[Store], runs: Given[Runs], watch: Given[MotionWatch]
) -> AlarmList:
    """List the alarms that stand: of the plant until their cause is gone, of a valve until somebody acknowledges."""
    heads = await asyncio.to_thread(_in_doubt, plant, store)
    of_plant = [
        AlarmView(
            alarm=one.kind.value, since=one.since, sentence=one.sentence, remedy=one.remedy, valves=list(one.valves)
        )
        for one in watch.alarms
    ]
    return AlarmList(alarms=[*of_plant, *(view for tag in sorted(heads) if (view := _of_valve(runs, heads[tag])))])


def _in_doubt(plant: Plant, store: Store) -> dict[str, ValveHead]:
    """Return the valves whose last test may be an alarm, with that test; reads the database."""
    standings = valve_standings(store.engine)
    tags = [tag for tag in plant.valves if tag in standings and standings[tag].may_be_bad]
    return store.runs.valve_heads(tags) if tags else {}


def _of_valve(runs: Runs, head: ValveHead) -> AlarmView | None:
    last = runs.as_it_stands(head.last)
    sentence = alarm_of(last)
    if not sentence:
        return None
    return AlarmView(
        alarm=_OF_A_VALVE,
        since=last.finished_at or last.created_at,
        sentence=sentence,
        remedy=say(
            "look_and_say",
            "look at the valve, then say what was found on its page, or by breakaway acknowledge {valve}",
            valve=last.valve,
        ),
        valves=[last.valve],
    )
