"""``/valves/{tag}/watched``: what days in service said of a valve, read while its controller moved it."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from datetime import date, datetime
from typing import Annotated, Any, Final, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from drivers.motion.orders import MotionLink, MotionLostError
from service.access.needs import needs
from service.access.principal import Right
from service.config.plant import PlantValve
from service.health.watched import notes_of, present_nameplate
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.run import file_words
from service.model.watched_day import WatchedDay
from service.routes.lists import KNOWN_KEYS, OR_CSV, Form, csv_answer, dated, wants_csv
from service.runs.service import Runs
from service.runs.unread import unread_of
from service.store.store import Store

router = APIRouter(prefix="/valves", tags=["health"], responses=PROBLEMS)

_MOST_DAYS: Final = 1000
_FIGURES: Final = (
    *("friction", "breakaway", "breakaway_up", "breakaway_down", "spring_rate"),
    *("dead_band_percent", "stick_band_percent", "slip_jump_percent", "lag"),
)
_COLUMNS: Final = (
    *("day", "began_at", "ended_at", "rows", "moves", "reason"),
    *(f"{name}{end}" for name in _FIGURES for end in ("", "_low", "_high")),
)


class WatchedDayView(BaseModel):
    """A day of a valve in service. It was watched and not tested."""

    source: Literal["watched"] = "watched"
    day: date = Field(description="on which its watching begins, by the plant's zone")
    began_at: datetime = Field(description="of the first row that was kept")
    ended_at: datetime
    rows: int = Field(description="kept of the day: the windows in which the stem moved")
    judged_at: datetime
    software: str
    result: dict[str, Any] | None = Field(
        description="as `breakaway watch --json` writes it (breakaway/watch/1); null where nothing could be said"
    )
    reason: str = Field(description="why there is no result; empty where there is one")
    travel_m: float | None = Field(description="of the nameplate by which the day was judged; null: not known")
    area_m2: float | None = Field(description="its effective area")


class WatchRulesView(BaseModel):
    """How the plant file has a valve watched."""

    period_s: float
    begins: str | None = Field(description="from when, by the plant's zone; null: all day")
    ends: str | None
    keep_days: int = Field(description="how long samples are kept; what they gave is kept for ever")


class UnreadView(BaseModel):
    """Why a valve in service cannot be read now."""

    since: datetime
    reason: str = Field(description="with what to do")


class WatchedPage(BaseModel):
    """What days in service said of a valve, newest first."""

    valve: str
    rules: WatchRulesView | None = Field(description="null: the plant file has no [valves.watch] for it")
    slots: dict[str, int] | None = Field(
        description="read, missed, failed; rows kept, and dropped as the disk was late: since the motion process "
        "started; null where that is not known"
    )
    unread: UnreadView | None = Field(description="null: the valve is read, or is not to be read now, or nobody knows")
    notes: list[str] = Field(
        description="which of these days are not held against each other and why, and when nothing was kept"
    )
    days: list[WatchedDayView]


def day_view(found: WatchedDay) -> WatchedDayView:
    """Return a day as the interface shows it."""
    return WatchedDayView(
        day=found.day,
        began_at=found.began_at,
        ended_at=found.ended_at,
        rows=found.rows,
        judged_at=found.judged_at,
        software=found.software,
        result=None if found.document is None else dict(found.document),
        reason=found.reason,
        travel_m=found.judged_by.travel_m,
        area_m2=found.judged_by.area_m2,
    )


@router.get(
    "/{tag:path}/watched", dependencies=[needs(Right.VIEW), KNOWN_KEYS], response_model=WatchedPage, responses=OR_CSV
)
async def get_watched(
    request: Request,
    tag: str,
    runs: Given[Runs],
    store: Given[Store],
    motion: Given[MotionLink],
    *,
    limit: Annotated[int, Query(ge=1, le=_MOST_DAYS)] = 30,
    form: Form = None,
) -> Response:
    """Return what days in service said of a valve, newest first; as CSV a row a day with its main figures, SI.

    A day is judged when it is over. Nothing was written to the valve for it.
    """
    valve = runs.valve(tag)
    days = await asyncio.to_thread(store.watched.newest, tag, limit)
    if wants_csv(request, form):
        return csv_answer(_COLUMNS, (_line(day) for day in reversed(days)), dated(f"{file_words(tag)}_watched"))
    slots, unread = (await _slots(motion)).get(tag), await unread_of(motion, tag, valve)
    shown = WatchedPage(
        valve=tag,
        rules=_rules(valve),
        slots=None if slots is None else dict(slots),
        unread=None if unread is None else UnreadView(since=unread.since, reason=unread.reason),
        notes=list(notes_of(days, present_nameplate(valve))),
        days=[day_view(day) for day in days],
    )
    return Response(shown.model_dump_json(), media_type="application/json", headers={"Vary": "Accept"})


async def _slots(motion: MotionLink) -> Mapping[str, Mapping[str, int]]:
    try:
        return await motion.watched()
    except MotionLostError:
        return {}


def _rules(valve: PlantValve) -> WatchRulesView | None:
    rules = valve.wiring.watch
    if rules is None:
        return None
    begins, ends = (None if one is None else f"{one:%H:%M}" for one in (rules.begins, rules.ends))
    return WatchRulesView(period_s=rules.period_s, begins=begins, ends=ends, keep_days=rules.keep_days)


def _line(found: WatchedDay) -> list[object]:
    moves = None if found.document is None else found.document["moves"]
    row: list[object] = [found.day, found.began_at, found.ended_at, found.rows, moves, found.reason]
    for name in _FIGURES:
        figure = found.figure(name)
        row += [None] * 3 if figure is None else [figure.value, *(figure.ci95 or (None, None))]
    return row
