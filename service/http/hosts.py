"""By which names this service answers: a name that somebody else's DNS points here would make their pages ours.

DNS rebinding: a page of evil.example, which then resolves to this machine, is of one origin with what answers there.
The framework's own middleware refuses its ``Host``. An address is no name and cannot be rebound: the one at which a
connection arrived is always ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from http import HTTPStatus
from typing import Final

from starlette.datastructures import Headers
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.http.errors import told
from valve.messages import say

LOOPBACK_NAMES: Final = ("localhost", "127.0.0.1", "[::1]")
_LET_IN: Final = "breakaway.host"
_REFUSED: Final = say(
    "host_not_ours",
    "this service does not answer to the name in Host, or it is none: use one that service.allowed_hosts names, "
    "or add it there",
)


class Hosts:
    """ASGI middleware that answers 400 to another ``Host`` than ours, and to what is no host at all."""

    def __init__(self, app: ASGIApp, allowed_hosts: Sequence[str]) -> None:
        self._app = app
        self._check = TrustedHostMiddleware(
            self._let_in, allowed_hosts=[*LOOPBACK_NAMES, *allowed_hosts], www_redirect=False
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        given = Headers(scope=scope).getlist("host")
        if given == [_authority(scope)]:
            await self._app(scope, receive, send)
            return
        scope = {**scope, _LET_IN: False}

        async def sending(message: Message) -> None:
            if scope[_LET_IN]:  # what the check itself says is plain text: a problem document follows instead
                await send(message)

        if len(given) == 1:
            await self._check(scope, receive, sending)
        if not scope[_LET_IN]:
            await told(HTTPStatus.BAD_REQUEST, _REFUSED, Request(scope))(scope, receive, send)

    async def _let_in(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope[_LET_IN] = True
        await self._app(scope, receive, send)


def _authority(scope: Scope) -> str:
    """Return the address at which a connection arrived, as a browser writes it into Host; "" for a local socket."""
    host, port = scope.get("server") or ("", None)
    if port is None:
        return ""
    shown = f"[{host}]" if ":" in host else host
    return shown if port == (443 if scope["scheme"] == "https" else 80) else f"{shown}:{port}"
