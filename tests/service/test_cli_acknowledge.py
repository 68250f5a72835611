"""``breakaway acknowledge``: by a tag or a test's id, what was found, and what there is nothing of."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import pytest

from service.config.settings import load_plant
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service

TAG = "FV-101"


async def _acknowledged(what: str, note: str, url: str) -> tuple[int | None, str, str]:
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "service.cli", "acknowledge", what, "--note", note, "--url", url), stdout=-1, stderr=-1
    )
    out, err = await asyncio.wait_for(process.communicate(), 60.0)
    return process.returncode, out.decode(), err.decode()


@pytest.mark.parametrize("by", ["tag", "test"])
async def test_after_a_bad_end_somebody_who_looked_lets_the_next_test_start(plant_file: Path, by: str) -> None:
    rig = FakeRig()
    rig.safe_confirmed = False
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        url, test = str(client.base_url), {"valve": TAG}
        code, _, err = await _acknowledged(TAG, "all well", url)
        assert code == 1
        assert err.startswith(f"breakaway: {TAG}: no test")
        bad = (await client.post("/tests/run", json=test, headers={"Prefer": "wait=20"})).json()
        refused = await client.post("/tests/run", json=test)
        assert refused.status_code == 423
        assert f"breakaway acknowledge {TAG}" in refused.json()["detail"]
        code, out, err = await _acknowledged(TAG if by == "tag" else bad["id"], "fuse of the I/P replaced", url)
        assert (code, err) == (0, "")
        assert out == f"{TAG}: test {bad['id']} (failed) is acknowledged: the next test may start\n"
        assert (await client.get(f"/tests/{bad['id']}")).json()["acknowledgement"] == "fuse of the I/P replaced"
        assert (await client.post("/tests/run", json=test)).status_code == 202
