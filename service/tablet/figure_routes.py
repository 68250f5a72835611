"""The pictures of the pages, drawn in another process."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Request, Response

from service.figures.friction import friction_svg
from service.figures.loop import loop_svg
from service.figures.methods import all_estimates, methods_svg
from service.figures.misfit import coordinate_svg, time_svg
from service.figures.trace import trace_svg
from service.figures.trend import trends_svg
from service.parts import Parts, parts_of
from service.recordings.place import recording_of
from service.runs.run import Run
from service.tablet.history import past_of
from service.tablet.rendering import units_of
from service.tablet.routes import VisitorOf
from valve.errors import NotFoundError

router = APIRouter(prefix="/ui/figures", include_in_schema=False)
PartsOf = Annotated[Parts, Depends(parts_of)]

# An address names all that its picture depends on; SVG carries its own style, and nothing else may run or load.
_HEADERS: Final = {
    "Cache-Control": "private, max-age=3600",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'",
    "X-Content-Type-Options": "nosniff",
}
_NO_PICTURE: Final = "this test has no such picture: its page says what there is"


def _signature(run: Run | None) -> Any:
    return None if run is None else (run.analysis or {}).get("signature")


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


@router.get("/tests/{test_id}/{name}.svg")
async def figure_of_test(
    request: Request, test_id: str, name: str, parts: PartsOf, _visitor: VisitorOf, baseline: str | None = None
) -> Response:
    """Draw one picture of a test: loop, methods, time, coordinate, friction, trace."""
    run, system = await parts.runs.get(test_id), units_of(request)
    if name == "trace":
        file = str(recording_of(run, parts.plant, parts.store))
        return _svg(await parts.drawer.svg((run.id, name, system, run.recording_sha256), trace_svg, file, system))
    if name == "loop":
        behind = None if baseline in (None, run.id) else await parts.runs.get(str(baseline))
        key = (run.id, run.finished_at, name, system, baseline)
        return _svg(await parts.drawer.svg(key, loop_svg, _signature(run), _signature(behind), system))
    if name not in _OF_A_TEST:
        raise NotFoundError(f"test {run.id}: {_NO_PICTURE}")
    draw, data_of = _OF_A_TEST[name]
    return _svg(await parts.drawer.svg((run.id, run.finished_at, name, system), draw, data_of(run), system))


@router.get("/valves/{tag:path}/trend.svg")
async def figure_of_trend(request: Request, tag: str, parts: PartsOf, _visitor: VisitorOf) -> Response:
    """Draw the trends of a valve."""
    valve = parts.runs.valve(tag)
    past, system = await asyncio.to_thread(past_of, parts.store, tag, valve), units_of(request)
    key = (
        tag,
        system,
        None if past.latest is None else (past.latest.id, past.latest.finished_at),
        None if past.baseline is None else past.baseline.id,
    )
    return _svg(await parts.drawer.svg(key, trends_svg, past.trends, system))


def _svg(text: str | None) -> Response:
    if text is None:
        raise NotFoundError(_NO_PICTURE)
    return Response(text, HTTPStatus.OK, dict(_HEADERS), media_type="image/svg+xml")
