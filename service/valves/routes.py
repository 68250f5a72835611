"""``/valves``: what the plant has, and how each valve did last."""

from __future__ import annotations

import asyncio
from bisect import bisect_right
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Annotated, Any, Final
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Depends, Query, Response
from pydantic import BaseModel, Field

from service.access.needs import needs
from service.access.principal import Right
from service.health.results import PastTest
from service.health.trend_view import TrendView, trends_of_tests
from service.parts import Parts, parts_of
from service.problems import PROBLEMS
from service.runs.acknowledgement import alarm_of
from service.runs.run import Run
from service.runs.sequences import SEQUENCES, default_of
from service.runs.views import RunSummary, RunView, summary, view
from service.store.run_table import ValveHead
from service.store.store import Store

router = APIRouter(prefix="/valves", tags=["valves"], responses=PROBLEMS)
PartsOf = Annotated[Parts, Depends(parts_of)]

_TREND_TESTS: Final = 40


class ValveSummary(BaseModel):
    """One valve in the list."""

    tag: str
    href: str
    buses: list[str]
    acquisition: str
    busy_with: str | None = Field(description="id of the test that uses the valve now")
    last_test: RunSummary | None
    alarms: list[str] = Field(description="what stands until somebody acknowledges it, in words")
    health: dict[str, Any] | None = Field(description="NAMUR NE 107 state of the last completed test, with reasons")


class ValveView(ValveSummary):
    """One valve with what it is and what it may do."""

    nameplate: dict[str, Any]
    limits: dict[str, Any]
    safe_value_pa: float | str
    safe_position_m: float | None = Field(description="where the stem should stand then; null where none is declared")
    safe_position_tolerance_m: float | None
    stem_read_after_s: float
    sequences: list[str]
    default_sequence: str | None = Field(description="what a test runs that names none; null where none is possible")
    default_sequence_reason: str = Field(description="why it is not the usual one; empty where it is")
    last_result: RunView | None = Field(description="the last completed test")
    trend: list[TrendView] = Field(description="the main figures over the newest tests; /trend has more")


class ValveList(BaseModel):
    """Valves of the plant by their tags, and where the following ones are."""

    valves: list[ValveSummary]
    next: str | None


def _summary(parts: Parts, tag: str, head: ValveHead | None) -> dict[str, Any]:
    valve, now = parts.plant.valves[tag], datetime.now(UTC)
    oldest = parts.staleness.oldest(tag, now)
    last = None if head is None else parts.runs.as_it_stands(head.last)
    alarm = alarm_of(last)
    return {
        "tag": tag,
        "href": f"/valves/{quote(tag)}",
        "buses": sorted(valve.buses),
        "acquisition": valve.wiring.acquisition.mode.value,
        "busy_with": parts.runs.user_of(tag),
        "last_test": None if last is None else summary(last),
        "alarms": [alarm] if alarm else [],
        "health": None if head is None else oldest.health(head.health, head.completed_at, now),
    }


@router.get("", dependencies=[needs(Right.VIEW)], response_model=ValveList)
async def list_valves(
    parts: PartsOf,
    limit: Annotated[int, Query(ge=1, le=5000)] = 200,
    after: Annotated[
        str | None, Query(max_length=64, pattern=r"^[^\x00]*$", description="a tag: list what comes after it")
    ] = None,
) -> Response:
    """List the plant's valves by their tags, each with its last test."""
    tags = sorted(parts.plant.valves)
    tags = tags if after is None else tags[bisect_right(tags, after) :]
    page = tags[:limit]
    heads = await asyncio.to_thread(parts.store.runs.valve_heads, page)
    following = f"/valves?{urlencode({'limit': limit, 'after': page[-1]})}" if len(tags) > limit else None
    listed = ValveList(valves=[ValveSummary(**_summary(parts, tag, heads.get(tag))) for tag in page], next=following)
    return Response(listed.model_dump_json(), media_type="application/json")  # it was validated as it was made


@router.get("/{tag:path}", dependencies=[needs(Right.VIEW)], response_model=ValveView)
async def get_valve(tag: str, parts: PartsOf) -> Response:
    """Return one valve with its last completed test."""
    valve = parts.runs.valve(tag)
    head, result, past = await asyncio.to_thread(_stored, parts.store, tag)
    default, reason = default_of(valve.nameplate, valve.wiring.limits)
    rest = valve.wiring.rest
    shown = ValveView(
        **_summary(parts, tag, head),
        nameplate=asdict(valve.nameplate),
        limits=asdict(valve.wiring.limits),
        safe_value_pa=valve.wiring.safe_value_pa,
        safe_position_m=rest.position_m,
        safe_position_tolerance_m=None if rest.position_m is None else rest.tolerance_m,
        stem_read_after_s=rest.after_s,
        sequences=list(SEQUENCES),
        default_sequence=default,
        default_sequence_reason=reason,
        last_result=None if result is None else view(result),
        trend=trends_of_tests(past),
    )
    return Response(shown.model_dump_json(), media_type="application/json")  # it was validated as it was made


def _stored(store: Store, tag: str) -> tuple[ValveHead | None, Run | None, list[PastTest]]:
    """Return a valve's last test, its last completed one and the figures of the newest; reads the database."""
    head = store.runs.valve_heads([tag]).get(tag)
    result = store.runs.last_completed(tag) if head is not None and head.completed_number is not None else None
    return head, result, [] if result is None else store.figures.newest(tag, _TREND_TESTS)
