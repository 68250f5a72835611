"""``needs(Right.RUN)``: the dependency that every route carries; the application refuses to start without it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Final

from fastapi import Depends, FastAPI, Request
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, iter_route_contexts

from service.access.principal import RIGHTS, Principal, Right
from service.model.refusals import ForbiddenError, NotSignedInError
from valve.errors import InternalError
from valve.messages import say


@dataclass(frozen=True, slots=True)
class Needs:
    """Lets a request through whose principal holds ``right``; None lets everybody through."""

    right: Right | None

    async def __call__(self, request: Request) -> Principal | None:  # a function would be called in a thread
        """Return who asks. Raises NotSignedInError, ForbiddenError."""
        principal: Principal | None = getattr(request.state, "principal", None)
        if self.right is None:
            return principal
        if principal is None:
            raise NotSignedInError(
                say(
                    "not_signed_in",
                    "{path} needs the right to {right} and nobody is signed in: POST /session, or send "
                    "Authorization: Bearer TOKEN",
                    path=request.url.path,
                    right=self.right.value,
                )
            )
        if not principal.may(self.right):
            allowed = ", ".join(role.value for role, rights in RIGHTS.items() if self.right in rights)
            raise ForbiddenError(
                say(
                    "right_missing",
                    "{name} is {role}, {method} {path} needs the right to {right}: ask somebody who is one of "
                    "{allowed}",
                    name=principal.name,
                    role=principal.role.value,
                    method=request.method,
                    path=request.url.path,
                    right=self.right.value,
                    allowed=allowed,
                )
            )
        return principal


def needs(right: Right) -> Any:
    """Return the dependency for a route: ``@router.get("", dependencies=[needs(Right.VIEW)])``."""
    return Depends(Needs(right))


#: For the few routes that answer anybody: liveness and sign-in.
OPEN_TO_ALL: Final = Depends(Needs(None))


async def principal_of(request: Request) -> Principal:
    """Return who asks, on a route that needs a right."""
    principal = request.state.principal
    assert isinstance(principal, Principal)
    return principal


Asks = Annotated[Principal, Depends(principal_of)]


def require_covers(principal: Principal, tag: str) -> None:
    """Raise ForbiddenError where the caller's token is limited to other valves."""
    if principal.valves is not None and tag not in principal.valves:
        raise ForbiddenError(
            say(
                "token_for_other_valves",
                "{tag}: the token of {name} is for other valves: ask for one that names it",
                tag=tag[:64],
                name=principal.name,
            )
        )


def _needed(dependant: Dependant) -> Iterator[Needs]:
    for inner in dependant.dependencies:
        if isinstance(inner.call, Needs):
            yield inner.call
        yield from _needed(inner)


def rights(app: FastAPI) -> Iterator[tuple[str, str, Right | None]]:
    """Return path, method and right of every documented route; None where it answers anybody.

    Raises InternalError where a route says nothing, or two things: then nothing is served.
    """
    for route in iter_route_contexts(app.routes):
        if not isinstance(route.original_route, APIRoute) or not route.include_in_schema:
            continue
        found = set(_needed(route.dependant))
        if len(found) != 1:
            raise InternalError(
                say(
                    "route_needs_one_right",
                    "{path}: it needs {count} rights, a route needs one: add needs(Right...)",
                    path=str(route.path_format),
                    count=len(found),
                )
            )
        right = found.pop().right
        for method in route.methods or ():
            yield route.path_format or "", method.lower(), right
