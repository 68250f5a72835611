"""``POST /plant/reload``: plant.toml read again while the service serves."""

from __future__ import annotations

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Request

from service.access.needs import Asks, needs
from service.access.principal import Right
from service.http.problems import PROBLEMS
from service.model.refusals import ForbiddenError
from service.reload import Reloaded, Reloader

router = APIRouter(prefix="/plant", tags=["plant"], responses=PROBLEMS)


async def _reloader_of(request: Request) -> Reloader:
    reloader = request.app.state.reloader
    assert isinstance(reloader, Reloader)
    return reloader


@router.post("/reload", status_code=HTTPStatus.OK, dependencies=[needs(Right.CONFIGURE)])
async def reload_plant(asks: Asks, reloader: Annotated[Reloader, Depends(_reloader_of)]) -> Reloaded:
    """Read plant.toml again while the service serves; a valve under test keeps its configuration until its end.

    A file with a fault is answered 422 with every fault, and changes nothing.
    """
    if asks.valves is not None:
        raise ForbiddenError(f"the token of {asks.name} is for some valves: the plant file is about all of them")
    return await reloader.reload(asks.name)
