"""``POST /plant/reload``: plant.toml read again while the service serves."""

from __future__ import annotations

from http import HTTPStatus

from fastapi import APIRouter

from service.access.needs import Asks, needs
from service.access.principal import Right
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.refusals import ForbiddenError
from service.reload import Reloaded, Reloader
from valve.messages import say

router = APIRouter(prefix="/plant", tags=["plant"], responses=PROBLEMS)


@router.post("/reload", status_code=HTTPStatus.OK, dependencies=[needs(Right.CONFIGURE)])
async def reload_plant(asks: Asks, reloader: Given[Reloader]) -> Reloaded:
    """Read plant.toml again while the service serves; a valve under test keeps its configuration until its end.

    A file with a fault is answered 422 with every fault, and changes nothing.
    """
    if asks.valves is not None:
        raise ForbiddenError(
            say(
                "token_cannot_reload",
                "the token of {name} is for some valves: the plant file is about all of them",
                name=asks.name,
            )
        )
    return await reloader.reload(asks.name)
