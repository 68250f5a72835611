from __future__ import annotations

import asyncio
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import structlog

from drivers.motion.precedence import LOOP
from drivers.motion.service_manager import ServiceManager
from tests.service.conftest import PLANT

DEPLOY = Path(__file__).resolve().parents[2] / "deploy"
SERVICE, MOTION = DEPLOY / "breakaway.service", DEPLOY / "breakaway-motion.service"
ANALYZE = shutil.which("systemd-analyze")


@pytest.mark.skipif(ANALYZE is None, reason="systemd-analyze is not installed")
def test_the_units_are_what_systemd_understands(tmp_path: Path) -> None:
    assert ANALYZE is not None
    program = shutil.which("true")
    for unit in (SERVICE, MOTION):
        text = re.sub(r"^ExecStart=\S+", f"ExecStart={program}", unit.read_text(encoding="utf-8"), flags=re.MULTILINE)
        (tmp_path / unit.name).write_text(text, encoding="utf-8")
    for unit in (SERVICE, MOTION):
        command = [ANALYZE, "verify", "--man=no", str(tmp_path / unit.name)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        complaints = [line for line in done.stderr.splitlines() if unit.name in line]
        assert (done.returncode, complaints) == (0, [])


def _keys(unit: Path) -> dict[str, str]:
    return dict(re.findall(r"^(\w+)=(.*)$", unit.read_text(encoding="utf-8"), re.MULTILINE))


def test_the_units_wait_longer_than_a_valve_needs_to_get_safe_and_take_no_rights() -> None:
    for unit in (SERVICE, MOTION):
        keys = _keys(unit)
        assert (keys["Type"], keys["User"], keys["KillMode"]) == ("notify", "breakaway", "mixed")
        assert int(keys["TimeoutStopSec"]) >= 45
        assert -10 <= int(keys["Nice"]) < 0
        assert keys["CapabilityBoundingSet"] == ""
        assert keys["ProtectSystem"] == "strict"
        assert keys["Restart"] == "on-failure"


def test_what_moves_valves_comes_first_and_starts_and_ends_by_itself() -> None:
    service, motion = _keys(SERVICE), _keys(MOTION)
    assert motion["LimitRTPRIO"] == str(LOOP)
    assert (motion["RestrictRealtime"], "CPUSchedulingPolicy" in motion) == ("false", False)
    assert "LimitRTPRIO" not in service
    assert int(motion["Nice"]) < int(service["Nice"])
    assert MOTION.name in service["Wants"].split()
    assert MOTION.name in service["After"].split()
    assert not {"BindsTo", "PartOf", "Requires"} & {*service, *motion}, "an upgrade of one must not end the other"


def test_a_service_manager_hears_ready_then_a_beat_then_the_end(quick_path: Path) -> None:
    path = quick_path / "plant.toml"
    path.write_text(PLANT, encoding="utf-8")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.bind(str(quick_path / "notify"))
        line.settimeout(60.0)
        environment = {**os.environ, "NOTIFY_SOCKET": str(quick_path / "notify"), "WATCHDOG_USEC": "300000"}
        environment.pop("WATCHDOG_PID", None)
        command = [sys.executable, "-m", "service.cli", "serve", "--config", str(path)]
        with subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as process:
            try:
                assert line.recv(100) == b"READY=1"
                assert [line.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
                process.send_signal(signal.SIGTERM)
                heard = line.recv(100)
                while heard == b"WATCHDOG=1":
                    heard = line.recv(100)
                assert heard == b"STOPPING=1"
                assert process.wait(120.0) == 0
            finally:
                process.kill()


async def test_without_a_service_manager_nothing_is_said_and_nobody_waits() -> None:
    manager = ServiceManager({})
    assert not manager.listens
    manager.say("READY=1")
    await asyncio.wait_for(manager.keep_alive(), 5.0)
    with structlog.testing.capture_logs() as logs:
        ServiceManager({"NOTIFY_SOCKET": "/nowhere/notify"}).say("READY=1")
    assert [(one["event"], one["log_level"]) for one in logs] == [("service manager not reached", "warning")]
