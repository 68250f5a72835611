"""``/alarms``: all that somebody must do something about, of the plant and of its valves."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Depends
from pydantic import BaseModel, Field

from service.access.needs import needs
from service.access.principal import Right
from service.http.problems import PROBLEMS
from service.model.acknowledgement import alarm_of
from service.parts import Parts, parts_of
from service.store.conditions import valve_standings
from service.store.run_table import ValveHead

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
async def list_alarms(parts: Annotated[Parts, Depends(parts_of)]) -> AlarmList:
    """List the alarms that stand: of the plant until their cause is gone, of a valve until somebody acknowledges."""
    heads = await asyncio.to_thread(_in_doubt, parts)
    of_plant = [
        AlarmView(
            alarm=one.kind.value, since=one.since, sentence=one.sentence, remedy=one.remedy, valves=list(one.valves)
        )
        for one in parts.motion_watch.alarms
    ]
    return AlarmList(alarms=[*of_plant, *(view for tag in sorted(heads) if (view := _of_valve(parts, heads[tag])))])


def _in_doubt(parts: Parts) -> dict[str, ValveHead]:
    """Return the valves whose last test may be an alarm, with that test; reads the database."""
    standings = valve_standings(parts.store.engine)
    tags = [tag for tag in parts.plant.valves if tag in standings and standings[tag].may_be_bad]
    return parts.store.runs.valve_heads(tags) if tags else {}


def _of_valve(parts: Parts, head: ValveHead) -> AlarmView | None:
    last = parts.runs.as_it_stands(head.last)
    sentence = alarm_of(last)
    if not sentence:
        return None
    return AlarmView(
        alarm=_OF_A_VALVE,
        since=last.finished_at or last.created_at,
        sentence=sentence,
        remedy=f"look at the valve, then say what was found on its page, or by breakaway acknowledge {last.valve}",
        valves=[last.valve],
    )
