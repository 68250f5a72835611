"""``/session``, ``/users``, ``/tokens``: sign in and out, and what an admin does."""

from __future__ import annotations

import asyncio
from datetime import datetime, timedelta
from http import HTTPStatus
from typing import Annotated, Any, Final

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from service.access.access import Access
from service.access.authentication import cookie_name, session_secret
from service.access.needs import OPEN_TO_ALL, Asks, needs
from service.access.passwords import LONGEST as LONGEST_PASSWORD
from service.access.principal import RIGHTS, Principal, Right, Role
from service.access.tokens import Token
from service.access.users import User
from service.config.plant import Plant
from service.http.given import Given
from service.http.problems import PROBLEMS
from service.model.refusals import ForbiddenError
from service.model.requester import RequesterKind
from service.routes.json_body import JsonRoute
from service.routes.lists import KNOWN_KEYS
from valve.errors import NotFoundError
from valve.messages import say

session_router = APIRouter(prefix="/session", tags=["access"], responses=PROBLEMS, route_class=JsonRoute)
router = APIRouter(tags=["access"], responses=PROBLEMS, route_class=JsonRoute, dependencies=[needs(Right.ADMINISTER)])
_STRICT: Final = ConfigDict(extra="forbid", strict=True)
_Name = Annotated[str, Field(min_length=1, max_length=64)]
_Password = Annotated[str, Field(min_length=1, max_length=LONGEST_PASSWORD)]
_RoleName = Annotated[Role, Field(strict=False)]


class SignIn(BaseModel):
    """Who signs in."""

    model_config = _STRICT
    name: _Name
    password: _Password


class NewPassword(BaseModel):
    """A person's own new password."""

    model_config = _STRICT
    old: _Password
    new: _Password


class SessionView(BaseModel):
    """Who is signed in."""

    name: str
    role: Role
    kind: RequesterKind
    rights: list[Right]
    valves: list[str] | None = Field(description="what a token may move; null: all")
    csrf_token: str | None = Field(description="what a browser sends as X-CSRF-Token with whatever changes something")


class UserRequest(BaseModel):
    """A new user."""

    model_config = _STRICT
    name: _Name
    role: _RoleName
    password: _Password


class UserChange(BaseModel):
    """What of a user changes; their sessions end."""

    model_config = _STRICT
    role: _RoleName | None = None
    password: _Password | None = None
    disabled: bool | None = None


class UserView(BaseModel):
    """One user."""

    name: str
    role: Role
    created_at: datetime
    created_by: str
    disabled_at: datetime | None


class TokenRequest(BaseModel):
    """A new machine token."""

    model_config = _STRICT
    name: _Name
    role: _RoleName
    days: int = Field(ge=1, le=731)
    valves: list[_Name] | None = Field(default=None, min_length=1, max_length=1000, description="null: all")


class TokenView(BaseModel):
    """One token, without its secret."""

    id: str
    name: str
    role: Role
    valves: list[str] | None
    created_at: datetime
    created_by: str
    expires_at: datetime
    revoked_at: datetime | None
    last_used_at: datetime | None


class NewToken(TokenView):
    """A token with its secret, which is shown this once."""

    token: str


class UserList(BaseModel):
    """All users."""

    users: list[UserView]


class TokenList(BaseModel):
    """All tokens."""

    tokens: list[TokenView]


def _session(principal: Principal) -> SessionView:
    return SessionView(
        name=principal.name,
        role=principal.role,
        kind=principal.kind,
        rights=sorted(RIGHTS[principal.role]),
        valves=None if principal.valves is None else sorted(principal.valves),
        csrf_token=principal.csrf_token,
    )


def _address(request: Request) -> str:
    return "" if request.client is None else request.client.host


@session_router.post("", dependencies=[OPEN_TO_ALL])
async def sign_in(request: Request, response: Response, who: SignIn, access: Given[Access]) -> SessionView:
    """Sign in: the answer sets the session's cookie. It locks after 15 idle minutes and ends after 12 hours."""
    session = await access.sign_in(who.name, who.password, _address(request))
    encrypted = access.settings.encrypted
    response.set_cookie(
        cookie_name(encrypted), session.secret, path="/", httponly=True, samesite="strict", secure=encrypted
    )
    return _session(session.principal)


@session_router.get("", dependencies=[needs(Right.VIEW)])
async def who_am_i(asks: Asks) -> SessionView:
    """Say who is signed in, or whose token this is, and what that allows."""
    return _session(asks)


@session_router.delete("", status_code=HTTPStatus.NO_CONTENT, response_class=Response, dependencies=[needs(Right.VIEW)])
async def sign_out(request: Request, asks: Asks, access: Given[Access]) -> Response:
    """End the session of the cookie at once; without one nothing happens."""
    secret = session_secret(request.headers, access.settings.encrypted)
    if asks.kind is RequesterKind.PERSON:
        await asyncio.to_thread(access.sign_out, secret, asks.name)
    encrypted = access.settings.encrypted
    response = Response(status_code=HTTPStatus.NO_CONTENT)
    response.delete_cookie(cookie_name(encrypted), path="/", httponly=True, samesite="strict", secure=encrypted)
    return response


@session_router.post(
    "/password", status_code=HTTPStatus.NO_CONTENT, response_class=Response, dependencies=[needs(Right.VIEW)]
)
async def change_own_password(wanted: NewPassword, asks: Asks, access: Given[Access], request: Request) -> Response:
    """Change one's own password; all of one's sessions end, this one too."""
    if asks.kind is not RequesterKind.PERSON:
        raise NotFoundError(
            say("no_user_no_password", "{name} is no user, it has no password: sign in as one", name=asks.name)
        )
    user = await access.known(asks.name, wanted.old, _address(request))
    await asyncio.to_thread(access.change_user, user.name, by=user.name, password=wanted.new)
    return Response(status_code=HTTPStatus.NO_CONTENT)


def _user(user: User) -> UserView:
    return UserView(
        name=user.name,
        role=user.role,
        created_at=user.created_at,
        created_by=user.created_by,
        disabled_at=user.disabled_at,
    )


@router.get("/users", dependencies=[KNOWN_KEYS])
async def list_users(access: Given[Access]) -> UserList:
    """List all users."""
    return UserList(users=[_user(user) for user in await asyncio.to_thread(access.users.all)])


@router.post("/users", status_code=HTTPStatus.CREATED)
async def add_user(wanted: UserRequest, asks: Asks, access: Given[Access]) -> UserView:
    """Add a user."""
    return _user(await asyncio.to_thread(access.add_user, wanted.name, wanted.role, wanted.password, by=asks.name))


@router.patch("/users/{name}")
async def change_user(name: str, wanted: UserChange, asks: Asks, access: Given[Access]) -> UserView:
    """Change another user's role or password, disable or enable them; their sessions end at once."""
    if name == asks.name:
        raise ForbiddenError(
            say(
                "nobody_changes_themselves",
                "{name}: nobody changes themselves here: POST /session/password, or ask another admin",
                name=name,
            )
        )
    return _user(
        await asyncio.to_thread(
            access.change_user,
            name,
            by=asks.name,
            role=wanted.role,
            password=wanted.password,
            disabled=wanted.disabled,
        )
    )


@router.delete("/users/{name}", status_code=HTTPStatus.NO_CONTENT, response_class=Response)
async def remove_user(name: str, asks: Asks, access: Given[Access]) -> Response:
    """Remove another user: their sessions end at once, the audit log goes on naming them."""
    if name == asks.name:
        raise ForbiddenError(
            say("nobody_removes_themselves", "{name}: nobody removes themselves: ask another admin", name=name)
        )
    await asyncio.to_thread(access.remove_user, name, by=asks.name)
    return Response(status_code=HTTPStatus.NO_CONTENT)


def _token(token: Token) -> TokenView:
    return TokenView(**_token_fields(token))


def _token_fields(token: Token) -> dict[str, Any]:
    valves = None if token.valves is None else list(token.valves)
    return {name: getattr(token, name) for name in TokenView.model_fields} | {"valves": valves}


@router.get("/tokens", dependencies=[KNOWN_KEYS])
async def list_tokens(access: Given[Access]) -> TokenList:
    """List all tokens, those that are over too."""
    return TokenList(tokens=[_token(token) for token in await asyncio.to_thread(access.tokens.all)])


@router.post("/tokens", status_code=HTTPStatus.CREATED)
async def create_token(wanted: TokenRequest, asks: Asks, access: Given[Access], plant: Given[Plant]) -> NewToken:
    """Create a machine token. Its secret is in this answer and nowhere else."""
    unknown = sorted(set(wanted.valves or ()) - set(plant.valves))
    if unknown:
        raise NotFoundError(
            say("valve_of_token_unknown", "valve {tag} is unknown: GET /valves lists all", tag=repr(unknown[0]))
        )
    token, secret = await asyncio.to_thread(
        access.create_token,
        wanted.name,
        wanted.role,
        by=asks.name,
        lasts=timedelta(days=wanted.days),
        valves=wanted.valves,
    )
    return NewToken(**_token_fields(token), token=secret)


@router.delete("/tokens/{token_id}")
async def revoke_token(token_id: str, asks: Asks, access: Given[Access]) -> TokenView:
    """End a token at once."""
    return _token(await asyncio.to_thread(access.revoke_token, token_id, by=asks.name))
