"""JSON bodies, read strictly: what two readers could understand in two ways must not move a valve."""

from __future__ import annotations

import json
from collections.abc import Callable, Coroutine
from http import HTTPStatus
from typing import Any, Final

from fastapi import HTTPException, Request, Response
from fastapi.routing import APIRoute

from valve.messages import message_of, say

_MOST_DIGITS: Final = 20


class JsonRequest(Request):
    """A request whose JSON names each key once and has plain numbers only."""

    async def json(self) -> Any:
        """Return the body. Raises HTTPException 422 where it is no JSON, or not of this kind."""
        try:
            return json.loads(
                await self.body(), object_pairs_hook=_unique, parse_int=_short_integer, parse_constant=_no_number
            )
        except RecursionError:
            raise _unreadable(say("nested_too_deeply", "it is nested too deeply")) from None
        except ValueError as error:
            raise _unreadable(message_of(error)) from None


class JsonRoute(APIRoute):
    """A route that takes JSON where it takes a body."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return FastAPI's handler, behind the check of the body's type and with a strict reader."""
        handle = super().get_route_handler()

        async def strictly(request: Request) -> Response:
            if self.body_field is not None:
                _require_json(request)
            return await handle(JsonRequest(request.scope, request.receive))

        return strictly


def _require_json(request: Request) -> None:
    given = request.headers.get("content-type")
    kind = (given or "").partition(";")[0].strip().lower()
    has_body = request.headers.get("content-length", "0") != "0" or "transfer-encoding" in request.headers
    if (given is None and not has_body) or kind == "application/json" or kind.endswith("+json"):
        return
    raise HTTPException(
        HTTPStatus.UNSUPPORTED_MEDIA_TYPE,
        say("send_json", "the body is {kind}: send JSON with Content-Type: application/json", kind=kind[:80])
        if kind
        else say("send_json_with_type", "the body is of no known type: send JSON with Content-Type: application/json"),
    )


def _unreadable(reason: str) -> HTTPException:
    return HTTPException(
        HTTPStatus.UNPROCESSABLE_ENTITY,
        say("body_no_json", "the body is no JSON that can be read: {reason}: correct the request", reason=reason),
    )


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members: dict[str, Any] = {}
    for key, value in pairs:
        if key in members:
            raise ValueError(say("key_twice", "the key {key} stands in it twice", key=repr(key[:80])))
        members[key] = value
    return members


def _short_integer(digits: str) -> int:
    if len(digits) > _MOST_DIGITS:
        raise ValueError(
            say("long_integer", "a whole number has {n} digits, the most is {most}", n=len(digits), most=_MOST_DIGITS)
        )
    return int(digits)


def _no_number(name: str) -> float:
    raise ValueError(say("no_number", "{name} is no number", name=name))
