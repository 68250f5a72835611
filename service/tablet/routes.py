"""The tablet's pages."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Annotated, Any, Final
from urllib.parse import quote
from zoneinfo import ZoneInfo

from fastapi import APIRouter, Depends, Query, Request, Response

from drivers.addresses import Mode
from drivers.motion.orders import MotionLink
from service.config.settings import Plant
from service.figures.methods import all_estimates, can_compare
from service.figures.signature import has_signature
from service.health.earlier import EarlierResults
from service.health.judge import facts_of
from service.health.staleness import Staleness
from service.health.watched import notes_of, present_nameplate
from service.http.given import Given
from service.model.acknowledgement import alarm_words, needs_acknowledgement
from service.model.run import Run, RunState
from service.model.stands_words import where_it_stands
from service.model.until import SYMBOLS, early_words
from service.report.before_after import BeforeAfter, before_after
from service.report.of_run import repair_sentences
from service.report.summary import key_figures
from service.report.valve_facts import class_facts, identity_facts, safe_position_words, safe_value_words
from service.runs.again import can_be_analysed
from service.runs.service import Runs
from service.runs.unread import unread_of
from service.shown.ending import ending_of
from service.shown.forecast import forecasts_of
from service.shown.history import ValvePast, history_row, past_of
from service.shown.in_service import in_service_of
from service.shown.next_step import next_step
from service.shown.overlays import before_of, overlays_of, words_of
from service.shown.results import (
    diagnosis_of,
    figure_rows,
    method_messages,
    method_names,
    missing_reasons,
    parameter_rows,
    reasons_beside,
    recording_facts,
    told_once,
)
from service.shown.words import NE107, STATES, alarm_condition, condition_of
from service.store.store import Store
from service.tablet.night import NightWish, due_checks, night_of
from service.tablet.plans import AROUND_S, approved_plans, planned_line, plans_of, waveform_of
from service.tablet.rendering import Pages, PagesOf
from service.tablet.since import since_yesterday
from service.tablet.valve_list import ValveList, Wish
from service.tablet.valve_rows import ValveSource, ValveSourceOf, valve_rows, valve_stands
from service.tablet.visitor import Visitor, VisitorOf
from service.words.units import UnitSystem, shown_unit
from valve.errors import NotFoundError, ValveError

router = APIRouter(include_in_schema=False)

_HISTORY: Final = 20
#: By what a polled test can be asked to end early, in the words of its form.
_UNTIL_WORDS: Final = dict(zip(SYMBOLS, ("breakaway F_s", "friction F_c", "spring rate k"), strict=True))
_SOON: Final = "The first estimate comes at the first turning point."
_NO_ESTIMATES: Final = "The device samples by itself: the estimates come when its samples are fetched."


@router.get("/")
async def valves_page(
    pages: PagesOf,
    source: ValveSourceOf,
    earlier: Given[EarlierResults],
    visitor: VisitorOf,
    wish: Annotated[Wish, Query()],
) -> Response:
    """Show the valves, worst first, and what changed since yesterday."""
    values = await asyncio.to_thread(_valves_shown, source, earlier, wish, due_checks(source.plant))
    return pages.show("valves.html", visitor, values)


def _valves_shown(
    source: ValveSource, earlier: EarlierResults, wish: Wish, due: Mapping[str, datetime]
) -> dict[str, Any]:
    stands = valve_stands(source)
    since = since_yesterday(source, earlier, stands, datetime.now(UTC))
    listed = ValveList(source.plant.valves, stands, since.changes, wish)
    return {
        "rows": valve_rows(source, listed.shown, due),
        "listed": listed,
        "chips": listed.chips(),
        "since": since,
        "valve_count": len(stands),
        "wish": wish,
    }


@router.get("/ui/night")
async def night_page(
    pages: PagesOf, plant: Given[Plant], store: Given[Store], visitor: VisitorOf, wish: Annotated[NightWish, Query()]
) -> Response:
    """Show the last and the coming night valve by valve, and the schedules."""
    return pages.show("night.html", visitor, {"night": await night_of(plant, store, wish), "wish": wish})


@router.get("/ui/recordings")
async def recordings_page(pages: PagesOf, plant: Given[Plant], visitor: VisitorOf) -> Response:
    """Show the form that analyses a file that exists already."""
    return pages.show("recordings.html", visitor, {"tags": sorted(plant.valves)})


@router.get("/ui/sign-in")
async def sign_in_page(
    pages: PagesOf, next_path: Annotated[str, Query(alias="next", max_length=300)] = "/"
) -> Response:
    """Show the page where a person signs in."""
    inside = next_path.startswith("/") and not next_path.startswith(("//", "/\\"))
    return pages.show("sign_in.html", None, {"next": next_path if inside else "/"})


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
        return _missing(pages, visitor, error)
    system = pages.system
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
        "safe_words": safe_value_words(valve.wiring.safe_value_pa, system),
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
        return _missing(pages, visitor, error)
    system, due, now = pages.system, due_checks(source.plant), datetime.now(UTC)
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
        else f"/ui/figures/tests/{latest.id}/signature.svg?{_query(past, latest, system, source.plant.zone)}"
        + ("" if past.baseline is None or past.baseline.id == latest.id else f"&with={past.baseline.id}"),
        "trend_address": _trend_address(tag, past, system, source.plant.zone),
        "in_service": in_service_of(valve.wiring.watch, past.watched),
        "unread": await unread_of(source.motion, tag, valve),
        "in_service_notes": notes_of(past.watched, present_nameplate(valve)),
        "trend_words": "Friction, spring rate, bench set and dead band over the tests; figures stand below.",
        "forecasts": [one.sentence(now, source.plant.zone) for one in forecasts_of(health, now)],
        "next_check": due.get(tag),
        "description": valve.identity.description,
        "identity": [
            *(one for one in identity_facts(valve.identity) if one[0] != "Description"),
            *class_facts(valve),
        ],
        "travel_m": valve.nameplate.actuator.travel_m,
        "limits": valve.wiring.limits,
        "safe_words": safe_value_words(valve.wiring.safe_value_pa, system),
        "safe_position": safe_position_words(valve.wiring.rest, system),
        **_standing_at(last),
        "acquisition": f"{valve.wiring.acquisition.mode.value}, every {1e3 * valve.wiring.acquisition.period_s:g} ms",
        "buses": ", ".join(sorted(valve.buses)),
        "history": [history_row(source.runs.as_it_stands(run), figures.get(run.id)) for run in past.newest[:_HISTORY]],
    }
    return pages.show("valve.html", visitor, values)


@router.get("/ui/tests/{test_id}")
async def test_page(
    pages: PagesOf, test_id: str, *, plant: Given[Plant], store: Given[Store], runs: Given[Runs], visitor: VisitorOf
) -> Response:
    """Show a test: live while it runs, then its result."""
    try:
        run = await runs.get(test_id)
    except NotFoundError as error:
        return _missing(pages, visitor, error)
    shared = {"tag": run.valve, "run": run, "state_words": STATES[run.state], **_standing_at(run)}
    if not run.state.finished:
        live = await asyncio.to_thread(_live, plant, store, run, pages.system)
        return pages.show("running.html", visitor, {**shared, "live": live})
    valve = plant.valves.get(run.valve)
    past = await asyncio.to_thread(past_of, store, run.valve, valve, run)
    compared = await asyncio.to_thread(_compared, plant, store, run, past, pages.system)
    return pages.show("result.html", visitor, {**shared, **_result(plant, store, run, past, pages.system), **compared})


@router.get("/ui/tests/{test_id}/compared")
async def compared_part(
    pages: PagesOf,
    test_id: str,
    *,
    plant: Given[Plant],
    store: Given[Store],
    runs: Given[Runs],
    visitor: VisitorOf,
    before: Annotated[str, Query(max_length=40)],
) -> Response:
    """Return the table of a test beside an earlier one, which the page puts into itself."""
    try:
        run = await runs.get(test_id)
        past = await asyncio.to_thread(past_of, store, run.valve, plant.valves.get(run.valve), run)
        compared = await asyncio.to_thread(_compared, plant, store, run, past, pages.system, before=before)
    except NotFoundError as error:
        return _missing(pages, visitor, error)
    return pages.show("compared.html", visitor, compared)


def _compared(
    plant: Plant, store: Store, run: Run, past: ValvePast, system: UnitSystem, *, before: str | None = None
) -> dict[str, Any]:
    """Return what a test is laid over and held against; reads the database and blocks. Raises NotFoundError."""
    valve, analysis = plant.valves.get(run.valve), run.analysis
    if analysis is None:
        return {"chips": [], "others": [], "repaired": [], "before_run": None, "compared": []}
    chips, others = overlays_of(store, run, past)
    chosen = before or before_of(store, run, past)
    then = None if chosen is None else store.runs.get(chosen)
    if then is not None and then.valve != run.valve:
        raise NotFoundError(f"test {then.id} is none of {run.valve}: choose one of the same valve")
    rows: list[BeforeAfter] = []
    if valve is not None and then is not None and then.analysis is not None:
        rows = before_after(then.analysis, analysis, valve.health, facts_of(valve), system)
    return {
        "chips": chips,
        "others": others,
        "repaired": repair_sentences(store, run, valve),
        "before_run": None
        if then is None
        else {"id": then.id, "words": words_of(then, plant.zone, "" if then.label else "test")},
        "compared": rows,
    }


def _missing(pages: Pages, visitor: Visitor, error: NotFoundError) -> Response:
    return pages.show("missing.html", visitor, {"reason": str(error)}, HTTPStatus.NOT_FOUND)


def _standing_at(run: Run | None) -> dict[str, Any]:
    """Return where a test left its valve, what is wrong with that, and what a page compares to see it change."""
    if run is None:
        return {"stands": "", "alarm": "", "verdict": ""}
    verdict = "" if run.stands is None else run.stands.verdict.value
    return {"stands": where_it_stands(run), "alarm": alarm_words(run), "verdict": verdict}


def _health(run: Run | None) -> dict[str, Any]:
    return {} if run is None or run.analysis is None else dict(run.analysis.get("health") or {})


def _standing(staleness: Staleness, latest: Run | None, tag: str) -> Mapping[str, Any]:
    """Return health as it stands today, of the last completed test and of days in service."""
    now = datetime.now(UTC)
    oldest = staleness.oldest(tag, now)
    if latest is None:
        return oldest.health(None, None, now) or {}
    return oldest.health(_health(latest), latest.created_at, now) or {}


def _trend_address(tag: str, past: ValvePast, system: UnitSystem, zone: ZoneInfo | None) -> str | None:
    """Return where the trend's picture is; None where neither a test nor a day in service has a figure for it."""
    has_days = any(day.figures for day in past.watched)
    if past.latest is None and not has_days:
        return None
    tests = f"units={system.value}" if past.latest is None else _query(past, past.latest, system, zone)
    days = f"&watched={past.watched[0].judged_at:%Y%m%dT%H%M%S%f}" if has_days else ""
    to = "" if past.latest is None else f"to={past.latest.id}&"
    return f"/ui/figures/valves/{quote(tag)}/trend.svg?{to}{tests}{days}"


def _query(past: ValvePast, run: Run, system: UnitSystem, zone: ZoneInfo | None) -> str:
    """Return what else a picture of a test depends on, so that its address changes with it."""
    analysed = "" if run.finished_at is None else f"&of={run.finished_at:%Y%m%dT%H%M%S%f}"
    label = "" if run.label is None else f"&as={run.label.value}"
    clock = "" if zone is None else f"&zone={quote(zone.key)}"
    return f"units={system.value}{clock}{analysed}{label}" + (
        "" if past.baseline is None else f"&baseline={past.baseline.id}"
    )


def _live(plant: Plant, store: Store, run: Run, system: UnitSystem) -> dict[str, Any]:
    """Return what the live trace needs besides the events: its scales, and the pressure as it is planned."""
    units = {
        name: {"name": unit.name, "in_si": unit.in_si}
        for name, unit in (
            ("length", shown_unit("m", system)),
            ("pressure", shown_unit("Pa", system)),
            ("force", shown_unit("N", system)),
        )
    }
    valve = plant.valves.get(run.valve)
    if valve is None:
        scales = {"plan": None, "travel_m": 0.1, "pressure_pa": [0.0, 1.0e5], "duration_s": 60.0}
        return {"units": units, "estimates": _NO_ESTIMATES, **scales}
    try:
        waveform = waveform_of(valve, run, store)
        plan, duration_s = planned_line(waveform), waveform.duration_s
    except ValveError:  # the trace does without
        plan, duration_s = None, valve.wiring.limits.longest_test_s
    return {
        "units": units,
        "estimates": _SOON if valve.wiring.acquisition.mode is Mode.POLLED else _NO_ESTIMATES,
        "plan": plan,
        "duration_s": duration_s,
        "travel_m": valve.nameplate.actuator.travel_m,
        "pressure_pa": list(valve.wiring.limits.pressure_pa),
    }


def _result(plant: Plant, store: Store, run: Run, past: ValvePast, system: UnitSystem) -> dict[str, Any]:
    analysis, health = run.analysis, _health(run)
    baseline = None if past.baseline is None or past.baseline.id == run.id else past.baseline.analysis
    shown: dict[str, Any] = {
        "analysis": analysis,
        "ended_early": early_words(run.until, run.ended_early) if run.state is RunState.COMPLETED else "",
        "ne107": alarm_condition(run) or NE107.get(health.get("ne107") or ""),
        "reasons": health.get("reasons") or (),
        "may_be_baseline": (health.get("acceptance") or {}).get("passed") is False
        and (past.baseline is None or past.baseline.id != run.id),
        "unacknowledged": run if needs_acknowledgement(run) else None,
        "recording_facts": recording_facts(run, system, plant.zone),
        "may_be_analysed": can_be_analysed(run),
        "figures": f"/ui/figures/tests/{run.id}",
        "figure_query": _query(past, run, system, plant.zone),
    }
    if analysis is None:
        later = past.newest[0] if past.newest and past.newest[0].id != run.id else None
        return shown | {
            "ending": ending_of(run, later=later, zone=plant.zone),
            "has_trace": run.recording_file is not None and store.recording_path(run.id).is_file(),
        }
    pictures = (analysis.get("discrepancy") or {}).get("pictures") or {}
    diagnosis = diagnosis_of(analysis)
    shown_rows, figures_missing = told_once(figure_rows(analysis, baseline))
    return shown | {
        "diagnosis": diagnosis,
        "separating_words": _separating_words(diagnosis.separating_test),
        "next_words": next_step(analysis, run.sequence),
        "has_pictures": bool(pictures.get("time")),
        "has_friction": bool((analysis.get("discrepancy") or {}).get("latent_friction")),
        "has_coordinates": bool(pictures.get("coordinates")) and diagnosis.verdict != "none",
        "has_comparison": can_compare(all_estimates(analysis)),
        "has_model": diagnosis.verdict != "ambiguous"
        and bool((analysis.get("discrepancy") or {}).get("extended_model")),
        "has_signature": has_signature(analysis.get("signature")),
        "reasons": reasons_beside(health.get("reasons") or (), diagnosis),
        "key_figures": key_figures(analysis, system, plant.zone),
        "figure_rows": shown_rows,
        "figures_missing": figures_missing,
        "parameter_rows": parameter_rows(analysis),
        "methods": method_names(analysis),
        "missing": missing_reasons(analysis),
        "messages": method_messages(analysis),
    }


def _separating_words(test: Any) -> str:
    if not test:
        return ""
    if isinstance(test, str):
        return test
    return str(test.get("sentence") or f"run the sequence {test.get('sequence', '')}")
