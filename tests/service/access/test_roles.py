"""Every route of the OpenAPI document against every role: what a role does not hold is denied."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from fastapi import FastAPI

from service.access.needs import needs, rights
from service.access.principal import RIGHTS, Right, Role
from service.routes.openapi import RIGHT_KEY
from tests.service.access.signed_in import signed_in
from valve.errors import InternalError

OPEN = {("get", "/healthz"), ("post", "/session")}
# What changes something and is yet allowed to whoever may look: nothing of the plant changes.
HARMLESS = {("delete", "/session"), ("post", "/session/password")}


async def test_every_route_is_held_to_its_role(quick_path: Path) -> None:
    async with signed_in(quick_path, "admin") as served:
        viewer = served.tokens[Role.VIEWER]
        document = (await served.client.get("/openapi.json", headers=viewer)).json()
        asked = 0
        for path, operations in document["paths"].items():
            url = re.sub(r"{[^}]*}", "x", path)
            for method, operation in operations.items():
                if (method, path) in OPEN:
                    assert operation[RIGHT_KEY] is None
                    continue
                right = Right(operation[RIGHT_KEY])
                for role, headers in served.tokens.items():
                    if (method, path) == ("delete", "/session") and role is Role.ADMIN:
                        continue  # it would end the session that this test lives on
                    answer = await served.client.request(method, url, headers=headers)
                    where = f"{method} {path} as {role.value}: {answer.status_code}"
                    if right in RIGHTS[role]:
                        assert answer.status_code not in (401, 403), where
                    else:
                        assert answer.status_code == 403, where
                    assert answer.status_code < 500, where
                    asked += 1
                assert (await served.client.request(method, url)).status_code == 401, f"{method} {path} by nobody"
                assert {"401", "403"} <= operation["responses"].keys()
        assert asked > 80
        assert list(served.rig.orders) == []


async def test_what_changes_the_plant_needs_more_than_to_look(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        document = (await served.client.get("/openapi.json", headers=served.tokens[Role.VIEWER])).json()
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                if method != "get" and (method, path) not in OPEN | HARMLESS:
                    assert operation[RIGHT_KEY] not in (None, "view"), f"{method} {path}"
        assert document["paths"]["/tests/run"]["post"][RIGHT_KEY] == "run"
        assert document["paths"]["/tests/{test_id}/stop"]["post"][RIGHT_KEY] == "stop"


async def test_what_stands_beside_the_document_is_closed_too(quick_path: Path) -> None:
    async with signed_in(quick_path) as served:
        for path in ("/docs", "/openapi.json", "/metrics", "/nothing", "/users", "/tests/"):
            answer = await served.client.get(path)
            assert answer.status_code == 401, f"{path}: {answer.status_code} {answer.headers}"
        for path in ("/", "/ui/valves/FV-101"):
            answer = await served.client.get(path)
            assert (answer.status_code, answer.headers["location"][:17]) == (303, "/ui/sign-in?next="), path
        assert (await served.client.get("/healthz")).status_code == 200


def test_a_route_without_a_right_is_refused_at_the_start() -> None:
    app = FastAPI()

    @app.get("/bare")
    async def bare() -> None: ...

    with pytest.raises(InternalError, match="/bare"):
        list(rights(app))
    app = FastAPI()

    @app.get("/both", dependencies=[needs(Right.VIEW), needs(Right.RUN)])
    async def both() -> None: ...

    with pytest.raises(InternalError, match="/both"):
        list(rights(app))
