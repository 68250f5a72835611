"""A service that wants sign-in, with a user and a token of each role."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx

from service.access.principal import Role
from service.access.tokens import TOKEN_ROLES
from service.cli.accounts import accounts
from service.config.settings import load_plant
from tests.service.conftest import PLANT
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import NO_TLS, running_service

PASSWORD = "stem packing seat 7"


@dataclass(frozen=True)
class Served:
    """A client without credentials, the headers of each role, and the folder of the plant."""

    client: httpx.AsyncClient
    tokens: Mapping[Role, dict[str, str]]
    rig: FakeRig
    config: Path

    async def sign_in(self, name: str, **headers: str) -> httpx.Response:
        """Sign in; the cookie stays in the client."""
        body = {"name": name, "password": PASSWORD}
        return await self.client.post("/session", json=body, headers=headers)


@asynccontextmanager
async def signed_in(folder: Path, *users: str, more: str = "", rig_s: float = 0.05) -> AsyncIterator[Served]:
    """Serve a plant with sign-in. ``users`` are roles: each gets a user of its name; tokens are made of all."""
    config = folder / "plant.toml"
    config.write_text(PLANT.replace("port = 0", f'port = 0\naccess = "sign-in"\n{more}'), encoding="utf-8")
    tokens = {}
    with accounts(config) as (access, _):
        for role in TOKEN_ROLES:
            _, secret = access.create_token(f"a-{role.value}", role, by="test", lasts=timedelta(days=1), valves=None)
            tokens[role] = {"Authorization": f"Bearer {secret}"}
        for name in users:
            access.add_user(name, Role(name), PASSWORD, by="test")
    rig = FakeRig(rig_s)
    async with running_service(load_plant(config), rig, FakeAnalyst()) as client:
        if "admin" in users:
            async with httpx.AsyncClient(base_url=client.base_url, timeout=60.0, verify=NO_TLS) as other:
                answer = await other.post("/session", json={"name": "admin", "password": PASSWORD})
                cookie = f"breakaway={answer.cookies['breakaway']}"
                tokens[Role.ADMIN] = {"Cookie": cookie, "X-CSRF-Token": answer.json()["csrf_token"]}
        yield Served(client, tokens, rig, config)


def body_of(answer: httpx.Response) -> Any:
    """Return the JSON of an answer that is no error."""
    assert answer.is_success, answer.text
    return answer.json()
