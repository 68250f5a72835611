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

UNIT = Path(__file__).resolve().parents[2] / "deploy" / "breakaway.service"
ANALYZE = shutil.which("systemd-analyze")


@pytest.mark.skipif(ANALYZE is None, reason="systemd-analyze is not installed")
def test_the_unit_is_what_systemd_understands(tmp_path: Path) -> None:
    assert ANALYZE is not None
    program = shutil.which("true")
    text = re.sub(r"^ExecStart=\S+", f"ExecStart={program}", UNIT.read_text(encoding="utf-8"), flags=re.MULTILINE)
    copy = tmp_path / UNIT.name
    copy.write_text(text, encoding="utf-8")
    done = subprocess.run([ANALYZE, "verify", "--man=no", str(copy)], capture_output=True, text=True, check=False)
    complaints = [line for line in done.stderr.splitlines() if UNIT.name in line]
    assert (done.returncode, complaints) == (0, [])


def test_the_unit_waits_longer_than_a_valve_needs_to_get_safe_and_takes_no_rights() -> None:
    text = UNIT.read_text(encoding="utf-8")
    keys = dict(re.findall(r"^(\w+)=(.*)$", text, re.MULTILINE))
    assert (keys["Type"], keys["User"], keys["KillMode"]) == ("notify", "breakaway", "mixed")
    assert int(keys["TimeoutStopSec"]) >= 45
    assert -10 <= int(keys["Nice"]) < 0
    assert keys["CapabilityBoundingSet"] == ""
    assert keys["ProtectSystem"] == "strict"
    assert keys["LimitRTPRIO"] == str(LOOP)
    assert (keys["RestrictRealtime"], "CPUSchedulingPolicy" in keys) == ("false", False)
    assert keys["Restart"] == "on-failure"


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
