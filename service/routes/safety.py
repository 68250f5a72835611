"""What keeps valves safe, over the REST interface: permissives without moving, acknowledgements, stop by tag."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict, Field

from service.access.needs import Asks, needs, require_covers
from service.access.principal import Right
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.routes.json_body import JsonRoute
from service.routes.run_views import Permit, ReaderOf, RunView, view
from service.runs.service import Runs
from service.words.units import UnitSystem

router = APIRouter(responses=PROBLEMS, route_class=JsonRoute)


class PermissiveView(BaseModel):
    """One condition; ``met`` is null where nothing shows it and the plant does not ask for it."""

    name: str
    met: bool | None
    value: str
    limit: str
    remedy: str = Field(description="what to do where it is not met; empty where it is")


class PermissionView(BaseModel):
    """Whether a valve may be tested."""

    valve: str
    may_start: bool
    permissives: list[PermissiveView]
    read_at: str | None = Field(description="when they were read; null where they never were")
    not_fresh_because: str = Field(description="why they are the last known ones; empty where they were read now")


class Acknowledgement(BaseModel):
    """What somebody found who looked at the valve."""

    model_config = ConfigDict(extra="forbid", strict=True)
    note: str = Field(min_length=1, max_length=2000, pattern=r"^[^\x00]*$", examples=["I/P fuse replaced, valve shut"])


@router.get("/valves/{tag:path}/permissives", tags=["valves"], dependencies=[needs(Right.VIEW)])
async def get_permissives(
    tag: str,
    runs: Given[Runs],
    reader: ReaderOf,
    permit: Annotated[Permit | None, Query()] = None,
    units: UnitSystem = UnitSystem.SI,
) -> PermissionView:
    """Read what must hold before this valve may move; nothing is moved. Under test: the last known ones.

    `permit` is the work permit that the test will name; `units` are those of the texts.
    """
    permission, reason = await runs.permission(tag, permit)
    shown = {"read_at": None, "permissives": []} if permission is None else permission.to_json()
    shown["permissives"] = replace(reader, system=units).all_told(shown["permissives"])
    not_fresh = reader.shown(reason)
    may_start = permission is not None and permission.may_start and not reason
    return PermissionView.model_validate(
        {**shown, "valve": tag, "may_start": may_start, "not_fresh_because": not_fresh}
    )


@router.post("/valves/{tag:path}/stop", tags=["valves"], dependencies=[needs(Right.STOP)])
async def stop_valve(tag: str, runs: Given[Runs], asks: Asks) -> RunView:
    """Stop whatever test uses this valve: it goes to its safe value at once."""
    run_id = await runs.running_test_of(tag)
    return view(await runs.stop(run_id, asks.requester))


@router.post("/tests/{test_id}/acknowledge", tags=["tests"], dependencies=[needs(Right.ACKNOWLEDGE)])
async def acknowledge_test(test_id: str, body: Acknowledgement, runs: Given[Runs], asks: Asks) -> RunView:
    """Say that somebody looked at the valve after a test that ended badly; then its next test may start."""
    require_covers(asks, (await runs.get(test_id)).valve)
    return view(await runs.acknowledge(test_id, asks.requester, body.note))
