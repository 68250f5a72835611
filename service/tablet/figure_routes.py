"""The pictures of the pages, drawn in another process."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Query, Request, Response

from service.config.plant import Plant
from service.figures.drawer import Drawer
from service.figures.friction import friction_svg
from service.figures.methods import all_estimates, methods_svg
from service.figures.misfit import coordinate_svg, time_svg
from service.figures.signature import NARROW, WIDE, Frame, Layer, has_signature, signature_svg, why_no_signature
from service.figures.trace import trace_svg
from service.figures.trend import trends_svg
from service.http.given import Given
from service.model.run import Run, RunState
from service.recordings.place import recording_of
from service.report.summary import key_figures
from service.report.valve_facts import frame_of
from service.runs.service import Runs
from service.shown.history import past_of
from service.shown.overlays import before_of, layers_of, measured_signature
from service.store.store import Store
from service.tablet.figure_addresses import read_as
from service.tablet.rendering import PagesOf, reader_of
from service.tablet.visitor import VisitorOf
from valve.errors import NotFoundError
from valve.messages import say

router = APIRouter(prefix="/ui/figures", include_in_schema=False)

# An address names all that its picture depends on; SVG carries its own style, and nothing else may run or load.
_HEADERS: Final = {
    "Cache-Control": "private, max-age=3600",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'",
    "X-Content-Type-Options": "nosniff",
}
_NO_PICTURE: Final = say("no_such_picture", "this test has no such picture: its page says what there is")


@dataclass(frozen=True, slots=True)
class _Source:
    """What pictures are drawn of, and who draws them."""

    plant: Plant
    store: Store
    runs: Runs
    drawer: Drawer


async def _source(plant: Given[Plant], store: Given[Store], runs: Given[Runs], drawer: Given[Drawer]) -> _Source:
    return _Source(plant, store, runs, drawer)


SourceOf = Annotated[_Source, Depends(_source)]


def _pictures(run: Run) -> Any:
    return ((run.analysis or {}).get("discrepancy") or {}).get("pictures")


def _latent_friction(run: Run) -> Any:
    return ((run.analysis or {}).get("discrepancy") or {}).get("latent_friction")


_OF_A_TEST: Final[dict[str, tuple[Callable[..., str | None], Callable[[Run], Any]]]] = {
    "methods": (methods_svg, lambda run: all_estimates(run.analysis or {})),
    "time": (time_svg, _pictures),
    "coordinate": (coordinate_svg, _pictures),
    "friction": (friction_svg, _latent_friction),
}


@router.get("/tests/{test_id}/signature.svg")
async def figure_of_signature(
    request: Request,
    test_id: str,
    source: SourceOf,
    _visitor: VisitorOf,
    others: Annotated[list[str] | None, Query(alias="with", max_length=8)] = None,
    *,
    narrow: bool = False,
) -> Response:
    """Draw the signature of a test, with others of its valve laid over it."""
    run, reader = await source.runs.get(test_id), reader_of(request, source.plant.zone)
    own = await _measured_early(source, run)
    layers, frame = await asyncio.to_thread(_signature, source, run, tuple(others or ()), own)
    key = (
        run.id,
        run.finished_at,
        own is None,
        "signature",
        reader,
        narrow,
        repr(frame),
        tuple(others or ()),
        *(one.words for one in layers),
    )
    return _svg(await source.drawer.svg(key, signature_svg, layers, frame, reader, NARROW if narrow else WIDE))


@router.get("/tests/{test_id}/measured")
async def measured_part(pages: PagesOf, test_id: str, source: SourceOf, visitor: VisitorOf) -> Response:
    """Return the first figures of a test whose diagnosis is still under way, which its page puts into itself."""
    run, reader = await source.runs.get(test_id), pages.reader
    own = await _measured_early(source, run)
    if own is None:
        raise NotFoundError(
            say(
                "no_measured_part",
                "test {test} is {state}: its page says what there is",
                test=run.id,
                state=run.state.value,
            )
        )
    valve = source.plant.valves.get(run.valve)
    past = await asyncio.to_thread(past_of, source.store, run.valve, valve, run)
    first = await asyncio.to_thread(before_of, source.store, run, past)
    address = f"/ui/figures/tests/{run.id}/signature.svg?{read_as(reader)}&early=1"
    shown = {
        "early_figures": key_figures({"signature": own}, reader),
        "early_address": "" if not has_signature(own) else address + ("" if first is None else f"&with={first}"),
        "early_missing": why_no_signature(own),
    }
    return pages.show("measured.html", visitor, shown)


async def _measured_early(source: _Source, run: Run) -> dict[str, Any] | None:
    """Return the signature of a test whose motion has ended and whose analysis is under way; None for all others.

    It is measured once, in the process that draws. Raises what reading the recording raises.
    """
    valve = source.plant.valves.get(run.valve)
    if run.state is not RunState.ANALYZING or run.analysis is not None or run.recording_file is None or valve is None:
        return None
    file = str(recording_of(run, source.plant, source.store))
    plate = json.dumps(asdict(valve.nameplate))
    found = await source.drawer.svg((run.id, "measured", run.recording_sha256), measured_signature, file, plate)
    return None if found is None else dict(json.loads(found))


def _signature(
    source: _Source, run: Run, others: tuple[str, ...], own: dict[str, Any] | None
) -> tuple[list[Layer], Frame]:
    valve = source.plant.valves.get(run.valve)
    baseline = past_of(source.store, run.valve, valve, run).held_against
    return layers_of(source.store, run, others, source.plant.zone, own), frame_of(
        valve, None if baseline is None else baseline.test
    )


@router.get("/tests/{test_id}/{name}.svg")
async def figure_of_test(request: Request, test_id: str, name: str, source: SourceOf, _visitor: VisitorOf) -> Response:
    """Draw one picture of a test: methods, time, coordinate, friction, trace."""
    run, reader = await source.runs.get(test_id), reader_of(request, source.plant.zone)
    if name == "trace":
        file = str(recording_of(run, source.plant, source.store))
        return _svg(await source.drawer.svg((run.id, name, reader, run.recording_sha256), trace_svg, file, reader))
    if name not in _OF_A_TEST:
        raise NotFoundError(say("test_has_no_picture", "test {test}: {why}", test=run.id, why=_NO_PICTURE))
    draw, data_of = _OF_A_TEST[name]
    return _svg(await source.drawer.svg((run.id, run.finished_at, name, reader), draw, data_of(run), reader))


@router.get("/valves/{tag:path}/trend.svg")
async def figure_of_trend(
    request: Request, tag: str, source: SourceOf, _visitor: VisitorOf, *, narrow: bool = False
) -> Response:
    """Draw the trends of a valve."""
    valve = source.runs.valve(tag)
    past = await asyncio.to_thread(past_of, source.store, tag, valve)
    reader = reader_of(request, source.plant.zone)
    key = (
        tag,
        reader,
        narrow,
        None if past.latest is None else (past.latest.id, past.latest.finished_at),
        None if past.baseline is None else past.baseline.id,
        past.watched[0].judged_at if past.watched else None,
    )
    return _svg(await source.drawer.svg(key, trends_svg, past.trends, reader, narrow))


def _svg(text: str | None) -> Response:
    if text is None:
        raise NotFoundError(_NO_PICTURE)
    return Response(text, HTTPStatus.OK, dict(_HEADERS), media_type="image/svg+xml")
