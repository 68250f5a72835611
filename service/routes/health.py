"""``/valves/{tag}/baseline``, ``/comparison`` and ``/trend``: what a valve's results are held against."""

from __future__ import annotations

import asyncio
from datetime import datetime
from typing import Annotated, Any, Final

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from drivers.motion.audit_log import AuditLog
from service.access.needs import Asks, needs, require_covers
from service.access.principal import Right
from service.health.changes import facts_of
from service.health.comparison import compare
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.health_figures import FIGURE_KINDS
from service.model.past_test import Baseline, PastTest
from service.model.run import Label, file_words
from service.routes.json_body import JsonRoute
from service.routes.lists import KNOWN_KEYS, OR_CSV, Form, csv_answer, dated, wants_csv
from service.routes.trend_view import TrendView, trends_of
from service.runs.own_test import completed_test_of
from service.runs.service import Runs
from service.store.store import Store
from service.words.names import named
from valve.errors import NotFoundError, RequestError
from valve.messages import say

router = APIRouter(prefix="/valves", tags=["health"], responses=PROBLEMS, route_class=JsonRoute)
TestId = Annotated[str | None, Query(max_length=40, pattern=r"^[^\x00]*$")]

_MOST_TESTS: Final = 1000
_COLUMNS: Final = (
    *("test", "at", "label", "ne107", "verdict"),
    *(f"{key}{end}" for key in FIGURE_KINDS for end in ("", "_low", "_high")),
)


class BaselineRequest(BaseModel):
    """The test that later ones are held against."""

    model_config = ConfigDict(extra="forbid", strict=True)
    test: str = Field(min_length=1, max_length=64, examples=["20261121T031502Z-9f3c01ab"])


class BaselineView(BaseModel):
    """What a valve's tests are held against."""

    valve: str
    test: str
    at: datetime
    set_by: str | None = Field(description="null where the first test that passed acceptance became it by itself")
    set_at: datetime | None
    figures: dict[str, dict[str, Any]]


class ComparisonView(BaseModel):
    """As found beside as left."""

    valve: str
    as_found: str
    as_left: str
    changes: list[dict[str, Any]] = Field(description="SI; ci95 is that of the change, sure: it leaves 0 out")
    sentences: list[str]


class TrendPage(BaseModel):
    """The main figures over a valve's tests, oldest first."""

    valve: str
    trends: list[TrendView]


def _view(tag: str, baseline: Baseline) -> BaselineView:
    test = baseline.test
    figures = {key: {"value": one.value, "ci95": one.ci95} for key, one in test.figures.items()}
    return BaselineView(
        valve=tag,
        test=test.test_id,
        at=test.at,
        set_by=baseline.set_by or None,
        set_at=baseline.set_at,
        figures=figures,
    )


@router.get("/{tag:path}/baseline", dependencies=[needs(Right.VIEW)])
async def get_baseline(tag: str, runs: Given[Runs], store: Given[Store]) -> BaselineView:
    """Return the baseline of a valve, the one that was set last."""
    runs.valve(tag)
    baseline = await asyncio.to_thread(store.figures.baseline, tag)
    if baseline is None:
        raise NotFoundError(
            say(
                "no_baseline_yet",
                "{tag}: there is no baseline yet: the first test that passes acceptance becomes it, or one that a "
                "person chooses by POST to this address",
                tag=tag,
            )
        )
    return _view(tag, baseline)


@router.post("/{tag:path}/baseline", dependencies=[needs(Right.CONFIGURE)])
async def set_baseline(
    tag: str, wanted: BaselineRequest, runs: Given[Runs], store: Given[Store], *, audit: Given[AuditLog], asks: Asks
) -> BaselineView:
    """Make a completed test the baseline: what it shows is how this valve is; later tests are held against it."""
    runs.valve(tag)
    require_covers(asks, tag)
    run = await completed_test_of(runs, tag, wanted.test)
    if await asyncio.to_thread(store.figures.get, run.id) is None:
        raise RequestError(
            say("test_without_figures", "test {test} has no figures: choose another completed test", test=run.id)
        )
    await asyncio.to_thread(audit.append, "baseline.set", who=asks.name, valve=tag, test=run.id)
    baseline = await asyncio.to_thread(store.figures.set_baseline, run, asks.name)
    assert baseline is not None, "its figures were just read"
    return _view(tag, baseline)


@router.get("/{tag:path}/comparison", dependencies=[needs(Right.VIEW), KNOWN_KEYS])
async def get_comparison(
    tag: str, runs: Given[Runs], store: Given[Store], as_found: TestId = None, as_left: TestId = None
) -> ComparisonView:
    """Compare a valve as found and as left: two tests by id, or the newest that carry these labels."""
    valve = runs.valve(tag)
    after = await asyncio.to_thread(_test, store, tag, as_left, Label.AS_LEFT, None)
    before = await asyncio.to_thread(_test, store, tag, as_found, Label.AS_FOUND, after)
    found = compare(before, after, valve.health, facts_of(valve)).to_json()
    return ComparisonView(valve=tag, **found)


@router.get(
    "/{tag:path}/trend", dependencies=[needs(Right.VIEW), KNOWN_KEYS], response_model=TrendPage, responses=OR_CSV
)
async def get_trend(
    request: Request,
    tag: str,
    runs: Given[Runs],
    store: Given[Store],
    *,
    limit: Annotated[int, Query(ge=1, le=_MOST_TESTS)] = 100,
    form: Form = None,
) -> Response:
    """Return the main figures of a valve over its newest tests, with their 95 % intervals, SI; as CSV a row a test.

    JSON has the newest days in service beside them, under `watched`.
    """
    runs.valve(tag)
    tests = await asyncio.to_thread(store.figures.newest, tag, limit)
    if wants_csv(request, form):
        return csv_answer(_COLUMNS, (_line(test) for test in reversed(tests)), dated(f"{file_words(tag)}_trend"))
    days = await asyncio.to_thread(store.watched.newest, tag, limit)
    shown = TrendPage(valve=tag, trends=trends_of(tests, days))
    return Response(shown.model_dump_json(), media_type="application/json", headers={"Vary": "Accept"})


def _line(test: PastTest) -> list[object]:
    row: list[object] = [test.test_id, test.at, test.label, test.ne107, test.verdict]
    for key in FIGURE_KINDS:
        figure = test.figures.get(key)
        row += [None] * 3 if figure is None else [figure.value, *(figure.ci95 or (None, None))]
    return row


def _test(store: Store, tag: str, test_id: str | None, label: Label, after: PastTest | None) -> PastTest:
    """Return the test of this id, or the newest with this label; of the latter, none that is later than ``after``."""
    if test_id is not None:
        found = store.figures.get(test_id)
        if found is None or store.runs.get(test_id).valve != tag:
            raise NotFoundError(
                say(
                    "no_completed_test_of_valve",
                    "{tag}: test {test} is no completed one of it: GET /tests lists all",
                    tag=tag,
                    test=test_id[:64],
                )
            )
        return found
    labelled = store.figures.newest(tag, _MOST_TESTS, label=label)
    fitting = [one for one in labelled if after is None or one.at <= after.at]
    if not fitting:
        word = named(label.value)
        if after is None:
            raise NotFoundError(
                say(
                    "none_labelled",
                    '{tag}: no completed test is labelled {words}: run one with "label": "{label}"',
                    tag=tag,
                    words=word,
                    label=label.value,
                )
            )
        raise NotFoundError(
            say(
                "none_labelled_before",
                '{tag}: no completed test up to {test} as left is labelled {words}: run one with "label": "{label}"',
                tag=tag,
                test=after.test_id,
                words=word,
                label=label.value,
            )
        )
    return fitting[0]
