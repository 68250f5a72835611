from __future__ import annotations

from dataclasses import replace
from datetime import timedelta

import pytest
from sqlalchemy import Engine, select

from service.access.principal import RIGHTS, Principal, Right, Role
from service.access.sessions import Sessions
from service.access.throttle import MOST_BY_ADDRESS, MOST_BY_BOTH, WINDOW_S, Throttle
from service.access.tokens import Tokens
from service.access.users import Users
from service.model.refusals import ThrottledError
from service.model.requester import Requester, RequesterKind
from service.store.database import open_database
from service.store.schema_access import SESSIONS, TOKENS, USERS
from tests.service.access.conftest import Clock
from valve.errors import BusyError, NotFoundError, RequestError

PASSWORD = "stem packing seat 7"


@pytest.fixture
def users(engine: Engine, clock: Clock) -> Users:
    users = Users(engine, clock)
    users.add("anna", Role.OPERATOR, PASSWORD, by="root")
    return users


def test_a_user_signs_in_with_their_own_password_alone(users: Users) -> None:
    found = users.with_password("anna", PASSWORD)
    assert found is not None
    assert (found.name, found.role, found.created_by) == ("anna", Role.OPERATOR, "root")
    assert users.with_password("anna", PASSWORD + " ") is None
    assert users.with_password("otto", PASSWORD) is None
    users.change("anna", disabled=True)
    assert users.with_password("anna", PASSWORD) is None
    users.change("anna", disabled=False, password="another one, longer")
    assert users.with_password("anna", PASSWORD) is None
    assert users.with_password("anna", "another one, longer") is not None


@pytest.mark.parametrize(
    ("name", "role", "password", "part"),
    [
        ("otto", Role.VIEWER, "short", "12 to 256"),
        ("otto", Role.VIEWER, "aaaaaaaaaaaaaaaa", "guessed"),
        ("otto", Role.VIEWER, "ottoottootto123456", "guessed"),
        ("otto", Role.SCHEDULER, PASSWORD, "scheduler"),
        ("otto", Role.LOCAL, PASSWORD, "local"),
        ("local", Role.VIEWER, PASSWORD, "local"),
        ("", Role.VIEWER, PASSWORD, "1 to 63"),
        ("a b", Role.VIEWER, PASSWORD, "a b"),
        ("x" * 64, Role.VIEWER, PASSWORD, "1 to 63"),
    ],
)
def test_a_user_that_cannot_be_is_refused_with_the_remedy(
    users: Users, name: str, role: Role, password: str, part: str
) -> None:
    with pytest.raises(RequestError, match=part):
        users.add(name, role, password, by="root")
    assert [user.name for user in users.all()] == ["anna"]


def test_a_name_is_given_once_and_an_unknown_one_is_said_so(users: Users) -> None:
    with pytest.raises(BusyError, match="anna exists"):
        users.add("anna", Role.ADMIN, PASSWORD, by="root")
    for name in ("otto", "a\0b", "\udc80", "Anna"):
        with pytest.raises(NotFoundError):
            users.change(name, disabled=True)
        assert users.with_password(name, PASSWORD) is None


def test_accounts_work_on_every_kind_of_store(database_url: str, clock: Clock) -> None:
    engine = open_database(database_url)
    users, sessions, tokens = Users(engine, clock), Sessions(engine, clock), Tokens(engine, clock)
    anna = users.add("anna", Role.OPERATOR, PASSWORD, by="root")
    with pytest.raises(BusyError):
        users.add("anna", Role.ADMIN, PASSWORD, by="root")
    for unknown in ("a\0b", "\udc80"):
        assert users.with_password(unknown, PASSWORD) is None
        with pytest.raises(NotFoundError):
            tokens.revoke(unknown)
    secret = sessions.begin(anna, "127.0.0.1").secret
    clock.move(minutes=14)
    assert sessions.principal(secret) is not None
    clock.move(minutes=14)
    assert sessions.principal(secret) is not None
    users.change("anna", disabled=True)
    assert sessions.principal(secret) is None
    token, secret = tokens.create("cmms", Role.VIEWER, by="root", lasts=timedelta(days=1), valves=["FV-101"])
    assert tokens.principal(secret)[0] is not None
    assert tokens.revoke(token.id).revoked_at == clock()
    assert tokens.principal(secret)[0] is None
    engine.dispose()


def test_neither_password_nor_secret_stands_in_the_database(users: Users, engine: Engine, clock: Clock) -> None:
    session = Sessions(engine, clock).begin(users.get("anna"), "127.0.0.1")
    _, secret = Tokens(engine, clock).create("cmms", Role.VIEWER, by="root", lasts=timedelta(days=1))
    with engine.connect() as connection:
        stored = "".join(
            str(row) for table in (USERS, SESSIONS, TOKENS) for row in connection.execute(select(table)).all()
        )
    assert "$argon2id$" in stored
    for hidden in (PASSWORD, session.secret, secret, secret[10:]):
        assert hidden not in stored
    assert session.secret not in repr(session.principal)


def test_a_session_locks_after_15_idle_minutes_and_lives_on_while_it_is_used(
    users: Users, engine: Engine, clock: Clock
) -> None:
    sessions = Sessions(engine, clock)
    secret = sessions.begin(users.get("anna"), "127.0.0.1").secret
    for _ in range(6):
        clock.move(minutes=14)
        assert sessions.principal(secret) is not None
    principal = sessions.principal(secret)
    assert principal is not None
    assert principal.requester == Requester("anna", RequesterKind.PERSON)
    clock.move(minutes=14)
    assert sessions.principal(secret, active=False) is not None
    clock.move(minutes=1)
    assert sessions.principal(secret) is None, "a page that refreshes itself keeps nothing open"


def test_a_session_ends_after_a_shift_however_busy(users: Users, engine: Engine, clock: Clock) -> None:
    sessions = Sessions(engine, clock)
    secret = sessions.begin(users.get("anna"), "127.0.0.1").secret
    for _ in range(72):
        assert sessions.principal(secret) is not None
        clock.move(minutes=10)
    assert sessions.principal(secret) is None


def test_a_session_ends_at_once_when_it_is_left_or_its_user_is_changed(
    users: Users, engine: Engine, clock: Clock
) -> None:
    sessions = Sessions(engine, clock)
    anna = users.get("anna")
    secret = sessions.begin(anna, "127.0.0.1").secret
    other = sessions.begin(anna, "127.0.0.1").secret
    sessions.end(secret)
    assert sessions.principal(secret) is None
    assert sessions.principal(other) is not None
    users.change("anna", role=Role.VIEWER)
    assert sessions.principal(other) is None
    assert sessions.principal("guess") is None


def test_two_sessions_have_two_csrf_tokens(users: Users, engine: Engine, clock: Clock) -> None:
    sessions = Sessions(engine, clock)
    first, second = (sessions.begin(users.get("anna"), "x") for _ in range(2))
    again = sessions.principal(first.secret)
    assert again == first.principal
    assert first.principal.csrf_token != second.principal.csrf_token


def test_a_token_works_until_it_expires_or_is_revoked(engine: Engine, clock: Clock) -> None:
    tokens = Tokens(engine, clock)
    token, secret = tokens.create(
        "cmms", Role.OPERATOR, by="root", lasts=timedelta(days=90), valves=["FV-102", "FV-101"]
    )
    principal, _ = tokens.principal(secret)
    assert principal is not None
    assert (principal.name, principal.kind, principal.csrf_token) == ("cmms", RequesterKind.MACHINE, None)
    assert principal.valves == frozenset({"FV-101", "FV-102"})
    assert principal.may(Right.RUN)
    assert tokens.get(token.id).last_used_at == clock()
    clock.move(days=90)
    gone, why = tokens.principal(secret)
    assert gone is None
    assert "expired" in why
    token, secret = tokens.create("cmms", Role.VIEWER, by="root", lasts=timedelta(days=1))
    tokens.revoke(token.id)
    gone, why = tokens.principal(secret)
    assert gone is None
    assert "revoked" in why
    assert secret not in why
    for guess in ("", "breakaway_", secret[:-1], secret[:-1] + "é", "breakaway_" + "A" * 43):
        assert tokens.principal(guess)[0] is None


@pytest.mark.parametrize(
    ("role", "days", "part"), [(Role.ADMIN, 1, "admin"), (Role.VIEWER, 0, "0 days"), (Role.VIEWER, 800, "731")]
)
def test_a_token_that_cannot_be_is_refused(engine: Engine, clock: Clock, role: Role, days: int, part: str) -> None:
    tokens = Tokens(engine, clock)
    with pytest.raises(RequestError, match=part):
        tokens.create("cmms", role, by="root", lasts=timedelta(days=days))
    assert tokens.all() == []


def test_failed_sign_ins_are_slowed_down_by_name_and_by_address() -> None:
    now_s = 0.0
    throttle = Throttle(lambda: now_s)
    for _ in range(MOST_BY_BOTH):
        throttle.check("anna", "10.0.0.1")
        throttle.failed("anna", "10.0.0.1")
    with pytest.raises(ThrottledError, match="15 minutes"):
        throttle.check("Anna", "10.0.0.1")
    throttle.check("anna", "10.0.0.2")
    throttle.check("otto", "10.0.0.1")
    for number in range(MOST_BY_ADDRESS - MOST_BY_BOTH):
        throttle.failed(f"user{number}", "10.0.0.1")
    with pytest.raises(ThrottledError) as caught:
        throttle.check("otto", "10.0.0.1")
    assert caught.value.retry_after_s == pytest.approx(WINDOW_S)
    now_s = WINDOW_S + 1.0
    throttle.check("anna", "10.0.0.1")


def test_a_sign_in_that_succeeds_clears_the_failures_of_its_name() -> None:
    throttle = Throttle(lambda: 0.0)
    for _ in range(MOST_BY_BOTH - 1):
        throttle.failed("anna", "10.0.0.1")
    throttle.succeeded("anna", "10.0.0.1")
    throttle.failed("anna", "10.0.0.1")
    throttle.check("anna", "10.0.0.1")


def test_a_token_for_some_valves_starts_no_schedule() -> None:
    engineer = Principal("x", Role.ENGINEER, RequesterKind.MACHINE)
    assert engineer.may(Right.SCHEDULE)
    assert not replace(engineer, valves=frozenset({"FV-101"})).may(Right.SCHEDULE)


def test_every_role_may_stop_and_an_admin_moves_nothing() -> None:
    assert all(Right.STOP in rights for rights in RIGHTS.values())
    assert Right.RUN not in RIGHTS[Role.ADMIN]
    assert Right.ADMINISTER not in RIGHTS[Role.LOCAL]
    assert RIGHTS.keys() == set(Role)
