"""Every error as a problem document (RFC 9457): one table from the tree of errors to a status."""

from __future__ import annotations

import math
from collections.abc import Mapping
from http import HTTPStatus
from typing import Annotated, Any, Final

import structlog
from fastapi import Depends, FastAPI, Header, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from sqlalchemy.exc import OperationalError
from starlette.exceptions import HTTPException

from drivers.motion.orders import MotionLostError
from service.model.refusals import ForbiddenError, NotSignedInError, ThrottledError
from service.words.languages import Language
from service.words.reader import Reader
from service.words.spelling import known_keys, unknown_key
from service.words.units import UnitSystem
from valve.errors import (
    BusyError,
    ConfigurationError,
    DeviceError,
    ElsewhereError,
    EquipmentError,
    InternalError,
    MeasurementError,
    NotFoundError,
    PermissiveError,
    RequestError,
    ValveError,
)
from valve.messages import Message, message_of, say

#: The pages of the tablet say by it what they are read in; ``detail`` stays SI, ``shown`` says the same in these
#: units, and in the language that the page asks for.
UNITS_HEADER: Final = "Breakaway-Units"
PROBLEM_TYPE: Final = "application/problem+json"
NO_DATABASE: Final = say(
    "database_silent",
    "the database does not answer: a test that runs goes on and can be stopped; the service's log says more",
)
_FAULT_OF_OURS: Final = say("fault_of_service", "a fault of the service: its log says more; please report it")
_BODY_KEY_DEPTH: Final = 2  # ("body", key): a key of the body itself, whose model the route knows
_LOG = structlog.get_logger(__name__)

# The nearest ancestor that stands here counts.
STATUS: Final[dict[type[ValveError], HTTPStatus]] = {
    RequestError: HTTPStatus.UNPROCESSABLE_ENTITY,
    NotSignedInError: HTTPStatus.UNAUTHORIZED,
    ForbiddenError: HTTPStatus.FORBIDDEN,
    ThrottledError: HTTPStatus.TOO_MANY_REQUESTS,
    NotFoundError: HTTPStatus.NOT_FOUND,
    BusyError: HTTPStatus.CONFLICT,
    ElsewhereError: HTTPStatus.MISDIRECTED_REQUEST,
    PermissiveError: HTTPStatus.LOCKED,
    ConfigurationError: HTTPStatus.UNPROCESSABLE_ENTITY,
    EquipmentError: HTTPStatus.BAD_GATEWAY,
    DeviceError: HTTPStatus.BAD_GATEWAY,
    MeasurementError: HTTPStatus.UNPROCESSABLE_ENTITY,
    MotionLostError: HTTPStatus.SERVICE_UNAVAILABLE,
    InternalError: HTTPStatus.INTERNAL_SERVER_ERROR,
}


def status_of(error: ValveError) -> HTTPStatus:
    """Return the status of an error."""
    for kind in type(error).__mro__:
        if kind in STATUS:
            return STATUS[kind]
    return HTTPStatus.INTERNAL_SERVER_ERROR


class ProblemResponse(JSONResponse):
    """An ``application/problem+json`` answer."""

    media_type = PROBLEM_TYPE


def told(
    status: int,
    said: str,
    request: Request,
    *,
    kind: str = "about:blank",
    headers: Mapping[str, str] | None = None,
    **more: Any,
) -> ProblemResponse:
    """Return a problem document; ``kind`` names the branch of the tree of errors where there is one.

    ``message`` is what a message was made of, ``shown`` what the page that asks shows of it.
    """
    path = request.url.path
    body = {
        "type": kind,
        "title": HTTPStatus(status).phrase,
        "status": status,
        "detail": _printable(said),
        "instance": path,
        **more,
    }
    if isinstance(said, Message):
        body["message"] = _as_json(said.to_json())
    reader = reader_of_page(request.headers.get(UNITS_HEADER), request.headers.get("Accept-Language"))
    if reader is not None:
        body["shown"] = _printable(reader.told(said))
    return ProblemResponse(body, status_code=status, headers=dict(headers or {}))


def reader_of_page(units: str | None, languages: str | None) -> Reader | None:
    """Return who reads the page of the tablet that asks, by its headers; None where it is no page."""
    return None if units is None else Reader(UnitSystem.of(units), language=Language.wished(languages))


async def _page(
    units: Annotated[str | None, Header(alias=UNITS_HEADER, include_in_schema=False, max_length=16)] = None,
    languages: Annotated[str | None, Header(alias="Accept-Language", include_in_schema=False)] = None,
) -> Reader | None:
    return reader_of_page(units, languages)


#: Who reads the page of the tablet that asks; None where it is no page.
PageReader = Annotated[Reader | None, Depends(_page)]


def _printable(text: str) -> str:
    return text.encode("utf-8", "backslashreplace").decode()


def _as_json(value: Any) -> Any:
    """Return what a message was made of with texts that can be printed."""
    if isinstance(value, str):
        return _printable(value)
    if isinstance(value, Mapping):
        return {name: _as_json(one) for name, one in value.items()}
    return [_as_json(one) for one in value] if isinstance(value, list) else value


def _valve_error(request: Request, error: Exception) -> ProblemResponse:
    if not isinstance(error, ValveError):
        raise error
    status = status_of(error)
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
        _LOG.error("request failed", path=request.url.path, error=str(error))
    kind = f"urn:breakaway:error:{type(error).__name__}"
    more: dict[str, Any] = {"gateway": error.gateway, "url": error.url} if isinstance(error, ElsewhereError) else {}
    headers = {"WWW-Authenticate": "Bearer"} if status is HTTPStatus.UNAUTHORIZED else {}
    if isinstance(error, ThrottledError):
        headers["Retry-After"] = str(math.ceil(error.retry_after_s))
    return told(status, message_of(error), request, kind=kind, headers=headers, **more)


def _http_error(request: Request, error: Exception) -> ProblemResponse:
    if not isinstance(error, HTTPException):
        raise error
    detail, path = error.detail, request.url.path
    if error.status_code == HTTPStatus.NOT_FOUND and detail == HTTPStatus.NOT_FOUND.phrase:
        detail = say("no_route", "{path} is no route of this service: /docs lists all", path=path)
    if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
        method = request.method
        detail = say(
            "no_such_method", "{method} is not possible on {path}: /docs lists what is", method=method, path=path
        )
    headers = dict(error.headers or {})
    if "GET" in headers.get("Allow", "").split(", "):
        headers["Allow"] += ", HEAD"
    return told(error.status_code, detail, request, headers=headers)


def _invalid_request(request: Request, error: Exception) -> ProblemResponse:
    if not isinstance(error, RequestValidationError):
        raise error
    # What was sent is not repeated: it may be huge, not a number, or no valid text.
    errors = [
        {"where": _printable(".".join(str(part) for part in one["loc"])), "reason": _printable(_reason(request, one))}
        for one in error.errors()[:20]
    ]
    found = tuple(say("wrong_at", "{where}: {reason}", where=one["where"], reason=one["reason"]) for one in errors)
    detail = say("correct_request", "{found:; }: correct the request", found=found)
    return told(HTTPStatus.UNPROCESSABLE_ENTITY, detail, request, errors=errors)


def _reason(request: Request, one: Mapping[str, Any]) -> str:
    """Return what is wrong with one value; of an unknown key of the body also which key was meant."""
    if one["type"] != "extra_forbidden" or len(one["loc"]) != _BODY_KEY_DEPTH:
        text = one["msg"]
        return text if isinstance(text, str) else str(text)
    field = getattr(request.scope.get("route"), "body_field", None)
    known = [] if field is None else known_keys(field.field_info.annotation)
    return unknown_key(str(one["loc"][-1]), known)


def _no_database(request: Request, error: Exception) -> ProblemResponse:
    reason = " ".join(str(getattr(error, "orig", None) or error).split())
    _LOG.error("the database does not answer", path=request.url.path, reason=reason[:300])
    return told(HTTPStatus.SERVICE_UNAVAILABLE, NO_DATABASE, request)


def _unexpected(request: Request, error: Exception) -> ProblemResponse:
    _LOG.error("request failed unexpectedly", path=request.url.path, exc_info=error)
    return told(HTTPStatus.INTERNAL_SERVER_ERROR, _FAULT_OF_OURS, request)


def install_error_handlers(app: FastAPI) -> None:
    """Make every error of ``app`` a problem document."""
    app.add_exception_handler(ValveError, _valve_error)
    app.add_exception_handler(HTTPException, _http_error)
    app.add_exception_handler(RequestValidationError, _invalid_request)
    app.add_exception_handler(OperationalError, _no_database)
    app.add_exception_handler(Exception, _unexpected)
