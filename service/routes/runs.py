"""``/tests``: run, list, watch, stop, and the raw recording."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Annotated, Final

from fastapi import APIRouter, Depends, Header, Query, Request, Response
from fastapi.responses import FileResponse, JSONResponse, StreamingResponse

from service.access.motion import require_may_run
from service.access.needs import Asks, needs, require_covers
from service.access.principal import Right
from service.config.plant import Plant
from service.health.results import Ne107
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.health_figures import MAIN_FIGURES, Figure
from service.model.past_test import PastTest
from service.model.run import Label, Run, RunState, file_words
from service.recordings.conversion import Converter
from service.recordings.place import recording_of
from service.routes.json_body import JsonRoute
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
from service.routes.recording_formats import CSV, PARQUET, acceptable
from service.routes.run_views import ReaderOf, RunDescription, RunPage, RunRequest, RunView, summary, view
from service.runs.events import Event
from service.runs.service import Runs
from service.store.run_filter import RunFilter
from service.store.store import Store

router = APIRouter(prefix="/tests", tags=["tests"], responses=PROBLEMS, route_class=JsonRoute)

_WAIT: Final = re.compile(r"(?:^|[,;\s])wait\s*=\s*\"?(\d{1,6})")
_LONGEST_WAIT_S: Final = 900
_COLUMNS: Final = (
    *("id", "valve", "sequence", "label", "state", "created_at", "finished_at", "ne107"),
    *MAIN_FIGURES,
    *("safe_confirmed", "error"),
)


def _wait_s(request: Request) -> int | None:
    """Seconds that the client is ready to wait (RFC 7240, 4.3); None where it does not say."""
    found = _WAIT.search(",".join(request.headers.getlist("prefer")))
    return None if found is None else min(int(found.group(1)), _LONGEST_WAIT_S)


@router.post(
    "/run",
    status_code=HTTPStatus.ACCEPTED,
    response_model=RunView,
    dependencies=[needs(Right.RUN)],
    responses={200: {"model": RunView, "description": "Done within the time that Prefer: wait=SECONDS gave"}},
)
async def run_test(
    request: Request,
    wanted: RunRequest,
    plant: Given[Plant],
    runs: Given[Runs],
    asks: Asks,
    *,
    idempotency_key: Annotated[
        str | None,
        Header(min_length=1, max_length=255, description="the same key with the same body gives the same test"),
    ] = None,
) -> Response:
    """Start a test of one valve: 202 at once, or with `Prefer: wait=SECONDS` 200 if it is done by then."""
    require_may_run(asks, plant, wanted.valve, wanted.sequence, wanted.overrides)
    run = await runs.start(
        wanted.valve,
        wanted.sequence,
        wanted.overrides,
        idempotency_key,
        requester=asks.requester,
        label=wanted.label,
        permit=wanted.permit,
        until=wanted.until,
    )
    headers = {"Location": f"/tests/{run.id}"}
    status = HTTPStatus.ACCEPTED
    wait_s = _wait_s(request)
    if wait_s is not None:
        run = await runs.wait(run.id, wait_s)
        headers["Preference-Applied"] = f"wait={wait_s}"
        status = HTTPStatus.OK if run.state.finished else HTTPStatus.ACCEPTED
    return JSONResponse(view(run).model_dump(mode="json"), status_code=status, headers=headers)


@dataclass(frozen=True, slots=True)
class _ListSource:
    """What the list of tests is read from."""

    plant: Plant
    store: Store
    runs: Runs


async def _list_source(plant: Given[Plant], store: Given[Store], runs: Given[Runs]) -> _ListSource:
    return _ListSource(plant, store, runs)


@router.get("", dependencies=[needs(Right.VIEW), KNOWN_KEYS], response_model=RunPage, responses=OR_CSV)
async def list_tests(  # noqa: PLR0917 - each is a query key
    request: Request,
    source: Annotated[_ListSource, Depends(_list_source)],
    limit: Annotated[int, Query(ge=1, le=1000)] = 50,
    before: Annotated[str | None, Query(max_length=40, description="an id: list what is older")] = None,
    valve: Annotated[
        str | None, Query(max_length=64, pattern=r"^[^\x00]*$", description="a tag: list its tests alone")
    ] = None,
    area: Areas = None,
    state: Annotated[list[RunState] | None, Query(description="one of these states")] = None,
    ne107: Annotated[list[Ne107] | None, Query(description="one of these NE 107 states, as the test found it")] = None,
    label: Annotated[list[Label] | None, Query(description="one of these labels")] = None,
    since: Since = None,
    until: Until = None,
    form: Form = None,
) -> Response:
    """List tests, newest first, without their analysis; as CSV with their main figures, SI."""
    tags = tags_of_areas(source.plant, area) if area else None
    wanted = RunFilter(valve, tuple(state or ()), tuple(ne107 or ()), tuple(label or ()), since, until, tags)
    runs = await source.runs.newest(limit + 1, wanted, before=before)
    page, following = runs[:limit], None
    if len(runs) > limit:
        filters = {"valve": valve, "area": area, "state": state, "ne107": ne107, "label": label}
        asked = {"limit": limit, "before": page[-1].id, **filters, "since": since, "until": until, "format": form}
        following = next_page("/tests", asked)
    if not wants_csv(request, form):
        shown = await asyncio.to_thread(_page, page, following)
        return Response(shown, media_type="application/json", headers={"Vary": "Accept"})
    found = await asyncio.to_thread(source.store.figures.of_tests, [run.number for run in page])
    name = dated("tests" if valve is None else f"{file_words(valve)}_tests")
    return csv_answer(_COLUMNS, (_line(run, found.get(run.number)) for run in page), name, following)


def _page(runs: Sequence[Run], following: str | None) -> str:
    return RunPage(tests=[summary(run) for run in runs], next=following).model_dump_json()


def _line(run: Run, found: PastTest | None) -> list[object]:
    figures: Mapping[str, Figure] = {} if found is None else found.figures
    about = (run.id, run.valve, run.sequence, run.label, run.state.value, run.created_at, run.finished_at)
    measured = (figures[key].value if key in figures else None for key in MAIN_FIGURES)
    return [*about, None if found is None else found.ne107, *measured, run.safe_confirmed, run.error]


@router.get("/{test_id}", dependencies=[needs(Right.VIEW)])
async def get_test(test_id: str, runs: Given[Runs]) -> RunView:
    """Return one test."""
    return view(await runs.get(test_id))


@router.patch("/{test_id}", dependencies=[needs(Right.ACKNOWLEDGE)])
async def describe_test(test_id: str, said: RunDescription, runs: Given[Runs], asks: Asks) -> RunView:
    """Correct the label of a test, or say its work order and a note; recording and result stay as they are.

    What it was before stands in the audit log. A baseline stays, whatever the label says now.
    """
    require_covers(asks, (await runs.get(test_id)).valve)
    return view(await runs.describe(test_id, asks.requester, said.model_dump(exclude_unset=True)))


@router.post("/{test_id}/stop", dependencies=[needs(Right.STOP)])
async def stop_test(test_id: str, runs: Given[Runs], asks: Asks, reader: ReaderOf) -> RunView:
    """Send the valve to its safe value at once; a test that has ended stays as it is."""
    return view(await runs.stop(test_id, asks.requester), reader)


@router.post("/{test_id}/analyze", status_code=HTTPStatus.ACCEPTED, dependencies=[needs(Right.ANALYZE)])
async def analyze_test(test_id: str, runs: Given[Runs], asks: Asks, response: Response) -> RunView:
    """Analyse the stored recording of a test anew; nothing moves. 202 at once: watch the test for the result.

    For a test whose motion ended well, with or without a result; a result stands until the new one is there, and if
    that fails. 409 while the test is under way, 421 where another gateway has the recording.
    """
    require_covers(asks, (await runs.get(test_id)).valve)
    run = await runs.analyze(test_id, asks.requester)
    response.headers["Location"] = f"/tests/{run.id}"
    return view(run)


@router.get(
    "/{test_id}/events",
    response_class=StreamingResponse,
    dependencies=[needs(Right.VIEW)],
    responses={200: {"content": {"text/event-stream": {}}}},
)
async def watch_test(
    test_id: str, runs: Given[Runs], last_event_id: Annotated[str | None, Header(max_length=40)] = None
) -> StreamingResponse:
    """Stream what happens as server-sent events (state, progress, samples, estimate, notice, end), until the test ends.

    `estimate`: k, F_c, F_s and F_0 by the rows so far, each with `value` and `ci95`, or null; of polled tests, at each
    turning point and at least every 5 s. `notice`: a `sentence` and its `kind`: `breakaway` (a force twice the last
    breakaway's), `enough` (the test ends early) or `out_of_family` (such a breakaway ends it).
    """
    after = int(last_event_id) if last_event_id is not None and last_event_id.isdecimal() else 0
    events = await runs.follow(test_id, after)
    return StreamingResponse(
        _as_stream(events),
        media_type="text/event-stream",
        headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"},
    )


async def _as_stream(events: AsyncIterator[tuple[Event, ...]]) -> AsyncIterator[bytes]:
    async for fresh in events:
        yield b"".join(event.wire for event in fresh) or b": waiting\n\n"


@router.get(
    "/{test_id}/recording",
    response_class=FileResponse,
    dependencies=[needs(Right.VIEW)],
    responses={200: {"content": {CSV: {}, PARQUET: {}}, "description": "The raw recording, as Accept asks"}},
)
async def get_recording(
    request: Request,
    test_id: str,
    *,
    plant: Given[Plant],
    store: Given[Store],
    runs: Given[Runs],
    converter: Given[Converter],
) -> Response:
    """Return the raw recording: CSV, or Parquet where `Accept` asks for it; 421 where another gateway made it."""
    media_type = acceptable(request.headers.get("accept", "*/*"))
    run = await runs.get(test_id)
    path = recording_of(run, plant, store)
    if media_type == PARQUET:
        headers = {"ETag": f'"{run.recording_sha256}"', "Vary": "Accept"}
        return FileResponse(path, media_type=PARQUET, filename=f"{run.file_stem}.parquet", headers=headers)
    data = await converter.csv(path)
    disposition = f'attachment; filename="{run.file_stem}.csv"'
    return Response(data, media_type=CSV, headers={"Content-Disposition": disposition, "Vary": "Accept"})
