"""How large and how slow a request's body may be: what is beyond is cut, so that stop always gets through."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from http import HTTPStatus
from typing import Final

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.http.errors import told
from valve.messages import say

KIB: Final = 1024
UPLOAD_PATH: Final = "/recordings/analyze"


@dataclass(frozen=True, slots=True)
class BodyLimit:
    """Most bytes of a body, and seconds until all of it must be there."""

    size_bytes: int
    seconds: float


BODY: Final = BodyLimit(64 * KIB, 10.0)
_DRAINED_BYTES: Final = 1024 * KIB
_DRAIN_S: Final = 1.0
# 10 minutes of 1 kHz are 40 MB of CSV.
UPLOAD: Final = BodyLimit(64 * KIB * KIB, 120.0)


class BodyLimits:
    """ASGI middleware that refuses bodies by size (413) and by time (408)."""

    def __init__(self, app: ASGIApp, body: BodyLimit = BODY, upload: BodyLimit = UPLOAD) -> None:
        self._app = app
        self._body = body
        self._upload = upload

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        limit = self._upload if scope["path"] == UPLOAD_PATH else self._body
        too_large = say(
            "body_too_large",
            "the body is larger than {most} KiB, the most that {path} takes: send less",
            most=limit.size_bytes // KIB,
            path=scope["path"],
        )
        announced = dict(scope["headers"]).get(b"content-length", b"0")
        if announced.isdigit() and int(announced[:20]) > limit.size_bytes:
            await _drain(receive)
            answer = told(
                HTTPStatus.REQUEST_ENTITY_TOO_LARGE, too_large, Request(scope), headers={"Connection": "close"}
            )
            await answer(scope, receive, send)
            return
        await self._app(scope, _limited(receive, limit, too_large), send)


async def _drain(receive: Receive) -> None:
    """Throw away what still comes, a little of it: a client that is cut while it sends may never see the answer."""
    left = _DRAINED_BYTES
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(_DRAIN_S):
            while left > 0:
                message = await receive()
                left -= len(message.get("body", b""))
                if not message.get("more_body", False):
                    return


def _limited(receive: Receive, limit: BodyLimit, too_large: str) -> Receive:
    received = 0
    complete = False
    deadline_s = asyncio.get_running_loop().time() + limit.seconds

    async def limited() -> Message:
        nonlocal received, complete
        if complete:
            return await receive()
        try:
            async with asyncio.timeout_at(deadline_s):
                message = await receive()
        except TimeoutError:
            raise HTTPException(
                HTTPStatus.REQUEST_TIMEOUT,
                say(
                    "body_too_slow",
                    "the body was not complete after {seconds:g} s: send it faster",
                    seconds=limit.seconds,
                ),
                headers={"Connection": "close"},
            ) from None
        if message["type"] == "http.request":
            received += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            if received > limit.size_bytes:
                if not complete:
                    await _drain(receive)
                raise HTTPException(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, too_large, headers={"Connection": "close"})
        return message

    return limited
