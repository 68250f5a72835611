"""Who looks at a page, and what the pages offer them."""

from __future__ import annotations

from dataclasses import dataclass
from urllib.parse import quote

from fastapi import Request

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
