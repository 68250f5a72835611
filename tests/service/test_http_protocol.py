"""HTTP on the wire of a service that really listens."""

from __future__ import annotations

import asyncio
from pathlib import Path

from service.http_protocol import LONGEST_HEAD_BYTES
from service.settings import load_plant
from tests.service.fake_rig import FakeAnalyst, FakeRig
from tests.service.running_service import running_service


async def test_a_head_that_never_ends_is_refused_and_a_long_one_is_answered(plant_file: Path) -> None:
    async with running_service(load_plant(plant_file), FakeRig(), FakeAnalyst()) as client:
        long = await client.get("/healthz", headers={"X-Long": "a" * (LONGEST_HEAD_BYTES // 2)})
        assert long.status_code == 200
        reader, writer = await asyncio.open_connection("127.0.0.1", client.base_url.port)
        writer.write(b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Endless: ")
        async with asyncio.timeout(20.0):
            for _ in range(LONGEST_HEAD_BYTES // 4096):
                writer.write(b"a" * 4096)
                await writer.drain()
            assert (await reader.readline()).startswith(b"HTTP/1.1 400 ")
        writer.close()


async def test_a_second_request_has_a_head_of_its_own(plant_file: Path) -> None:
    async with running_service(load_plant(plant_file), FakeRig(), FakeAnalyst()) as client:
        for _ in range(3):
            answer = await client.get("/healthz", headers={"X-Long": "a" * (LONGEST_HEAD_BYTES // 2)})
            assert answer.status_code == 200
