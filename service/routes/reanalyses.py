"""``/reanalyses``: stored tests of a time analysed anew with the installed version."""

from __future__ import annotations

from datetime import datetime
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Response
from fastapi.responses import JSONResponse
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from service.access.needs import Asks, needs, require_covers
from service.access.principal import Principal, Right
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.reanalysis import ReanalysisProgress, ReanalysisState, RepeatState, Wanted
from service.model.refusals import ForbiddenError
from service.routes.json_body import JsonRoute
from service.routes.lists import KNOWN_KEYS, in_utc
from service.runs.reanalyses import Reanalyses
from valve.messages import say

router = APIRouter(prefix="/reanalyses", tags=["re-analyses"], responses=PROBLEMS, route_class=JsonRoute)
Number = Annotated[int, Path(ge=1, lt=2**31)]
_Instant = Annotated[datetime, Field(strict=False), AfterValidator(in_utc)]
_LISTED = 20


class ReanalysisRequest(BaseModel):
    """Which tests are meant, by when they were asked for."""

    model_config = ConfigDict(extra="forbid", strict=True)
    since: _Instant = Field(
        description="asked for at this instant or later (ISO 8601; UTC where it names no zone)", examples=["2026-11-01"]
    )
    until: _Instant | None = Field(default=None, description="asked for before this instant")
    valve: str | None = Field(default=None, min_length=1, max_length=64, description="a tag: its tests alone")
    older_only: bool = Field(default=False, description="only what an earlier engine analysed")
    dry_run: bool = Field(default=False, description="count, and change nothing")


class Trouble(BaseModel):
    """One test that came to nothing; its former result stands."""

    test: str
    valve: str
    state: RepeatState
    reason: str


class ReanalysisView(BaseModel):
    """How far a re-analysis is."""

    number: int
    state: ReanalysisState
    since: datetime
    until: datetime | None
    valve: str | None
    older_only: bool
    gateway: str
    software: str
    requested_by: str
    asked_at: datetime
    ended_at: datetime | None
    stopped_by: str | None
    total: int
    done: int = Field(description="tests that have ended, well or not")
    tests: dict[str, int] = Field(description="how many stand where: queued, running, completed, skipped, failed, ...")
    troubles: list[Trouble] = Field(description="the first of those that were skipped or failed, with the reason")
    elsewhere: dict[str, int] = Field(description="tests meant whose recordings other gateways have: ask them")
    href: str


class ReanalysisPlan(BaseModel):
    """What a request would find; nothing was changed."""

    tests: int = Field(description="would be analysed here")
    elsewhere: dict[str, int] = Field(description="have their recordings at other gateways: ask them")
    without_recording: int = Field(description="their recordings were removed")
    queued_already: int = Field(description="another re-analysis has them")


class ReanalysisList(BaseModel):
    """The newest re-analyses, newest first."""

    reanalyses: list[ReanalysisView]


def _view(found: ReanalysisProgress, elsewhere: dict[str, int] | None = None) -> ReanalysisView:
    about, wanted = found.reanalysis, found.reanalysis.wanted
    return ReanalysisView(
        number=about.id,
        state=found.state,
        since=wanted.since,
        until=wanted.until,
        valve=wanted.valve,
        older_only=wanted.older_only,
        gateway=about.gateway,
        software=about.software,
        requested_by=about.requested_by,
        asked_at=about.asked_at,
        ended_at=about.ended_at,
        stopped_by=about.stopped_by,
        total=found.total,
        done=found.done,
        tests={state.value: found.counts.get(state, 0) for state in RepeatState},
        troubles=[
            Trouble(test=one.test_id, valve=one.valve, state=one.state, reason=one.reason) for one in found.troubles
        ],
        elsewhere=elsewhere or {},
        href=f"/reanalyses/{about.id}",
    )


def _require_covers(asks: Principal, valve: str | None) -> None:
    if valve is not None:
        require_covers(asks, valve)
    elif asks.valves is not None:
        raise ForbiddenError(
            say(
                "token_for_some_valves",
                "the token of {name} is for some valves: name one of them as valve",
                name=asks.name,
            )
        )


@router.post(
    "",
    status_code=HTTPStatus.ACCEPTED,
    response_model=ReanalysisView,
    dependencies=[needs(Right.ANALYZE)],
    responses={200: {"model": ReanalysisPlan, "description": "With dry_run: what there would be to do"}},
)
async def reanalyze(asked: ReanalysisRequest, reanalyses: Given[Reanalyses], asks: Asks) -> Response:
    """Analyse stored tests anew, one after the other, behind all else; nothing moves. 202 at once.

    Asked again in the same words while it goes on, it is the same. A result stands until the new one is there, and if
    that fails. It goes on after a restart of the service. 404 where no test is meant, 409 where all are queued already.
    """
    _require_covers(asks, asked.valve)
    wanted = Wanted(asked.since, asked.until, asked.valve, asked.older_only)
    found = await reanalyses.find(wanted)
    if asked.dry_run:
        plan = ReanalysisPlan(
            tests=found.here,
            elsewhere=dict(found.elsewhere),
            without_recording=found.without_recording,
            queued_already=found.queued_already,
        )
        return JSONResponse(plan.model_dump(mode="json"))
    view = _view(await reanalyses.ask(wanted, asks.requester), dict(found.elsewhere))
    headers = {"Location": view.href}
    return JSONResponse(view.model_dump(mode="json"), status_code=HTTPStatus.ACCEPTED, headers=headers)


@router.get("", dependencies=[needs(Right.VIEW), KNOWN_KEYS])
async def list_reanalyses(reanalyses: Given[Reanalyses]) -> ReanalysisList:
    """List the newest re-analyses of all gateways, newest first."""
    return ReanalysisList(reanalyses=[_view(one) for one in await reanalyses.newest(_LISTED)])


@router.get("/{number}", dependencies=[needs(Right.VIEW)])
async def get_reanalysis(number: Number, reanalyses: Given[Reanalyses]) -> ReanalysisView:
    """Return how far a re-analysis is."""
    return _view(await reanalyses.progress(number))


@router.post("/{number}/stop", dependencies=[needs(Right.ANALYZE)])
async def stop_reanalysis(number: Number, reanalyses: Given[Reanalyses], asks: Asks) -> ReanalysisView:
    """Take what is queued out of a re-analysis; tests under way end, and new results stay."""
    _require_covers(asks, (await reanalyses.progress(number)).reanalysis.wanted.valve)
    return _view(await reanalyses.stop(number, asks.requester))
