"""``/valves/{tag}/model``: the extended model that was accepted for a valve."""

from __future__ import annotations

import asyncio
from datetime import datetime
from http import HTTPStatus
from typing import Any

from fastapi import APIRouter, Response
from pydantic import BaseModel, ConfigDict, Field

from drivers.motion.audit_log import AuditLog
from service.access.needs import Asks, needs, require_covers
from service.access.principal import Right
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.routes.json_body import JsonRoute
from service.runs.own_test import completed_test_of
from service.runs.service import Runs
from service.store.model_table import AcceptedModel
from service.store.store import Store
from service.words.names import named
from valve.errors import NotFoundError, RequestError
from valve.messages import say

router = APIRouter(prefix="/valves", tags=["models"], responses=PROBLEMS, route_class=JsonRoute)


class ModelRequest(BaseModel):
    """The test whose extended model is accepted."""

    model_config = ConfigDict(extra="forbid", strict=True)
    test: str = Field(min_length=1, max_length=64, examples=["20261121T031502Z-9f3c01ab"])


class ModelView(BaseModel):
    """The model that stands for a valve."""

    valve: str
    test: str = Field(description="id of the test that it came from")
    accepted_at: datetime
    accepted_by: str
    model: dict[str, Any] = Field(description="breakaway/valve-model/2: parameters and causes with their intervals")


def _view(accepted: AcceptedModel) -> ModelView:
    return ModelView(
        valve=accepted.valve,
        test=accepted.test,
        accepted_at=accepted.accepted_at,
        accepted_by=accepted.accepted_by,
        model=dict(accepted.model),
    )


@router.get("/{tag:path}/model", dependencies=[needs(Right.VIEW)])
async def get_model(tag: str, runs: Given[Runs], store: Given[Store]) -> ModelView:
    """Return the extended model that was accepted for a valve."""
    runs.valve(tag)
    accepted = await asyncio.to_thread(store.models.current, tag)
    if accepted is None:
        raise NotFoundError(
            say(
                "no_model_accepted",
                "{tag}: no model was accepted: accept that of a test by POST /valves/{tag}/model",
                tag=tag,
            )
        )
    return _view(accepted)


@router.post("/{tag:path}/model", dependencies=[needs(Right.CONFIGURE)])
async def accept_model(
    tag: str, wanted: ModelRequest, runs: Given[Runs], store: Given[Store], *, audit: Given[AuditLog], asks: Asks
) -> ModelView:
    """Accept the extended model of a completed test: later tests of the valve are judged against it."""
    runs.valve(tag)
    require_covers(asks, tag)
    run = await completed_test_of(runs, tag, wanted.test)
    discrepancy = (run.analysis or {}).get("discrepancy") or {}
    model = discrepancy.get("extended_model")
    if model is None:
        verdict = named(str(discrepancy.get("verdict", "not_assessed")))
        raise RequestError(
            say(
                "no_extended_model",
                "test {test} has no extended model (diagnosis: {verdict}): accept that of a test with a named cause",
                test=run.id,
                verdict=verdict,
            )
        )
    if discrepancy.get("verdict") == "ambiguous":
        raise RequestError(
            say(
                "cause_not_told_apart",
                "test {test} does not tell its cause from {rivals:, }: run the sequence separating first, and accept "
                "the model of a test with a named cause",
                test=run.id,
                rivals=tuple(discrepancy.get("not_told_apart_from") or ()),
            )
        )
    details = {"test": run.id, "causes": sorted(model["causes"])}
    await asyncio.to_thread(audit.append, "model.accepted", who=asks.name, valve=tag, test=run.id, details=details)
    return _view(await asyncio.to_thread(store.models.accept, tag, run.id, model, asks.name))


@router.delete("/{tag:path}/model", status_code=HTTPStatus.NO_CONTENT, dependencies=[needs(Right.CONFIGURE)])
async def withdraw_model(
    tag: str, runs: Given[Runs], store: Given[Store], audit: Given[AuditLog], asks: Asks
) -> Response:
    """Take the accepted model back: later tests are judged against the plain valve again."""
    runs.valve(tag)
    require_covers(asks, tag)
    accepted = await asyncio.to_thread(store.models.current, tag)
    if accepted is None:
        raise NotFoundError(
            say("no_model_to_take_back", "{tag}: no model was accepted, so there is none to take back", tag=tag)
        )
    await asyncio.to_thread(audit.append, "model.withdrawn", who=asks.name, valve=tag, test=accepted.test)
    await asyncio.to_thread(store.models.withdraw, tag, asks.name)
    return Response(status_code=HTTPStatus.NO_CONTENT)
