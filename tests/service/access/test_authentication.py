"""Sessions, tokens and pages of other sites, over a socket."""

from __future__ import annotations

import asyncio
import socket
from datetime import timedelta
from pathlib import Path

import httpx
import pytest
import time_machine

from service.access.principal import Role
from service.audit.verify import Verdict, entries_of, verify
from service.cli.accounts import accounts
from service.config.settings import load_plant
from tests.service.access.signed_in import PASSWORD, Served, body_of, signed_in
from tests.service.conftest import PLANT
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.in_process import app_of
from tests.support.problem import assert_problem
from tests.support.running_service import running_application, running_service

RUN = {"valve": "FV-101"}


def events(served: Served) -> list[str]:
    """Events in the audit log, which must be whole."""
    (path,) = (served.config.parent / "plant-data" / "audit").iterdir()
    assert verify(path).verdict is Verdict.WHOLE
    return [entry.event for entry in entries_of(path)]


async def test_a_person_signs_in_runs_a_test_and_signs_out(quick_path: Path) -> None:
    async with signed_in(quick_path, "operator") as served:
        client = served.client
        answer = await served.sign_in("operator")
        me = body_of(answer)
        assert (me["name"], me["role"], "run" in me["rights"]) == ("operator", "operator", True)
        cookie = answer.headers["set-cookie"]
        assert all(part in cookie for part in ("HttpOnly", "SameSite=strict", "Path=/"))
        assert PASSWORD not in answer.text
        assert body_of(await client.get("/session")) == me
        assert_problem(await client.post("/tests/run", json=RUN), 403, "X-CSRF-Token")
        assert_problem(await client.post("/tests/run", json=RUN, headers={"X-CSRF-Token": "x"}), 403, "X-CSRF-Token")
        own = {"X-CSRF-Token": me["csrf_token"]}
        other = {**own, "Origin": "http://evil.example"}
        assert_problem(await client.post("/tests/run", json=RUN, headers=other), 403, "another site")
        assert served.rig.orders == []
        own["Origin"] = str(client.base_url).rstrip("/")
        test = body_of(await client.post("/tests/run", json=RUN, headers={**own, "Prefer": "wait=10"}))
        assert test["state"] == "completed"
        with_overrides = {**RUN, "overrides": {"cycles": 2}}
        assert_problem(await client.post("/tests/run", json=with_overrides, headers=own), 403, "engineer")
        assert (await client.delete("/session", headers=own)).status_code == 204
        assert_problem(await client.get("/tests"), 401)
        assert {"session.began", "session.ended"} <= set(events(served))
    assert (events(served)[-1], events(served).count("service.started")) == ("service.ended", 1)


async def test_wrong_passwords_are_slowed_down_and_told_alike(quick_path: Path) -> None:
    async with signed_in(quick_path, "viewer") as served:
        wrong = {"name": "viewer", "password": "wrong"}
        first = await served.client.post("/session", json=wrong)
        unknown = await served.client.post("/session", json={**wrong, "name": "nobody"})
        assert_problem(first, 401, "wrong")
        assert first.json()["detail"] == unknown.json()["detail"]
        answers = await asyncio.gather(*(served.client.post("/session", json=wrong) for _ in range(8)))
        assert sorted(answer.status_code for answer in answers) == [401] * 4 + [429] * 4
        refused = await served.sign_in("viewer")
        assert_problem(refused, 429, "wait")
        assert 800 < int(refused.headers["retry-after"]) <= 900
        assert events(served).count("session.refused") == 6


async def test_a_tablet_that_loses_its_session_in_mid_test_leaves_the_test_running(quick_path: Path) -> None:
    async with signed_in(quick_path, "operator", rig_s=1.0) as served:
        me = body_of(await served.sign_in("operator"))
        test = body_of(await served.client.post("/tests/run", json=RUN, headers={"X-CSRF-Token": me["csrf_token"]}))
        with accounts(served.config) as (access, _):
            access.change_user("operator", by="test", disabled=True)
        assert_problem(await served.client.get(test["href"]), 401, "goes on")
        viewer = served.tokens[Role.VIEWER]
        async with asyncio.timeout(15.0):
            while (state := (await served.client.get(test["href"], headers=viewer)).json()["state"]) != "completed":
                assert state in ("queued", "running", "analyzing")
                await asyncio.sleep(0.05)


async def test_a_token_that_expired_or_was_revoked_ends_here_and_nothing_moves(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        with accounts(served.config) as (access, _):
            token, secret = access.create_token(
                "cmms", Role.OPERATOR, by="test", lasts=timedelta(days=1), valves=["FV-101"]
            )
        headers = {"Authorization": f"Bearer {secret}"}
        assert_problem(await served.client.post("/tests/run", json={"valve": "FV-102"}, headers=headers), 403, "FV-102")
        assert_problem(await served.client.post("/tests/run", json={"valve": "FV-9"}, headers=headers), 403)
        other = {"Prefer": "wait=10", **served.tokens[Role.ENGINEER]}
        test = body_of(await served.client.post("/tests/run", json={"valve": "FV-102"}, headers=other))
        acknowledge = f"{test['href']}/acknowledge"
        assert_problem(await served.client.post(acknowledge, json={"note": "x"}, headers=headers), 403, "FV-102")
        served.rig.orders.clear()
        with time_machine.travel(token.expires_at + timedelta(seconds=1), tick=True):
            answer = await served.client.post("/tests/run", json=RUN, headers=headers)
        assert_problem(answer, 401, "expired", "create another")
        assert answer.headers["www-authenticate"] == "Bearer"
        assert secret not in answer.text
        with accounts(served.config) as (access, _):
            access.revoke_token(token.id, by="test")
        assert_problem(await served.client.post("/tests/run", json=RUN, headers=headers), 401, "revoked")
        for scheme in ("Basic eDp5", "Bearer", "Bearer x y", ""):
            assert_problem(await served.client.get("/tests", headers={"Authorization": scheme}), 401)
        assert served.rig.orders == []


async def test_operators_run_approved_sequences_and_engineers_any(quick_path: Path) -> None:
    async with signed_in(quick_path, more='approved_sequences = ["triangle"]') as served:
        sine = {"valve": "FV-101", "sequence": "sine"}
        for role in (Role.OPERATOR, Role.SCHEDULER):
            answer = await served.client.post("/tests/run", json=sine, headers=served.tokens[role])
            assert_problem(answer, 403, "sine", "triangle")
            assert_problem(await served.client.post("/tests/run", json=RUN, headers=served.tokens[role]), 403)
        assert served.rig.orders == []
        engineer = {**served.tokens[Role.ENGINEER], "Prefer": "wait=10"}
        assert body_of(await served.client.post("/tests/run", json=sine, headers=engineer))["state"] == "completed"


async def test_an_admin_adds_a_user_and_a_token_over_rest_and_ends_them(quick_path: Path) -> None:
    async with signed_in(quick_path, "admin") as served:
        admin = served.tokens[Role.ADMIN]
        user = {"name": "otto", "role": "viewer", "password": PASSWORD}
        created = await served.client.post("/users", json=user, headers=admin)
        assert created.status_code == 201
        assert PASSWORD not in created.text
        assert "argon2" not in (await served.client.get("/users", headers=admin)).text
        assert_problem(await served.client.post("/users", json=user, headers=admin), 409, "otto")
        otto = await served.sign_in("otto")
        assert otto.status_code == 200
        changed = await served.client.patch("/users/otto", json={"disabled": True}, headers=admin)
        assert body_of(changed)["disabled_at"] is not None
        assert_problem(await served.client.get("/tests"), 401)
        await served.client.patch("/users/otto", json={"disabled": False}, headers=admin)
        assert (await served.sign_in("otto")).status_code == 200
        assert (await served.client.delete("/users/otto", headers=admin)).status_code == 204
        assert_problem(await served.client.get("/tests"), 401)
        assert (await served.sign_in("otto")).status_code == 401
        assert_problem(await served.client.delete("/users/otto", headers=admin), 404, "otto")
        assert_problem(await served.client.delete("/users/admin", headers=admin), 403, "another admin")
        served.client.cookies.clear()
        wanted = {"name": "cmms", "role": "viewer", "days": 1}
        token = body_of(await served.client.post("/tokens", json=wanted, headers=admin))
        headers = {"Authorization": f"Bearer {token['token']}"}
        assert body_of(await served.client.get("/session", headers=headers))["name"] == "cmms"
        assert token["token"] not in (await served.client.get("/tokens", headers=admin)).text
        assert body_of(await served.client.delete(f"/tokens/{token['id']}", headers=admin))["revoked_at"] is not None
        assert_problem(await served.client.get("/session", headers=headers), 401)
        assert_problem(
            await served.client.post("/tokens", json={**wanted, "role": "admin"}, headers=admin), 422, "admin"
        )
        assert_problem(await served.client.post("/tests/run", json=RUN, headers=admin), 403, "admin")
        demoted = await served.client.patch("/users/admin", json={"role": "viewer"}, headers=admin)
        assert_problem(demoted, 403, "another admin")
        assert set(events(served)) >= {"user.added", "user.changed", "user.removed", "token.created", "token.revoked"}


async def test_a_person_changes_their_own_password(quick_path: Path) -> None:
    async with signed_in(quick_path, "viewer") as served:
        me = body_of(await served.sign_in("viewer"))
        own = {"X-CSRF-Token": me["csrf_token"]}
        wrong = {"old": "wrong", "new": "another one, longer"}
        assert_problem(await served.client.post("/session/password", json=wrong, headers=own), 401)
        right = {**wrong, "old": PASSWORD}
        assert (await served.client.post("/session/password", json=right, headers=own)).status_code == 204
        assert_problem(await served.client.get("/session"), 401)
        assert_problem(await served.sign_in("viewer"), 401)


HOSTS = [
    "evil.example",
    "10.0.0.5:8321",
    "",
    "[",
    "[::1",
    "localhost:x",
    "a b",
    "localhost.evil.example",
    "http://[",
    "\xff",
]


@pytest.mark.parametrize("host", HOSTS)
async def test_a_foreign_or_malformed_name_of_this_machine_is_refused(
    open_client: httpx.AsyncClient, host: str
) -> None:
    for path in ("/valves", "/healthz", "/ui/sign-in"):
        answer = await open_client.get(path, headers={b"Host": host.encode("latin-1")})
        assert_problem(answer, 400, "service.allowed_hosts")
    answer = await open_client.post("/tests/run", json=RUN, headers={b"Host": host.encode("latin-1")})
    assert_problem(answer, 400, "Host")


async def test_a_page_whose_name_was_pointed_here_moves_nothing_on_a_trusted_network(quick_path: Path) -> None:
    config = quick_path / "plant.toml"
    more = (
        'port = 0\naccess = "open"\ntrusted_network = true\nallowed_hosts = ["valves.example.org", "*.plant.example"]'
    )
    text = PLANT.replace('bind = "127.0.0.1"', 'bind = "0.0.0.0"')
    config.write_text(text.replace("port = 0", more, 1), encoding="utf-8")
    rig = FakeRig()
    async with running_service(load_plant(config), rig, FakeAnalyst()) as client:
        for host in ("evil.example:8321", socket.gethostname(), "plant.example"):
            rebound = {"Host": host, "Origin": f"http://{host}"}
            assert_problem(await client.post("/tests/run", json=RUN, headers=rebound), 400, "Host")
        assert rig.orders == []
        for host in ("valves.example.org", "A.plant.example:8321", "localhost", "127.0.0.1:9", "[::1]:8321"):
            own = {"Host": host, "Origin": f"http://{host}", "Prefer": "wait=10"}
            assert body_of(await client.post("/tests/run", json=RUN, headers=own))["state"] == "completed", host


async def test_by_default_it_answers_to_its_address_and_the_machines_own_name(quick_path: Path) -> None:
    config = quick_path / "plant.toml"
    config.write_text(PLANT.replace('bind = "127.0.0.1"', 'bind = "127.0.0.2"'), encoding="utf-8")
    app = app_of(load_plant(config), rig=FakeRig(), analyst=FakeAnalyst())
    async with running_application(app, bind="127.0.0.2") as client:
        assert client.base_url.host == "127.0.0.2"
        assert (await client.get("/healthz")).status_code == 200
        for host in (socket.gethostname(), "localhost"):
            assert (await client.get("/healthz", headers={"Host": host})).status_code == 200
        assert_problem(await client.get("/healthz", headers={"Host": "127.0.0.3"}), 400, "Host")


@pytest.mark.parametrize("origin", ["[", "http://[", "http://", "x", "http://h:99999999", "http://h:x", "", "//h"])
async def test_a_malformed_origin_is_a_bad_request(open_client: httpx.AsyncClient, origin: str) -> None:
    assert_problem(await open_client.post("/tests/run", json=RUN, headers={"Origin": origin}), 400, "Origin")


async def test_without_sign_in_a_page_of_another_site_moves_nothing(open_client: httpx.AsyncClient) -> None:
    for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
        assert_problem(await open_client.post("/tests/run", json=RUN, headers=headers), 403, "another site")
    assert (await open_client.get("/tests")).json()["tests"] == []
    me = body_of(await open_client.get("/session"))
    assert (me["name"], "run" in me["rights"], "administer" in me["rights"]) == ("local", True, False)
    assert_problem(await open_client.get("/users"), 403, "admin")


async def test_a_refusal_is_data_and_a_page_reads_it_in_its_language(open_client: httpx.AsyncClient) -> None:
    german = {"Breakaway-Units": "bar", "Accept-Language": "de", "Origin": "http://evil.example"}
    refused = (await open_client.post("/tests/run", json=RUN, headers=german)).json()
    assert refused["message"]["code"] == "page_of_another_site"
    assert "einer anderen Website" in refused["shown"]
    assert "another site" in refused["detail"]
    for headers, code in (
        ({"Host": "evil.example"}, "host_not_ours"),
        ({"Authorization": "Basic x"}, "no_bearer_token"),
        ({"Origin": "nothing"}, "no_origin"),
    ):
        refused = (await open_client.post("/tests/run", json=RUN, headers=headers)).json()
        assert refused["message"]["code"] == code, refused
        assert "shown" not in refused


async def test_every_answer_says_that_it_is_for_nobody_else(open_client: httpx.AsyncClient) -> None:
    headers = (await open_client.get("/valves")).headers
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["x-frame-options"] == "DENY"
    assert headers["cache-control"] == "no-store"
    assert "default-src 'none'" in headers["content-security-policy"]
