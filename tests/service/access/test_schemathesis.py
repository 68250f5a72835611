"""schemathesis over every route of the OpenAPI document, as an engineer and as an admin: no answer is a server error.

A bounded run by default; ``make fuzz`` draws more examples (BREAKAWAY_FUZZ_EXAMPLES for each operation) from new seeds.
"""

from __future__ import annotations

import asyncio
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from service.access.principal import Role
from tests.service.access.signed_in import body_of, signed_in

EXAMPLES = int(os.environ.get("BREAKAWAY_FUZZ_EXAMPLES", "0"))
_BOUNDED = ["--max-examples", "3", "--generation-deterministic", "--phases", "examples,fuzzing"]
_LONG = ["--max-examples", str(EXAMPLES), "--generation-database", "none", "--phases", "examples,coverage,fuzzing"]
_ADMIN = "^/(users|tokens)"


async def schemathesis(url: str, folder: Path, headers: dict[str, str], *routes: str) -> dict[str, Any]:
    """Run the tool on some routes; what it counted. Fails where it found something."""
    report = folder / "report.json"
    command = [sys.executable, "-m", "schemathesis.cli", "run", f"{url}/openapi.json", "--url", url]
    command += ["--checks", "not_a_server_error", "--suppress-health-check", "all"]
    command += ["--no-shrink", "--warnings", "off", "--no-color", "--report-json-path", str(report)]
    command += [part for name, value in headers.items() for part in ("--header", f"{name}: {value}")]
    command += [*routes, *(_LONG if EXAMPLES else _BOUNDED)]
    process = await asyncio.create_subprocess_exec(*command, cwd=folder, stdout=-1, stderr=-2)
    said, _ = await asyncio.wait_for(process.communicate(), 3600.0 if EXAMPLES else 240.0)
    assert process.returncode == 0, said.decode()
    found: dict[str, Any] = json.loads(report.read_text(encoding="utf-8"))
    return found


@pytest.mark.long
@pytest.mark.parametrize("role", [Role.ADMIN, Role.ENGINEER])
async def test_schemathesis_finds_no_server_error(quick_path: Path, role: Role) -> None:
    routes = ["--include-path-regex", _ADMIN] if role is Role.ADMIN else ["--exclude-path-regex", _ADMIN]
    async with signed_in(quick_path, "admin", rig_s=0.0) as served:
        headers = served.tokens[role]
        body_of(await served.client.get("/session", headers=headers))
        found = await schemathesis(str(served.client.base_url), quick_path, headers, *routes)
        body_of(await served.client.get("/session", headers=headers))
    operations = found["operations"]
    assert (operations["tested"], operations["errored"]) == (operations["selected"], 0)
    assert operations["selected"] >= (6 if role is Role.ADMIN else 20)
    assert found["test_cases"]["with_failures"] == 0
    print(role.value, operations, found["test_cases"])
