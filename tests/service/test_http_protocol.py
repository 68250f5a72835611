"""HTTP on the wire of a service that really listens."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path

import httpx
import pytest

from service.config.settings import load_plant
from service.http.http_protocol import LONGEST_HEAD_BYTES, MOST_CONNECTIONS, BoundedHttp, most_connections
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import NO_TLS, running_service


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


async def _closed(reader: asyncio.StreamReader, within_s: float = 10.0) -> bytes:
    async with asyncio.timeout(within_s):
        try:
            return await reader.read()
        except ConnectionResetError:
            return b""


SLOW = {
    "nothing": b"",
    "half a head": b"GET /healthz HTTP/1.1\r\nHost: 127",
    "after an answer": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
    "after an answer, half a head": b"GET /healthz HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET /he",
    "a body that nobody reads": b"POST /tests/run HTTP/1.1\r\nHost: evil\r\nContent-Length: 900\r\n\r\n",
}


@pytest.mark.parametrize("begin", SLOW.values(), ids=SLOW.keys())
@pytest.mark.parametrize("drip", [b"", b"\r\n", b"x"])
async def test_who_sends_a_head_slowly_or_none_at_all_is_cut_and_others_are_answered(
    plant_file: Path, monkeypatch: pytest.MonkeyPatch, begin: bytes, drip: bytes
) -> None:
    monkeypatch.setattr(BoundedHttp, "head_limit_s", 0.3)
    async with running_service(load_plant(plant_file), FakeRig(), FakeAnalyst()) as client:
        reader, writer = await asyncio.open_connection("127.0.0.1", client.base_url.port)
        writer.write(begin)

        async def dripping() -> None:
            while drip:
                writer.write(drip)
                await asyncio.sleep(0.05)

        slow = asyncio.create_task(dripping())
        try:
            said = await _closed(reader)
        finally:
            slow.cancel()
            writer.close()
        if begin.endswith((b"127", b"/he")) and drip != b"\r\n":
            assert b"408 Request Timeout" in said
        assert (await client.get("/healthz")).status_code == 200


POST = b"POST /tests/run HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 900\r\n\r\n"
CROWDS = {"silent": b"", "half a head": POST[:60], "no body": POST, "half a body": POST + b"{"}


@pytest.mark.parametrize("says", CROWDS.values(), ids=CROWDS.keys())
async def test_a_crowd_that_completes_no_request_keeps_neither_files_nor_a_stop_from_anybody(
    plant_file: Path, monkeypatch: pytest.MonkeyPatch, says: bytes
) -> None:
    monkeypatch.setattr(BoundedHttp, "most_connections", 20)
    rig = FakeRig(60.0)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        test = (await client.post("/tests/run", json={"valve": "FV-101"})).json()
        async with client.stream("GET", f"/tests/{test['id']}/events") as watching:
            crowd = [await asyncio.open_connection("127.0.0.1", client.base_url.port) for _ in range(60)]
            for _, writer in crowd:
                writer.write(says)
            await asyncio.sleep(0.1)  # all are heard
            # a connection of its own
            async with httpx.AsyncClient(base_url=client.base_url, timeout=60.0, verify=NO_TLS) as another:
                stopped = await another.post(f"/tests/{test['id']}/stop")
            assert stopped.json()["safe_confirmed"] is True
            assert '"state": "stopped"' in "".join(
                [line async for line in watching.aiter_lines()]
            )  # it was no silent one
            cut = await asyncio.gather(*(_closed(reader) for reader, _ in crowd[:40]))
            assert cut == [b""] * 40  # the oldest
        for _, writer in crowd:
            writer.close()


def test_connections_leave_files_for_what_moves_a_valve() -> None:
    assert most_connections(65_536) == MOST_CONNECTIONS
    assert most_connections(1024) == 768
    unit = (Path(__file__).parents[2] / "deploy" / "breakaway.service").read_text(encoding="utf-8")
    (limit,) = re.findall(r"^LimitNOFILE=(\d+)$", unit, re.MULTILINE)
    assert most_connections(int(limit)) == MOST_CONNECTIONS
