"""The pictures of the pages, drawn in another process."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Query, Request, Response

from service.config.settings import Plant
from service.figures.drawer import Drawer
from service.figures.friction import friction_svg
from service.figures.methods import all_estimates, methods_svg
from service.figures.misfit import coordinate_svg, time_svg
from service.figures.signature import NARROW, WIDE, Frame, Layer, has_signature, signature_svg
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
from service.tablet.rendering import PagesOf, units_of
from service.tablet.visitor import VisitorOf
from valve.errors import NotFoundError

router = APIRouter(prefix="/ui/figures", include_in_schema=False)

# An address names all that its picture depends on; SVG carries its own style, and nothing else may run or load.
_HEADERS: Final = {
    "Cache-Control": "private, max-age=3600",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'",
    "X-Content-Type-Options": "nosniff",
}
_NO_PICTURE: Final = "this test has no such picture: its page says what there is"


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
    run, system = await source.runs.get(test_id), units_of(request)
    own = await _measured_early(source, run)
    layers, frame = await asyncio.to_thread(_signature, source, run, tuple(others or ()), own)
    key = (
        run.id,
        run.finished_at,
        own is None,
        "signature",
        system,
        narrow,
        repr(frame),
        tuple(others or ()),
        *(one.words for one in layers),
    )
    return _svg(await source.drawer.svg(key, signature_svg, layers, frame, system, NARROW if narrow else WIDE))


@router.get("/tests/{test_id}/measured")
async def measured_part(pages: PagesOf, test_id: str, source: SourceOf, visitor: VisitorOf) -> Response:
    """Return the first figures of a test whose diagnosis is still under way, which its page puts into itself."""
    run, system = await source.runs.get(test_id), pages.system
    own = await _measured_early(source, run)
    if own is None:
        raise NotFoundError(f"test {run.id} is {run.state.value}: its page says what there is")
    valve = source.plant.valves.get(run.valve)
    past = await asyncio.to_thread(past_of, source.store, run.valve, valve, run)
    first = await asyncio.to_thread(before_of, source.store, run, past)
    address = f"/ui/figures/tests/{run.id}/signature.svg?units={system.value}&early=1"
    shown = {
        "early_figures": key_figures({"signature": own}, system),
        "early_address": "" if not has_signature(own) else address + ("" if first is None else f"&with={first}"),
        "early_missing": "" if has_signature(own) else str(next(iter((own.get("notes") or {}).values()), "")),
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
    run, system = await source.runs.get(test_id), units_of(request)
    if name == "trace":
        file = str(recording_of(run, source.plant, source.store))
        return _svg(await source.drawer.svg((run.id, name, system, run.recording_sha256), trace_svg, file, system))
    if name not in _OF_A_TEST:
        raise NotFoundError(f"test {run.id}: {_NO_PICTURE}")
    draw, data_of = _OF_A_TEST[name]
    return _svg(await source.drawer.svg((run.id, run.finished_at, name, system), draw, data_of(run), system))


@router.get("/valves/{tag:path}/trend.svg")
async def figure_of_trend(
    request: Request, tag: str, source: SourceOf, _visitor: VisitorOf, *, narrow: bool = False
) -> Response:
    """Draw the trends of a valve."""
    valve = source.runs.valve(tag)
    past, system = await asyncio.to_thread(past_of, source.store, tag, valve), units_of(request)
    zone = source.plant.zone
    key = (
        tag,
        system,
        narrow,
        str(zone),
        None if past.latest is None else (past.latest.id, past.latest.finished_at),
        None if past.baseline is None else past.baseline.id,
        past.watched[0].judged_at if past.watched else None,
    )
    return _svg(await source.drawer.svg(key, trends_svg, past.trends, system, zone, narrow))


def _svg(text: str | None) -> Response:
    if text is None:
        raise NotFoundError(_NO_PICTURE)
    return Response(text, HTTPStatus.OK, dict(_HEADERS), media_type="image/svg+xml")
