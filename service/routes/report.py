"""``/tests/{id}/report``: the report of a test that has ended."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import Annotated, Final, Literal

from fastapi import APIRouter, Depends, Query, Request, Response
from starlette.exceptions import HTTPException

from service.access.needs import needs
from service.access.principal import Right
from service.config.plant import Plant
from service.figures.drawer import Drawer
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.run import Run
from service.report.ended import EndedSource
from service.report.of_run import ended_source_of, source_of
from service.report.source import ReportSource
from service.report.written import report_html, report_pdf
from service.routes.recording_formats import qualities
from service.runs.service import Runs
from service.store.store import Store
from service.tablet.rendering import reader_of
from service.words.languages import Language
from service.words.reader import Reader
from service.words.units import UnitSystem
from valve.errors import NotFoundError
from valve.messages import say

router = APIRouter(prefix="/tests", tags=["tests"], responses=PROBLEMS)

_PDF: Final = "application/pdf"
_HTML: Final = "text/html"
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
    "Vary": "Accept, Accept-Language, Cookie",
}


@dataclass(frozen=True, slots=True)
class _Source:
    """What a report is written from."""

    plant: Plant
    store: Store

    def of(self, run: Run, reader: Reader) -> ReportSource | EndedSource:
        """Return what the report of a test says; reads the database and blocks."""
        if run.analysis is None:
            return ended_source_of(self.plant, self.store, run, reader)
        return source_of(self.plant, self.store, run, reader)


async def _source(plant: Given[Plant], store: Given[Store]) -> _Source:
    return _Source(plant, store)


@router.get(
    "/{test_id}/report",
    response_class=Response,
    dependencies=[needs(Right.VIEW)],
    responses={200: {"content": {_PDF: {}, _HTML: {}}, "description": "The report, as Accept or format asks"}},
)
async def get_report(
    request: Request,
    test_id: str,
    runs: Given[Runs],
    source: Annotated[_Source, Depends(_source)],
    drawer: Given[Drawer],
    *,
    wanted: Annotated[Literal["pdf", "html"] | None, Query(alias="format", description="stands above Accept")] = None,
    units: Annotated[UnitSystem | None, Query(description="what it is read in; SI by default")] = None,
    language: Annotated[
        Language | None, Query(description="what it is read in; what `Accept-Language` likes best by default")
    ] = None,
) -> Response:
    """Return the report of a test that has ended, with a result or without: PDF, or HTML where `Accept` prefers it."""
    kind = wanted or _preferred(request.headers.get("accept", "*/*"))
    run = await runs.get(test_id)
    if not run.state.finished:
        raise NotFoundError(
            say(
                "no_report_yet",
                "test {test} has no report yet (it is {state}): ask again when it has ended",
                test=run.id,
                state=run.state.value,
            )
        )
    kept = reader_of(request, source.plant.zone)
    reader = replace(kept, system=units or kept.system, language=language or kept.language)
    found = await asyncio.to_thread(source.of, run, reader)
    if kind == "html":
        address = f"/tests/{run.id}/report?format=pdf&units={reader.system.value}&language={reader.language.value}"
        return Response(await drawer.document(report_html, found, address), headers=_HEADERS, media_type=_HTML)
    data = await drawer.document(report_pdf, found)
    disposition = {"Content-Disposition": f'inline; filename="{run.file_stem}.pdf"'}
    return Response(data, headers=_HEADERS | disposition, media_type=_PDF)


def _preferred(accept: str) -> Literal["pdf", "html"]:
    wishes = qualities(accept)
    pdf = next((wishes[name] for name in (_PDF, "application/*", "*/*") if name in wishes), 0.0)
    html = next((wishes[name] for name in (_HTML, "text/*", "*/*") if name in wishes), 0.0)
    if max(pdf, html) == 0.0:
        raise HTTPException(
            HTTPStatus.NOT_ACCEPTABLE,
            say("formats_of_report", "a report comes as {pdf} or {html}: accept one of them", pdf=_PDF, html=_HTML),
        )
    return "html" if html > pdf else "pdf"
