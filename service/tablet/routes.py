"""The tablet's pages."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from datetime import UTC, datetime
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query, Response
from fastapi.responses import RedirectResponse

from drivers.addresses import Mode
from service.config.plant import Plant
from service.figures.methods import all_estimates, can_compare
from service.figures.signature import has_signature
from service.health.changes import facts_of
from service.health.earlier import EarlierResults
from service.http.given import Given
from service.model.acknowledgement import needs_acknowledgement
from service.model.analysis import can_be_analysed
from service.model.run import Run, RunState
from service.model.until import early_words
from service.report.before_after import BeforeAfter, before_after
from service.report.of_run import repair_sentences
from service.report.summary import key_figures
from service.runs.service import Runs
from service.schedules.views import due_checks
from service.shown.ending import ending_of, standing_at
from service.shown.history import ValvePast, past_of
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
from service.shown.words import NE107, STATES, alarm_condition
from service.store.store import Store
from service.tablet.figure_addresses import figure_query
from service.tablet.night import NightWish, night_of
from service.tablet.plans import planned_line, waveform_of
from service.tablet.rendering import PagesOf
from service.tablet.since import since_yesterday
from service.tablet.valve_list import ValveList, Wish
from service.tablet.valve_rows import valve_rows
from service.tablet.valve_stands import ValveSource, ValveSourceOf, valve_stands
from service.tablet.visitor import VisitorOf
from service.words.names import named
from service.words.reader import Reader
from valve.errors import NotFoundError, ValveError
from valve.messages import say

router = APIRouter(include_in_schema=False)

_SOON: Final = say("first_estimate_soon", "The first estimate comes at the first turning point.")
_NO_ESTIMATES: Final = say(
    "no_estimates_yet", "The device samples by itself: the estimates come when its samples are fetched."
)


@router.get("/")
async def valves_page(
    pages: PagesOf,
    source: ValveSourceOf,
    earlier: Given[EarlierResults],
    visitor: VisitorOf,
    wish: Annotated[Wish, Query()],
) -> Response:
    """Show the valves, worst first, and what changed since yesterday."""
    values = await asyncio.to_thread(_valves_shown, source, earlier, wish, due_checks(source.plant, datetime.now(UTC)))
    return pages.show("valves.html", visitor, values)


@router.get("/ui")
@router.get("/ui/")
async def entrance() -> Response:
    """Lead to the list of the valves, as an address that is cut short means it."""
    return RedirectResponse("/", HTTPStatus.SEE_OTHER)


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


@router.get("/ui/tests/{test_id}")
async def test_page(
    pages: PagesOf, test_id: str, *, plant: Given[Plant], store: Given[Store], runs: Given[Runs], visitor: VisitorOf
) -> Response:
    """Show a test: live while it runs, then its result."""
    try:
        run = await runs.get(test_id)
    except NotFoundError as error:
        return pages.missing(visitor, error)
    shared = {"tag": run.valve, "run": run, "state_words": STATES[run.state], **standing_at(run)}
    if not run.state.finished:
        live = await asyncio.to_thread(_live, plant, store, run, pages.reader)
        return pages.show("running.html", visitor, {**shared, "live": live})
    valve = plant.valves.get(run.valve)
    past = await asyncio.to_thread(past_of, store, run.valve, valve, run)
    compared = await asyncio.to_thread(_compared, plant, store, run, past, pages.reader)
    return pages.show("result.html", visitor, {**shared, **_result(plant, store, run, past, pages.reader), **compared})


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
        compared = await asyncio.to_thread(_compared, plant, store, run, past, pages.reader, before=before)
    except NotFoundError as error:
        return pages.missing(visitor, error)
    return pages.show("compared.html", visitor, compared)


def _compared(
    plant: Plant, store: Store, run: Run, past: ValvePast, reader: Reader, *, before: str | None = None
) -> dict[str, Any]:
    """Return what a test is laid over and held against; reads the database and blocks. Raises NotFoundError."""
    valve, analysis = plant.valves.get(run.valve), run.analysis
    if analysis is None:
        return {"chips": [], "others": [], "repaired": [], "before_run": None, "compared": []}
    chips, others = overlays_of(store, run, past)
    chosen = before or before_of(store, run, past)
    then = None if chosen is None else store.runs.get(chosen)
    if then is not None and then.valve != run.valve:
        raise NotFoundError(
            say(
                "test_is_none_of_valve",
                "test {test} is none of {valve}: choose one of the same valve",
                test=then.id,
                valve=run.valve,
            )
        )
    rows: list[BeforeAfter] = []
    if valve is not None and then is not None and then.analysis is not None:
        rows = before_after(then.analysis, analysis, valve.health, facts_of(valve), reader)
    return {
        "chips": chips,
        "others": others,
        "repaired": repair_sentences(store, run, valve),
        "before_run": None
        if then is None
        else {"id": then.id, "words": words_of(then, plant.zone, "" if then.label else named("test"))},
        "compared": rows,
    }


def _health(run: Run | None) -> dict[str, Any]:
    return {} if run is None or run.analysis is None else dict(run.analysis.get("health") or {})


def _live(plant: Plant, store: Store, run: Run, reader: Reader) -> dict[str, Any]:
    """Return what the live trace needs besides the events: its scales, and the pressure as it is planned."""
    units = {
        name: {"name": unit.name, "in_si": unit.in_si}
        for name, unit in (
            ("length", reader.unit("m")),
            ("pressure", reader.unit("Pa")),
            ("force", reader.unit("N")),
        )
    }
    valve = plant.valves.get(run.valve)
    if valve is None:
        scales = {"plan": None, "travel_m": 0.1, "pressure_pa": [0.0, 1.0e5], "duration_s": 60.0}
        return {"units": units, "estimates": reader.told(_NO_ESTIMATES), **scales}
    try:
        waveform = waveform_of(valve, run, store)
        plan, duration_s = planned_line(waveform), waveform.duration_s
    except ValveError:  # the trace does without
        plan, duration_s = None, valve.wiring.limits.longest_test_s
    return {
        "units": units,
        "estimates": reader.told(_SOON if valve.wiring.acquisition.mode is Mode.POLLED else _NO_ESTIMATES),
        "plan": plan,
        "duration_s": duration_s,
        "travel_m": valve.nameplate.actuator.travel_m,
        "pressure_pa": list(valve.wiring.limits.pressure_pa),
    }


def _result(plant: Plant, store: Store, run: Run, past: ValvePast, reader: Reader) -> dict[str, Any]:
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
        "recording_facts": recording_facts(run, plant.zone),
        "may_be_analysed": can_be_analysed(run),
        "figures": f"/ui/figures/tests/{run.id}",
        "figure_query": figure_query(past, run, reader),
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
        "key_figures": key_figures(analysis, reader),
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
    sentence: str = test.get("sentence") or say(
        "run_sequence", "run the sequence {name}", name=named(test.get("sequence", ""))
    )
    return sentence
