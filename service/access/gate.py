"""The gate: before any route sees a request, it is known who asks, or the request ends here.

A machine sends ``Authorization: Bearer TOKEN``; a browser its session's cookie, and with whatever changes something
``X-CSRF-Token`` from a page of our own. Where there is no sign-in everybody is ``local``, on this machine alone.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
from functools import lru_cache
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import quote, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.access import Access
from service.access.principal import LOCAL_PRINCIPAL, Principal
from service.errors import problem

#: A page that asks again by itself sends this: it keeps no session open.
BACKGROUND_HEADER: Final = "x-background"
CSRF_HEADER: Final = "x-csrf-token"
_SAFE: Final = frozenset({"GET", "HEAD", "OPTIONS"})
SIGN_IN_PAGE: Final = "/ui/sign-in"
_OPEN: Final = frozenset({"/healthz", "/session", SIGN_IN_PAGE})
_STATIC: Final = "/ui/static/"
_PAGES: Final = ("/", "/ui", "/ui/")
_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
}
_HSTS: Final = "max-age=31536000"


def cookie_name(encrypted: bool) -> str:
    """Return the cookie's name; ``__Host-`` makes browsers refuse it from another host or without TLS."""
    return "__Host-breakaway" if encrypted else "breakaway"


class _Refusal(Exception):  # noqa: N818 - it is an answer, and leaves this module never
    def __init__(self, status: HTTPStatus, detail: str) -> None:
        super().__init__(detail)
        self.status = status


class Gate:
    """ASGI middleware that puts a Principal, or None on the few open paths, into ``request.state.principal``."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request; a web socket is no route of this service."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        access: Access = scope["app"].state.parts.access
        guarded = _with_headers(send, access.settings.tls_certificate is not None)
        try:
            principal = await _principal(access, scope)
        except _Refusal as refusal:
            await _answer(scope, refusal)(scope, receive, guarded)
            return
        scope.setdefault("state", {})["principal"] = principal
        await self._app(scope, receive, guarded)


async def _principal(access: Access, scope: Scope) -> Principal | None:
    headers = Headers(scope=scope)
    credentials = headers.getlist("authorization")
    if credentials:
        return await _machine(access, credentials)
    changes = scope["method"] not in _SAFE
    if changes:
        _require_own_origin(headers, access.settings.encrypted)
    secret = session_secret(headers, access.settings.encrypted)
    if secret:
        active = BACKGROUND_HEADER not in headers and "text/event-stream" not in headers.get("accept", "")
        person = await asyncio.to_thread(access.sessions.principal, secret, active=active)
        if person is not None:
            if changes:
                _require_csrf_token(headers, person)
            return person
    if not access.settings.sign_in:
        if access.settings.loopback:
            _require_local_host(headers)
        return LOCAL_PRINCIPAL
    path: str = scope["path"]
    if path not in _OPEN and not path.startswith(_STATIC):
        why = "this session is over" if secret else "nobody is signed in"
        raise _Refusal(
            HTTPStatus.UNAUTHORIZED,
            f"{why}: sign in (POST /session, or /ui/sign-in in a browser), or send Authorization: Bearer TOKEN; "
            "a test that runs goes on",
        )
    return None


def _answer(scope: Scope, refusal: _Refusal) -> Response:
    """Return a problem document; a person whose browser asks for a page is led to the one where they sign in."""
    path: str = scope["path"]
    if refusal.status is not HTTPStatus.UNAUTHORIZED:
        return problem(refusal.status, str(refusal), instance=path)
    if scope["method"] == "GET" and (path in _PAGES or path.startswith(_PAGES[-1])):
        query = scope["query_string"].decode("ascii", "replace")
        wanted = quote(f"{path}?{query}" if query else path, safe="/")
        return RedirectResponse(f"{SIGN_IN_PAGE}?next={wanted}", HTTPStatus.SEE_OTHER)
    return problem(refusal.status, str(refusal), instance=path, headers={"WWW-Authenticate": "Bearer"})


async def _machine(access: Access, credentials: list[str]) -> Principal:
    scheme, _, secret = credentials[0].partition(" ")
    if len(credentials) > 1 or scheme.lower() != "bearer":
        raise _Refusal(HTTPStatus.UNAUTHORIZED, "the authorization is no bearer token: send Bearer TOKEN, once")
    principal, why = await asyncio.to_thread(access.tokens.principal, secret.strip())
    if principal is None:
        raise _Refusal(HTTPStatus.UNAUTHORIZED, why)
    return principal


def session_secret(headers: Headers, encrypted: bool) -> str:
    """Return the secret that the session's cookie holds, "" without one."""
    name = cookie_name(encrypted)
    for text in headers.getlist("cookie"):
        try:
            found = SimpleCookie(text).get(name)
        except CookieError:
            continue
        if found is not None:
            return found.value
    return ""


def _require_csrf_token(headers: Headers, person: Principal) -> None:
    given = headers.get(CSRF_HEADER, "").encode()
    if person.csrf_token is None or not hmac.compare_digest(given, person.csrf_token.encode()):
        raise _Refusal(
            HTTPStatus.FORBIDDEN,
            "X-CSRF-Token is missing or of another session: send the one of GET /session, or load the page anew",
        )


def _require_own_origin(headers: Headers, encrypted: bool) -> None:
    """Refuse what a page of another site sends; a program sends no Origin."""
    origin = headers.get("origin")
    if origin is None:
        if headers.get("sec-fetch-site", "none") in ("none", "same-origin"):
            return
    else:
        parts = urlsplit(origin)
        if parts.netloc and parts.netloc == headers.get("host") and (parts.scheme == "https" or not encrypted):
            return
    raise _Refusal(
        HTTPStatus.FORBIDDEN,
        "a page of another site sent this: open the service's own page; behind a proxy let it hand on Host unchanged",
    )


def _require_local_host(headers: Headers) -> None:
    """Refuse a name that somebody's DNS points at this machine: its pages would be of our origin."""
    if not _is_local(headers.get("host", "")):
        raise _Refusal(
            HTTPStatus.FORBIDDEN,
            "without sign-in this service answers to localhost and loopback addresses alone: use http://127.0.0.1, "
            'or set service.access = "sign-in"',
        )


@lru_cache(maxsize=64)  # a browser sends the same with every request
def _is_local(host: str) -> bool:
    name = urlsplit(f"//{host}").hostname or ""
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return name == "localhost"


def _with_headers(send: Send, tls: bool) -> Send:
    async def guarded(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
            if tls:
                headers.setdefault("Strict-Transport-Security", _HSTS)
        await send(message)

    return guarded
