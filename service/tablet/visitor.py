"""Who looks at a page, and what the pages offer them."""

from __future__ import annotations

from dataclasses import dataclass
from http import HTTPStatus
from typing import Annotated
from urllib.parse import quote

from fastapi import Depends, Request
from fastapi.responses import RedirectResponse, Response

from service.access.principal import Principal, Right, Role


@dataclass(frozen=True, slots=True)
class Visitor:
    """The person of a request: a name, what they may do, and the token that their actions carry."""

    name: str
    is_signed_in: bool
    may_run: bool
    may_acknowledge: bool
    may_analyze: bool
    may_configure: bool
    csrf_token: str


def visitor_of(request: Request) -> Visitor | None:
    """Return who asks; None where they must sign in before they see anything."""
    principal: Principal | None = getattr(request.state, "principal", None)
    if principal is None or not principal.may(Right.VIEW):
        return None
    return Visitor(
        principal.name,
        principal.role is not Role.LOCAL,
        principal.may(Right.RUN),
        principal.may(Right.ACKNOWLEDGE),
        principal.may(Right.ANALYZE),
        principal.may(Right.CONFIGURE),
        principal.csrf_token or "",
    )


def sign_in_address(request: Request) -> str:
    """Return the address of the sign-in page, which leads back here afterwards."""
    return f"/ui/sign-in?next={quote(request.url.path)}"


class SignInNeededError(Exception):
    """Nobody is signed in: the page of signing in is shown instead."""


async def _visitor(request: Request) -> Visitor:
    visitor = visitor_of(request)
    if visitor is None:
        raise SignInNeededError
    return visitor


VisitorOf = Annotated[Visitor, Depends(_visitor)]


async def to_sign_in(request: Request, _error: Exception) -> Response:
    """Send whoever is not signed in to the page where they can."""
    return RedirectResponse(sign_in_address(request), HTTPStatus.SEE_OTHER)
