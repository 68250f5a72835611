"""The pages of one valve: how it is, and what a test of it would do."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Request, Response

from drivers.addresses import Mode
from drivers.motion.orders import MotionLink
from service.config.plant import Plant
from service.figures.signature import has_signature
from service.health.staleness import Staleness
from service.health.watched import notes_of, present_nameplate
from service.http.given import Given
from service.model.acknowledgement import needs_acknowledgement
from service.model.run import Run
from service.report.valve_facts import (
    DESCRIPTION,
    class_facts,
    identity_facts,
    safe_position_words,
    safe_value_words,
)
from service.runs.service import Runs
from service.runs.unread import unread_of
from service.schedules.views import due_checks
from service.shown.ending import standing_at
from service.shown.forecast import forecasts_of
from service.shown.history import history_row, past_of
from service.shown.in_service import in_service_of
from service.shown.words import condition_of
from service.store.store import Store
from service.tablet.figure_addresses import figure_query, trend_address
from service.tablet.plans import AROUND_S, approved_plans, plans_of
from service.tablet.rendering import PagesOf
from service.tablet.visitor import VisitorOf
from service.words.names import named
from valve.errors import NotFoundError
from valve.messages import say

router = APIRouter(include_in_schema=False)

_HISTORY: Final = 20
#: By what a polled test can be asked to end early, in the words of its form.
_UNTIL_WORDS: Final = {
    "F_s": say("until_breakaway", "breakaway F_s"),
    "F_c": say("until_friction", "friction F_c"),
    "k": say("until_spring_rate", "spring rate k"),
}


@router.get("/ui/valves/{tag:path}/start")
async def start_page(
    request: Request,
    pages: PagesOf,
    tag: str,
    *,
    plant: Given[Plant],
    store: Given[Store],
    runs: Given[Runs],
    visitor: VisitorOf,
) -> Response:
    """Show what a test would do, and the two steps that start it."""
    try:
        valve = runs.valve(tag)
    except NotFoundError as error:
        return pages.missing(visitor, error)
    reader = pages.reader
    approved = None if visitor.may_configure else plant.service.access.approved_sequences
    values = {
        "tag": tag,
        "busy_with": runs.user_of(tag),
        "travel_m": valve.nameplate.actuator.travel_m,
        "needs_permit": valve.wiring.permissives.permit,
        "plans": approved_plans(await asyncio.to_thread(plans_of, valve, store), approved),
        "wanted": request.query_params.get("sequence"),
        "around_s": AROUND_S,
        "until": _UNTIL_WORDS if valve.wiring.acquisition.mode is Mode.POLLED else {},
        "safe_words": safe_value_words(valve.wiring.safe_value_pa, reader),
    }
    return pages.show("start.html", visitor, values)


@dataclass(frozen=True, slots=True)
class _OneValve:
    """What the page of one valve is made from."""

    plant: Plant
    store: Store
    runs: Runs
    staleness: Staleness
    motion: MotionLink


async def _one_valve(
    plant: Given[Plant],
    store: Given[Store],
    runs: Given[Runs],
    staleness: Given[Staleness],
    motion: Given[MotionLink],
) -> _OneValve:
    return _OneValve(plant, store, runs, staleness, motion)


@router.get("/ui/valves/{tag:path}")
async def valve_page(
    pages: PagesOf, tag: str, source: Annotated[_OneValve, Depends(_one_valve)], visitor: VisitorOf
) -> Response:
    """Show one valve."""
    try:
        valve = source.runs.valve(tag)
    except NotFoundError as error:
        return pages.missing(visitor, error)
    reader, now = pages.reader, datetime.now(UTC)
    due = due_checks(source.plant, now)
    past = await asyncio.to_thread(past_of, source.store, tag, valve)
    last = source.runs.as_it_stands(past.newest[0]) if past.newest else None
    latest, figures = past.latest, {test.test_id: test for test in past.figures}
    health = _standing(source.staleness, latest, tag)
    values = {
        "tag": tag,
        "busy_with": source.runs.user_of(tag),
        "condition_now": condition_of(
            last, health.get("ne107"), is_busy=source.runs.user_of(tag) is not None, is_tested=last is not None
        ),
        "unacknowledged": last if last is not None and needs_acknowledgement(last) else None,
        "reasons": health.get("reasons") or () if health.get("ne107") else (),
        "latest": latest,
        "baseline": past.baseline,
        "baseline_is_other": latest is not None and past.baseline is not None and past.baseline.id != latest.id,
        "signature_address": None
        if latest is None or not has_signature((latest.analysis or {}).get("signature"))
        else f"/ui/figures/tests/{latest.id}/signature.svg?{figure_query(past, latest, reader)}"
        + ("" if past.baseline is None or past.baseline.id == latest.id else f"&with={past.baseline.id}"),
        "trend_address": trend_address(tag, past, reader),
        "in_service": in_service_of(valve.wiring.watch, past.watched),
        "unread": await unread_of(source.motion, tag, valve),
        "in_service_notes": notes_of(past.watched, present_nameplate(valve)),
        "trend_words": say(
            "trend_of", "Friction, spring rate, bench set and dead band over the tests; figures stand below."
        ),
        "forecasts": [one.sentence(now, source.plant.zone) for one in forecasts_of(health, now)],
        "next_check": due.get(tag),
        "description": valve.identity.description,
        "identity": [
            *(one for one in identity_facts(valve.identity) if one[0] != DESCRIPTION),
            *class_facts(valve),
        ],
        "travel_m": valve.nameplate.actuator.travel_m,
        "limits": valve.wiring.limits,
        "safe_words": safe_value_words(valve.wiring.safe_value_pa, reader),
        "safe_position": safe_position_words(valve.wiring.rest, reader),
        **standing_at(last),
        "acquisition": say(
            "acquired_every",
            "{mode}, every {period:g ms}",
            mode=named(valve.wiring.acquisition.mode.value),
            period=valve.wiring.acquisition.period_s,
        ),
        "buses": ", ".join(sorted(valve.buses)),
        "history": [history_row(source.runs.as_it_stands(run), figures.get(run.id)) for run in past.newest[:_HISTORY]],
    }
    return pages.show("valve.html", visitor, values)


def _standing(staleness: Staleness, latest: Run | None, tag: str) -> Mapping[str, Any]:
    """Return health as it stands today, of the last completed test and of days in service."""
    now = datetime.now(UTC)
    oldest = staleness.oldest(tag, now)
    if latest is None:
        return oldest.health(None, None, now) or {}
    return oldest.health((latest.analysis or {}).get("health") or {}, latest.created_at, now) or {}
