"""The units under a real systemd: installed as docs/deployment.md says, tested, stopped, killed and hung amid motions.

For a machine to throw away, such as a fresh virtual machine: it is installed there, and removed but for /opt/breakaway.
"""

from __future__ import annotations

import contextlib
import os
import pwd
import re
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, Final

import httpx

from drivers.motion.precedence import LOOP

Say = Callable[[str], None]
Require = Callable[[bool, str], None]

PROJECT: Final = Path(__file__).resolve().parents[3]
PAGE: Final = PROJECT / "docs" / "deployment.md"
_PLACE: Final = Path("/opt/breakaway")
_UNITS: Final = tuple(Path("/etc/systemd/system") / f"{name}.service" for name in ("breakaway-motion", "breakaway"))
_MOVES: Final = "breakaway-motion"
_SETTINGS: Final = Path("/etc/breakaway")
_OWN: Final = (Path("/var/lib/breakaway"), Path("/var/cache/breakaway"))
_USER: Final = "breakaway"
_INSTALL_S: Final = 1800.0
_START_S: Final = 300.0
_TEST_S: Final = 1200.0  # an analysis that compiles first, on a slow machine
_STOP_S: Final = 45.0  # as the page says
_RESTART_S: Final = 150.0  # the unit's watchdog, its pause, and a start on a slow machine
_PORT, _DEVICE_PORT = 8321, 5020
_TAG: Final = "FV-101"
_MOTION: Final = {"sequence": "triangle", "overrides": {"cycles": 2, "period_s": 20.0}}
_OUTPUT: Final = bytes.fromhex(
    "0000 0000 0006 01 03 0016 0002"
)  # what the device asks of its I/P (docs/reference-map.md)
_SAFE_PA: Final = 0.0
_PLANT: Final = f"""[service]
store = "/var/lib/breakaway"
bind = "127.0.0.1"
port = {_PORT}
[[buses]]
name = "plc"
kind = "modbus_tcp"
host = "127.0.0.1"
port = {_DEVICE_PORT}
timeout_s = 3.0
[[valves]]
tag = "{_TAG}"
safe_value_pa = {_SAFE_PA}
[valves.actuator]
diaphragm_area_m2 = 0.06452
travel_m = 0.1016
action = "spring"
bench_set_pa = [0.0, 82737.0]
[valves.signal]
range_ma = [4.0, 20.0]
range_pa = [0.0, 82737.0]
[valves.limits]
pressure_pa = [0.0, 82737.0]
pressure_rate_pa_per_s = 30000.0
longest_test_s = 300.0
[valves.command]
bus = "plc"
device_id = 1
map = "reference"
[valves.acquisition]
mode = "polled"
period_s = 0.1
[valves.watchdog]
timeout_s = 10.0
[valves.simulation]
parameter_set = "nominal"
position_noise_m = 2.0e-6
seed = 101
"""


def steps(page: str) -> list[str]:
    """Return the commands that the page gives for a bare gateway, but for the one that shows the log without an end."""
    part = page.partition("## A bare gateway")[2].partition("\n## ")[0]
    block = re.search(r"^```sh\n(.*?)^```$", part, re.MULTILINE | re.DOTALL)
    assert block is not None, "docs/deployment.md gives no commands for a bare gateway"
    return [line for line in block[1].splitlines() if not line.startswith("journalctl")]


def why_not() -> str:
    """Return why the unit cannot be tried here; "" where it can."""
    if not Path("/run/systemd/system").is_dir():
        return "this machine was not started by systemd"
    if os.geteuid() != 0:
        return "only root may install a unit"
    with contextlib.suppress(KeyError):
        return f"the user {pwd.getpwnam(_USER).pw_name} is here already: take a machine to throw away"
    taken = [str(path) for path in (*_UNITS, _SETTINGS, *_OWN) if path.exists()]
    return f"{', '.join(taken)} is here already: take a machine to throw away" if taken else ""


def check(say: Say, require: Require) -> None:
    """Install the units, run a test over them, then stop, kill and hang what moves the valve, and the service, too."""
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        (folder / "plant.toml").write_text(_PLANT, encoding="utf-8")
        stack.callback(_remove)
        *before, start = steps(PAGE.read_text(encoding="utf-8"))
        for step in before:
            if step.startswith("git clone") and _PLACE.exists():
                say(f"  {_PLACE} is here and is taken as it is")
                continue
            _shell(step.replace("ADDRESS", str(PROJECT)), folder, require)
        stack.enter_context(_simulated(folder))
        began_s = time.monotonic()
        _shell(start, folder, require)
        say(f"  started after {time.monotonic() - began_s:.0f} s")
        with httpx.Client(base_url=f"http://127.0.0.1:{_PORT}", timeout=60.0) as client:
            _check_service(client, say, require)


def _check_service(client: httpx.Client, say: Say, require: Require) -> None:
    pid = int(_shown("MainPID", _MOVES))
    uid = Path(f"/proc/{pid}").stat().st_uid
    require(pwd.getpwuid(uid).pw_name == _USER, f"it runs as the user {uid}")
    require("breakaway_polling_precedence 1.0" in client.get("/metrics").text, "the precedence is refused")
    test = _moving(client, require)
    scheduled = (os.sched_getscheduler(pid) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(pid).sched_priority)
    require(scheduled == (os.SCHED_RR, LOOP), f"while it polls it is scheduled as {scheduled}")
    moved = _ended(client, test, require, also=("analyzing",))
    require(moved["safe_confirmed"] is True, f"{moved['state']} {moved['error']}")
    say(f"  {_TAG}: {moved['quality']['samples']} samples polled with precedence, safe value confirmed")

    test = _moving(client, require)
    began_s = time.monotonic()
    _shell(f"systemctl stop {_MOVES}", Path("/"), require)
    took_s = time.monotonic() - began_s
    require(took_s <= _STOP_S, f"to stop it took {took_s:.0f} s")
    require(_output_pa() == _SAFE_PA, f"after systemctl stop the device drives {_output_pa():.0f} Pa")
    require(_shown("Result", _MOVES) == "success", f"systemd calls the stop {_shown('Result', _MOVES)}")
    _shell(f"systemctl start {_MOVES}", Path("/"), require)
    ended = _ended(client, test, require)
    require(ended["state"] == "stopped" and ended["safe_confirmed"] is True, f"{ended['state']} {ended['error']}")
    say(f"  systemctl stop {_MOVES} amid a motion: {took_s:.1f} s, the valve at its safe value, the test stopped")

    for what, number in (("killed", signal.SIGKILL), ("hung", signal.SIGSTOP)):
        test, restarts = _moving(client, require), int(_shown("NRestarts", _MOVES))
        began_s = time.monotonic()
        os.kill(int(_shown("MainPID", _MOVES)), number)
        _until(partial(_restarted_since, restarts, _MOVES), _RESTART_S, f"{what}: its restart", require)
        ended = _ended(client, test, require)
        took_s = time.monotonic() - began_s
        require(ended["state"] == "interrupted", f"{what}: the test is {ended['state']}")
        require(_output_pa() == _SAFE_PA, f"{what}: the device drives {_output_pa():.0f} Pa")
        _until(partial(_acknowledged, client, test), _TEST_S, "a stem that was looked at", require)
        say(f"  {what} amid a motion: back after {took_s:.0f} s, the valve at its safe value, the test interrupted")

    for what in ("systemctl restart breakaway", f"kill -KILL {_shown('MainPID')}"):
        test, restarts = _moving(client, require), int(_shown("NRestarts"))
        _shell(what, Path("/"), require)
        if what.startswith("kill"):
            _until(partial(_restarted_since, restarts), _RESTART_S, f"{what}: its restart", require)
        ended = _ended(client, test, require)
        require(ended["state"] == "completed" and ended["safe_confirmed"] is True, f"{ended['state']} {ended['error']}")
        say(f"  {what.split()[0]} of the service amid a motion: the test completed")
    ended = _ended(client, _moving(client, require), require)
    require(ended["state"] == "completed" and ended["safe_confirmed"] is True, f"{ended['state']} {ended['error']}")
    require(bool(ended["analysis"]["estimates"]), "the analysis has no estimates")
    say(f"  {_TAG} after all of it: completed and analysed, safe value confirmed")


def _shell(step: str, folder: Path, require: Require) -> None:
    command = ["bash", "-euo", "pipefail", "-c", step]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=_INSTALL_S, check=False)
    log = "" if done.returncode == 0 else _log()
    require(done.returncode == 0, f"{step}: {done.stdout[-2000:]} {done.stderr[-2000:]} {log}")


def _log() -> str:
    command = ["journalctl", "--unit", "breakaway", "--unit", _MOVES, "--no-pager", "--lines", "30"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout


@contextlib.contextmanager
def _simulated(folder: Path) -> Iterator[None]:
    command = [str(_PLACE / ".venv/bin/breakaway"), "simulate", "--config", str(folder / "plant.toml")]
    with (folder / "simulate.log").open("wb") as log, subprocess.Popen(command, stdout=log, stderr=log) as process:
        try:
            yield
        finally:
            process.terminate()


def _remove() -> None:
    for command in (["systemctl", "disable", "--now", "breakaway", _MOVES], ["userdel", _USER]):
        subprocess.run(command, capture_output=True, check=False)
    for unit in _UNITS:
        unit.unlink(missing_ok=True)
    subprocess.run(["systemctl", "daemon-reload"], check=False)
    for path in (_SETTINGS, *_OWN):
        shutil.rmtree(path, ignore_errors=True)


def _shown(name: str, unit: str = "breakaway") -> str:
    command = ["systemctl", "show", "--property", name, "--value", unit]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def _restarted_since(restarts: int, unit: str = "breakaway") -> bool:
    return int(_shown("NRestarts", unit)) > restarts


def _until(holds: Callable[[], Any], within_s: float, name: str, require: Require) -> Any:
    ends_s = time.monotonic() + within_s
    while time.monotonic() < ends_s:
        with contextlib.suppress(httpx.TransportError):
            if found := holds():
                return found
        time.sleep(0.5)
    require(False, f"{name} did not come within {within_s:.0f} s: {_log()}")
    return None


def _moving(client: httpx.Client, require: Require) -> str:
    """Start a test and return its id once the device drives the valve well away from its safe value."""

    def asked() -> httpx.Response | None:
        answer = client.post("/tests/run", json={"valve": _TAG, **_MOTION})
        return answer if answer.status_code == httpx.codes.ACCEPTED else None

    test = str(_until(asked, _START_S, "the start of a test", require).json()["id"])
    _until(lambda: _output_pa() > _SAFE_PA + 20_000.0, _TEST_S, "the motion", require)
    return test


def _acknowledged(client: httpx.Client, test: str) -> bool:
    return client.post(f"/tests/{test}/acknowledge", json={"note": "the check looked"}).is_success


def _ended(client: httpx.Client, test: str, require: Require, also: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return a test that has ended, or is in a state of ``also``."""

    def found() -> dict[str, Any] | None:
        told: dict[str, Any] = client.get(f"/tests/{test}").json()
        return told if told["state"] in also or told["state"] not in {"queued", "running", "analyzing"} else None

    ended: dict[str, Any] = _until(found, _TEST_S, f"the end of the test {test}", require)
    return ended


def _output_pa() -> float:
    """Return what the simulated device asks of its I/P now, read from the device itself, Pa."""
    with socket.create_connection(("127.0.0.1", _DEVICE_PORT), 10.0) as line:
        line.sendall(_OUTPUT)
        answer = line.recv(64)
    return float(struct.unpack(">f", answer[9:13])[0])
