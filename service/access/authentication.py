"""Before any route sees a request, it is known who asks, or the request ends here.

A machine sends ``Authorization: Bearer TOKEN``; a browser its session's cookie, and with whatever changes something
``X-CSRF-Token`` from a page of our own. Where there is no sign-in everybody is ``local``.

A Stop of a test that runs is let through by memory alone (``service.access.stop_grants``): no database is asked.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import re
from collections.abc import AsyncIterator
from dataclasses import replace
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Final
from urllib.parse import quote, urlsplit

import structlog
from sqlalchemy.exc import SQLAlchemyError
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.access.access import Access
from service.access.principal import LOCAL_PRINCIPAL, Principal
from service.access.sessions import csrf_token, sha256
from service.http.errors import NO_DATABASE, told
from service.http.given import part_of
from service.model.requester import RequesterKind
from service.runs.service import Runs
from valve.messages import message_of, say

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
_STREAM: Final = "text/event-stream"
_STOP: Final = re.compile(r"/tests/(?P<test>[^/]+)/stop|/valves/(?P<valve>.+)/stop")
_STOP_ASKS_S: Final = 2.0  # of the database, where memory does not know who wants to stop
_NOT_KNOWN: Final = say(
    "stop_not_sent",
    "STOP IS NOT SENT: the database does not answer, and nobody with these credentials was known while this test ran: "
    "press Stop on a page that was open already, or use the means at the valve itself",
)
WATCHING_NOTED_S: Final = 60.0  # a watcher's session is kept open this often
WATCHER: Final = "keeps a watcher's session open"  # the task's name
_LOG = structlog.get_logger(__name__)


def cookie_name(encrypted: bool) -> str:
    """Return the cookie's name; ``__Host-`` makes browsers refuse it from another host or without TLS."""
    return "__Host-breakaway" if encrypted else "breakaway"


class _Refusal(Exception):  # noqa: N818 - it is an answer, and leaves this module never
    def __init__(self, status: HTTPStatus, detail: str) -> None:
        super().__init__(detail)
        self.status = status


class Authentication:
    """ASGI middleware that puts a Principal, or None on the few open paths, into ``request.state.principal``."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request; a web socket is no route of this service."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        access = part_of(scope["app"], Access)
        guarded = _with_headers(send, access.settings.tls_certificate is not None)
        began_s = _stopped_test_began_s(part_of(scope["app"], Runs), scope)
        try:
            async with asyncio.timeout(None if began_s is None else _STOP_ASKS_S):
                principal = await _principal(access, scope, began_s)
        except _Refusal as refusal:
            await _answer(scope, refusal)(scope, receive, guarded)
            return
        except (TimeoutError, SQLAlchemyError) as error:
            _LOG.error("nobody is known", path=scope["path"], reason=type(error).__name__)
            why = NO_DATABASE if began_s is None else _NOT_KNOWN
            await _answer(scope, _Refusal(HTTPStatus.SERVICE_UNAVAILABLE, why))(scope, receive, guarded)
            return
        scope.setdefault("state", {})["principal"] = principal
        async with _kept_open(access, scope, principal):
            await self._app(scope, receive, guarded)


def _stopped_test_began_s(runs: Runs, scope: Scope) -> float | None:
    """Return when the test began that a request wants to stop, by the monotonic clock; None for all other requests."""
    found = _STOP.fullmatch(scope["path"]) if scope["method"] == "POST" else None
    if found is None:
        return None
    run_id = found["test"] or runs.user_of(found["valve"])
    return None if run_id is None else runs.under_way_since_s(run_id)


@contextlib.asynccontextmanager
async def _kept_open(access: Access, scope: Scope, principal: Principal | None) -> AsyncIterator[None]:
    """Keep the session of a person open for as long as they follow a stream of events: to watch is to be there."""
    headers = Headers(scope=scope)
    person = principal is not None and principal.kind is RequesterKind.PERSON
    if not person or not _is_active(headers) or _STREAM not in headers.get("accept", ""):
        yield
        return
    secret = session_secret(headers, access.settings.encrypted)

    async def keep() -> None:
        while True:
            await asyncio.sleep(WATCHING_NOTED_S)
            try:
                await access.person(secret, active=True)
            except SQLAlchemyError as error:
                _LOG.warning("session of a watcher not noted", reason=type(error).__name__)

    keeping = asyncio.create_task(keep(), name=WATCHER)
    try:
        yield
    finally:
        keeping.cancel()


def _is_active(headers: Headers) -> bool:
    return BACKGROUND_HEADER not in headers


async def _principal(access: Access, scope: Scope, stopped_began_s: float | None) -> Principal | None:
    """Return who asks; for a Stop of a test that runs by memory, and by the database only where that knows nothing."""
    headers = Headers(scope=scope)

    def granted(secret: str) -> Principal | None:
        return None if stopped_began_s is None else access.grants.holder(sha256(secret), stopped_began_s)

    credentials = headers.getlist("authorization")
    if credentials:
        token = _bearer(credentials)
        return granted(token) or await _machine(access, token)
    changes = scope["method"] not in _SAFE
    if changes:
        _require_own_origin(headers, access.settings.encrypted)
    secret = session_secret(headers, access.settings.encrypted)
    stops_openly = stopped_began_s is not None and not access.settings.sign_in
    if secret:
        person = granted(secret)
        if person is None and not stops_openly:
            person = await access.person(secret, active=_is_active(headers))
        if person is not None:
            if changes:
                _require_csrf_token(headers, secret)
            return replace(person, csrf_token=csrf_token(secret))
    if not access.settings.sign_in:
        return LOCAL_PRINCIPAL
    path: str = scope["path"]
    if path not in _OPEN and not path.startswith(_STATIC):
        why = (
            say("session_is_over", "this session is over") if secret else say("nobody_signed_in", "nobody is signed in")
        )
        raise _Refusal(
            HTTPStatus.UNAUTHORIZED,
            say(
                "sign_in",
                "{why}: sign in (POST /session, or /ui/sign-in in a browser), or send Authorization: Bearer TOKEN; a "
                "test that runs goes on",
                why=why,
            ),
        )
    return None


def _answer(scope: Scope, refusal: _Refusal) -> Response:
    """Return a problem document; a person whose browser asks for a page is led to the one where they sign in."""
    path: str = scope["path"]
    if refusal.status is not HTTPStatus.UNAUTHORIZED:
        return told(refusal.status, message_of(refusal), Request(scope))
    if scope["method"] == "GET" and (path in _PAGES or path.startswith(_PAGES[-1])):
        query = scope["query_string"].decode("ascii", "replace")
        wanted = quote(f"{path}?{query}" if query else path, safe="/")
        return RedirectResponse(f"{SIGN_IN_PAGE}?next={wanted}", HTTPStatus.SEE_OTHER)
    return told(refusal.status, message_of(refusal), Request(scope), headers={"WWW-Authenticate": "Bearer"})


def _bearer(credentials: list[str]) -> str:
    scheme, _, secret = credentials[0].partition(" ")
    if len(credentials) > 1 or scheme.lower() != "bearer":
        raise _Refusal(
            HTTPStatus.UNAUTHORIZED,
            say("no_bearer_token", "the authorization is no bearer token: send Bearer TOKEN, once"),
        )
    return secret.strip()


async def _machine(access: Access, secret: str) -> Principal:
    principal, why = await access.machine(secret)
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


def _require_csrf_token(headers: Headers, secret: str) -> None:
    given = headers.get(CSRF_HEADER, "").encode()
    if not hmac.compare_digest(given, csrf_token(secret).encode()):
        raise _Refusal(
            HTTPStatus.FORBIDDEN,
            say(
                "csrf_token_wrong",
                "X-CSRF-Token is missing or of another session: send the one of GET /session, or load the page anew",
            ),
        )


def _require_own_origin(headers: Headers, encrypted: bool) -> None:
    """Refuse what a page of another site sends; a program sends no Origin."""
    origin = headers.get("origin")
    if origin is None:
        if headers.get("sec-fetch-site", "none") in ("none", "same-origin"):
            return
    elif origin != "null":
        scheme, netloc = _origin_parts(origin)
        if netloc == headers.get("host", "").lower() and (scheme == "https" or not encrypted):
            return
    raise _Refusal(
        HTTPStatus.FORBIDDEN,
        say(
            "page_of_another_site",
            "a page of another site sent this: open the service's own page; behind a proxy let it hand on Host "
            "unchanged",
        ),
    )


def _origin_parts(origin: str) -> tuple[str, str]:
    """Return scheme and host of an origin (RFC 6454, 6.1), both in lower case; 400 for what is none."""
    try:
        parts = urlsplit(origin)
        if parts.scheme and parts.hostname and parts.port != 0:  # the port is read here, as it may be no number
            return parts.scheme.lower(), parts.netloc.lower()
    except ValueError:
        pass
    raise _Refusal(
        HTTPStatus.BAD_REQUEST,
        say("no_origin", "the header Origin holds no origin: send one such as https://host:port"),
    )


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
