"""``/valves``: what the plant has, and how each valve did last."""

from __future__ import annotations

import asyncio
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Final
from urllib.parse import quote

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, Field

from service.access.needs import needs
from service.access.principal import Right
from service.config.plant import Plant
from service.health.results import Ne107
from service.health.staleness import Staleness
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.acknowledgement import alarm_of
from service.model.health_figures import MAIN_FIGURES
from service.model.past_test import PastTest
from service.model.run import Label, Run, RunState
from service.model.sequences import SEQUENCES, default_of
from service.model.watched_day import WatchedDay
from service.routes.lists import (
    KNOWN_KEYS,
    OR_CSV,
    Areas,
    Form,
    Since,
    Until,
    csv_answer,
    dated,
    next_page,
    tags_of_areas,
    wants_csv,
)
from service.routes.run_views import RunSummary, RunView, summary, view
from service.routes.trend_view import HEALTH_SCHEMA, TrendView, trends_of
from service.routes.watched import WatchedDayView, day_view
from service.runs.service import Runs
from service.store.conditions import ValveStanding, last_labelled, valve_standings
from service.store.run_table import ValveHead
from service.store.store import Store

router = APIRouter(prefix="/valves", tags=["valves"], responses=PROBLEMS)

_TREND_TESTS: Final = 40
_COLUMNS: Final = (
    *("valve", "last_test", "state", "last_test_at", "last_result_at", "ne107", "reasons"),
    *MAIN_FIGURES,
    *("alarms", "busy_with"),
)


class ValveSummary(BaseModel):
    """One valve in the list."""

    tag: str
    href: str
    description: str | None = Field(description="as the plant file says it, as area; null where it does not")
    area: str | None
    buses: list[str]
    acquisition: str
    busy_with: str | None = Field(description="id of the test that uses the valve now")
    last_test: RunSummary | None
    alarms: list[str] = Field(description="what stands until somebody acknowledges it, in words")
    health: dict[str, Any] | None = Field(
        description="NAMUR NE 107 state of the last completed test, and of days in service, with reasons",
        json_schema_extra=HEALTH_SCHEMA,
    )


class ValveView(ValveSummary):
    """One valve with what it is and what it may do."""

    service: str | None = Field(description="what flows through it, and what it is for")
    manufacturer: str | None
    model: str | None
    serial_number: str | None
    nameplate: dict[str, Any]
    limits: dict[str, Any]
    limits_class: str | None = Field(description="class that its acceptance limits come from, as plant.toml names it")
    safe_value_pa: float | str
    safe_position_m: float | None = Field(description="where the stem should stand then; null where none is declared")
    safe_position_tolerance_m: float | None
    stem_read_after_s: float
    sequences: list[str]
    default_sequence: str | None = Field(description="what a test runs that names none; null where none is possible")
    default_sequence_reason: str = Field(description="why it is not the usual one; empty where it is")
    last_result: RunView | None = Field(description="the last completed test")
    trend: list[TrendView] = Field(description="the main figures over the newest tests; /trend has more")
    last_watched: WatchedDayView | None = Field(description="the last day in service; /watched has more")


class ValveList(BaseModel):
    """Valves of the plant by their tags, and where the following ones are."""

    valves: list[ValveSummary]
    next: str | None


@dataclass(frozen=True, slots=True)
class _Source:
    """What valves and how they stand are read from."""

    plant: Plant
    store: Store
    runs: Runs
    staleness: Staleness


async def _source(plant: Given[Plant], store: Given[Store], runs: Given[Runs], staleness: Given[Staleness]) -> _Source:
    return _Source(plant, store, runs, staleness)


SourceOf = Annotated[_Source, Depends(_source)]


def _summaries(source: _Source, tags: Sequence[str], heads: Mapping[str, ValveHead]) -> list[dict[str, Any]]:
    """What the list shows of each valve that the plant has: a reload may have taken some since they were asked for."""
    return [_summary(source, tag, heads.get(tag)) for tag in tags if tag in source.plant.valves]


def _summary(source: _Source, tag: str, head: ValveHead | None) -> dict[str, Any]:
    valve, now = source.plant.valves[tag], datetime.now(UTC)
    oldest = source.staleness.oldest(tag, now)
    last = None if head is None else source.runs.as_it_stands(head.last)
    alarm = alarm_of(last)
    health, completed_at = (None, None) if head is None else (head.health, head.completed_at)
    return {
        "tag": tag,
        "href": f"/valves/{quote(tag)}",
        "description": valve.identity.description,
        "area": valve.identity.area,
        "buses": sorted(valve.buses),
        "acquisition": valve.wiring.acquisition.mode.value,
        "busy_with": source.runs.user_of(tag),
        "last_test": None if last is None else summary(last),
        "alarms": [alarm] if alarm else [],
        "health": oldest.health(health, completed_at, now),
    }


@dataclass(frozen=True, slots=True)
class _Asked:
    """Which valves are meant, by their area and last test; what is empty or None asks for nothing."""

    areas: Sequence[str]
    states: Sequence[RunState]
    ne107: Sequence[Ne107]
    labels: Sequence[Label]
    since: datetime | None
    until: datetime | None

    def tags(self, source: _Source) -> list[str]:
        """Return their tags, sorted. Reads the database.

        One that was never tested has no last test to be asked for; its state is known where days in service give it.
        """
        tags = tags_of_areas(source.plant, self.areas)
        if not any((self.states, self.ne107, self.labels, self.since, self.until)):
            return tags
        standings, now = valve_standings(source.store.engine), datetime.now(UTC)
        labelled = last_labelled(source.store.engine, self.labels) if self.labels else None
        found = []
        for tag in tags:
            standing, oldest = standings.get(tag), source.staleness.oldest(tag, now)
            if standing is None:
                if self._asks_for_state_alone and oldest.state(None, None) in self.ne107:
                    found.append(tag)
                continue
            if labelled is not None and tag not in labelled:
                continue
            if self._fits(standing, oldest.state(standing.ne107, standing.completed_at)):
                found.append(tag)
        return found

    @property
    def _asks_for_state_alone(self) -> bool:
        return not any((self.states, self.labels, self.since, self.until))

    def _fits(self, standing: ValveStanding, ne107: str | None) -> bool:
        return (
            (not self.states or standing.state in self.states)
            and (not self.ne107 or ne107 in self.ne107)
            and (self.since is None or standing.last_at >= self.since)
            and (self.until is None or standing.last_at < self.until)
        )


@router.get("", dependencies=[needs(Right.VIEW), KNOWN_KEYS], response_model=ValveList, responses=OR_CSV)
async def list_valves(  # noqa: PLR0917 - each is a query key
    request: Request,
    source: SourceOf,
    limit: Annotated[int, Query(ge=1, le=5000)] = 200,
    after: Annotated[
        str | None, Query(max_length=64, pattern=r"^[^\x00]*$", description="a tag: list what comes after it")
    ] = None,
    area: Areas = None,
    state: Annotated[list[RunState] | None, Query(description="one of these states of the last test")] = None,
    ne107: Annotated[list[Ne107] | None, Query(description="one of these NE 107 states, as it stands today")] = None,
    label: Annotated[list[Label] | None, Query(description="one of these labels of the last test")] = None,
    since: Since = None,
    until: Until = None,
    form: Form = None,
) -> Response:
    """List the plant's valves by their tags, each with its last test; as CSV with its main figures, SI.

    A filter other than `area` asks for the last test: a valve that was never tested is not in the list then, but for
    one whose `ne107` comes from days in service.
    """
    asked = _Asked(area or (), state or (), ne107 or (), label or (), since, until)
    tags = await asyncio.to_thread(asked.tags, source)
    tags = tags if after is None else tags[bisect_right(tags, after) :]
    page = tags[:limit]
    heads = await asyncio.to_thread(source.store.runs.valve_heads, page)
    following = None
    if len(tags) > limit:
        filters = {"area": area, "state": state, "ne107": ne107, "label": label, "since": since, "until": until}
        following = next_page("/valves", {"limit": limit, "after": page[-1], **filters, "format": form})
    if wants_csv(request, form):
        figures = await asyncio.to_thread(source.store.figures.of_last_results, MAIN_FIGURES)
        shown = _summaries(source, page, heads)
        rows = [_line(one, figures.get(one["tag"], {}), heads.get(one["tag"])) for one in shown]
        return csv_answer(_COLUMNS, rows, dated("valves"), following)
    listed = ValveList(valves=[ValveSummary(**one) for one in _summaries(source, page, heads)], next=following)
    headers = {"Vary": "Accept"}
    return Response(listed.model_dump_json(), media_type="application/json", headers=headers)  # it was validated


def _line(shown: Mapping[str, Any], figures: Mapping[str, float], head: ValveHead | None) -> list[object]:
    last, health = shown["last_test"], shown["health"] or {}
    about = (None,) * 3 if last is None else (last.id, last.state.value, last.created_at)
    return [
        shown["tag"],
        *about,
        None if head is None else head.completed_at,
        health.get("ne107"),
        "; ".join(health.get("reasons") or ()),
        *(figures.get(key) for key in MAIN_FIGURES),
        "; ".join(shown["alarms"]),
        shown["busy_with"],
    ]


@router.get("/{tag:path}", dependencies=[needs(Right.VIEW)], response_model=ValveView)
async def get_valve(tag: str, source: SourceOf) -> Response:
    """Return one valve with its last completed test."""
    valve = source.runs.valve(tag)
    head, result, past, days = await asyncio.to_thread(_stored, source.store, tag)
    default, reason = default_of(valve.nameplate, valve.wiring.limits)
    rest = valve.wiring.rest
    shown = ValveView(
        **_summary(source, tag, head),
        service=valve.identity.service,
        manufacturer=valve.identity.manufacturer,
        model=valve.identity.model,
        serial_number=valve.identity.serial_number,
        nameplate=asdict(valve.nameplate),
        limits=asdict(valve.wiring.limits),
        limits_class=valve.limits_class or None,
        safe_value_pa=valve.wiring.safe_value_pa,
        safe_position_m=rest.position_m,
        safe_position_tolerance_m=None if rest.position_m is None else rest.tolerance_m,
        stem_read_after_s=rest.after_s,
        sequences=list(SEQUENCES),
        default_sequence=default,
        default_sequence_reason=reason,
        last_result=None if result is None else view(result),
        trend=trends_of(past, days),
        last_watched=day_view(days[0]) if days else None,
    )
    return Response(shown.model_dump_json(), media_type="application/json")  # it was validated as it was made


def _stored(store: Store, tag: str) -> tuple[ValveHead | None, Run | None, list[PastTest], list[WatchedDay]]:
    """Return a valve's last test, its last completed one, the newest figures and days; reads the database."""
    head = store.runs.valve_heads([tag]).get(tag)
    result = store.runs.last_completed(tag) if head is not None and head.completed_number is not None else None
    past = [] if result is None else store.figures.newest(tag, _TREND_TESTS)
    return head, result, past, store.watched.newest(tag, _TREND_TESTS)
