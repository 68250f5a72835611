"""``make compose-check``: bring docker-compose.yml up for real, test valves through it, and take it down again.

Not a part of ``make test``: it needs a container engine, and minutes. ``COMPOSE`` names its command, by default
``docker compose``.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import httpx

from service.cli.demo_plant import free_ports
from tests.bench.compose import unit

Found = TypeVar("Found")

PARTS: Final = ("single", "plant", "precedence")
UNIT: Final = "unit"  # by its name alone: it installs the service on this machine
PROJECT: Final = Path(__file__).resolve().parents[3]
_NAME: Final = "breakaway-check"
_UP_S: Final = 1800.0  # the image is built from nothing
_START_S: Final = 300.0
_TEST_S: Final = 400.0
_QUICK: Final = {"sequence": "triangle", "overrides": {"cycles": 2, "period_s": 8.0}}
_WITH_PRECEDENCE: Final = ("-f", "docker-compose.yml", "-f", "deploy/compose/precedence.yml")
_METRIC: Final = "breakaway_polling_precedence"


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def _require(holds: bool, what: str) -> None:
    if not holds:
        raise SystemExit(f"compose-check failed: {what}")


class Compose:
    """The compose command of this machine, on a project of the check's own."""

    def __init__(self, command: str, environment: Mapping[str, str]) -> None:
        self._command = [*shlex.split(command), "-p", _NAME]
        self._environment = {**os.environ, **environment}

    def __call__(self, *arguments: str, timeout_s: float = _UP_S, check: bool = True) -> str:
        """Run it and return what it said; end the check where it fails."""
        done = subprocess.run(
            [*self._command, *arguments],
            cwd=PROJECT,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=timeout_s,
            check=False,
        )
        _require(done.returncode == 0 or not check, f"{' '.join(arguments)}: {done.stdout[-3000:]}")
        return done.stdout


def why_not(command: str) -> str:
    """Return why containers cannot be run here; "" where they can."""
    try:
        subprocess.run([*shlex.split(command), "version"], check=True, capture_output=True, timeout=60.0)
    except (OSError, subprocess.SubprocessError) as error:
        reason = getattr(error, "strerror", None) or type(error).__name__
        return f"{command}: {reason}: install a container engine, or name its compose command as COMPOSE"
    return ""


def refusal(said: str) -> str:
    """Return where an engine says that it may not raise the limit of a container; "" where something else is wrong."""
    # runc, crun and docker each name the limit; what may raise none says so by the system's own words
    lines = [line.strip() for line in said.splitlines() if "rlimit" in line.lower()]
    return next((line for line in lines if "not permitted" in line.lower()), "")


@contextlib.contextmanager
def _up(compose: Compose, profile: tuple[str, ...], services: tuple[str, ...]) -> Iterator[None]:
    began_s = time.monotonic()
    try:
        compose("build", "service")  # once: every container is of this one image
        compose(*profile, "up", "-d", *services)
        _say(f"  up after {time.monotonic() - began_s:.0f} s")
        yield
    except BaseException as failed:
        if not refusal(str(failed)):
            _say(compose(*profile, "logs", check=False)[-6000:])
        raise
    finally:
        compose(*profile, "down", "-v", check=False)


def _until(what: Callable[[], Found | None], within_s: float, name: str) -> Found:
    ends_s = time.monotonic() + within_s
    while time.monotonic() < ends_s:
        with contextlib.suppress(httpx.TransportError):
            found = what()
            if found is not None:
                return found
        time.sleep(0.5)
    raise SystemExit(f"compose-check failed: {name} did not come within {within_s:.0f} s")


def _caller(port: int) -> httpx.Client:
    return httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=30.0)


def _lives(client: httpx.Client) -> bool | None:
    return True if client.get("/healthz").is_success else None


def _ended(client: httpx.Client, href: str) -> dict[str, Any] | None:
    test: dict[str, Any] = client.get(href).json()
    return test if test["state"] not in {"queued", "running", "analyzing"} else None


def _test(client: httpx.Client, tag: str, name: str) -> dict[str, Any]:
    began_s = time.monotonic()
    asked = client.post("/tests/run", json={"valve": tag, **_QUICK})
    _require(asked.status_code == 202, f"{tag}: {asked.status_code} {asked.text[:500]}")
    test = _until(partial(_ended, client, asked.json()["href"]), _TEST_S, f"the end of the test of {tag}")
    _require(test["state"] == "completed" and test["safe_confirmed"] is True, f"{tag}: {test['state']} {test['error']}")
    regression = test["analysis"]["estimates"][0]["parameters"]["F_c"]
    _say(
        f"  {tag} by {name}: completed in {time.monotonic() - began_s:.0f} s, {test['quality']['samples']} samples, "
        f"F_c {regression['value']:.1f} N, safe value confirmed"
    )
    return test


def check_single(compose: Compose, port: int) -> None:
    """One gateway on SQLite."""
    _say("default: one gateway on SQLite, three simulated valves")
    with _up(compose, (), ()), _caller(port) as client:
        _until(partial(_lives, client), _START_S, "the service")
        test = _test(client, "FV-102", "the service")
        recording = client.get(f"{test['href']}/recording", headers={"Accept": "text/csv"})
        _require(recording.text.startswith("time_s") or "position_m" in recording.text[:200], "the recording is no CSV")
        _require('breakaway_tests{state="completed"} 1.0' in client.get("/metrics").text, "the metrics miss the test")
        _require("breakaway" in client.get("/").text, "the tablet's page is empty")
        compose("restart", "service")
        _until(partial(_lives, client), _START_S, "the service after its restart")
        _require(client.get(test["href"]).json()["state"] == "completed", "a restart lost the result")
        _say("  recording, metrics, tablet, and the result after a restart: as they should be")


def check_plant(compose: Compose, ports: list[int]) -> None:
    """Two gateways on one PostgreSQL."""
    _say("profile plant: PostgreSQL, two gateways, 20 simulated valves on 4 buses")
    with contextlib.ExitStack() as stack:
        stack.enter_context(_up(compose, ("--profile", "plant"), ("north", "south")))
        north, south = (stack.enter_context(_caller(port)) for port in ports)
        for client, name in ((north, "north"), (south, "south")):
            _until(partial(_lives, client), _START_S, f"gateway {name}")
        _require(len(north.get("/valves").json()["valves"]) == 20, "north does not list 20 valves")
        elsewhere = north.post("/tests/run", json={"valve": "FV-120"})
        _require(elsewhere.status_code == 421 and elsewhere.json()["gateway"] == "south", elsewhere.text[:300])
        tests = [_test(north, "FV-101", "north"), _test(south, "FV-120", "south")]
        for client in (north, south):
            for test in tests:
                _require(client.get(test["href"]).json()["state"] == "completed", "a gateway misses a result")
        planned = [one for one in south.get("/schedules/night").json() if one["state"] == "planned"]
        _require(
            {one["valve"] for one in planned} == {f"FV-{101 + one}" for one in range(20)}, "the night misses valves"
        )
        _say("  both gateways show both results, and the coming night has all 20 valves")


def check_precedence(compose: Compose, port: int) -> str:
    """One gateway that may come first while it polls; why not where this engine refuses it, else ""."""
    _say("deploy/compose/precedence.yml: the gateway may take real-time precedence")
    try:
        with (
            _up(compose, _WITH_PRECEDENCE, ()),
            _caller(port) as client,
        ):
            _until(partial(_lives, client), _START_S, "the service")
            lines = [line for line in client.get("/metrics").text.splitlines() if line.startswith(_METRIC)]
            _require(lines == [f"{_METRIC} 1.0"], f"the limit is set and the precedence was not taken: {lines}")
            _say(f"  {lines[0]}")
    except SystemExit as failed:
        if not (why := refusal(str(failed))):
            raise
        _say(f"  this engine refuses the limit: {why}")
        return why
    return ""


def _check_unit() -> int:
    if reason := unit.why_not():
        _say(f"not checked: {reason}")
        return 1
    _say("deploy/breakaway.service under this machine's systemd, installed as docs/deployment.md says")
    unit.check(_say, _require)
    _say("compose-check: all as it should be")
    return 0


def main() -> int:
    """Check what can be checked here; 1 where nothing could be, something failed, or what was named could not be."""
    if unknown := set(sys.argv[1:]) - {*PARTS, UNIT}:
        _say(f"{', '.join(sorted(unknown))}: unknown: choose from {', '.join((*PARTS, UNIT))}")
        return 1
    if UNIT in sys.argv[1:]:
        return _check_unit()
    command = os.environ.get("COMPOSE") or "docker compose"
    if reason := why_not(command):
        _say(f"not checked: {reason}")
        return 1
    ports = free_ports(3)
    environment = {
        "BREAKAWAY_PORT": str(ports[0]),
        "BREAKAWAY_NORTH_PORT": str(ports[1]),
        "BREAKAWAY_SOUTH_PORT": str(ports[2]),
        "BREAKAWAY_DATABASE_PASSWORD": secrets.token_hex(16),
    }
    compose = Compose(command, environment)
    compose("--profile", "plant", "down", "-v", check=False)
    chosen, refused = sys.argv[1:] or PARTS, ""
    if "single" in chosen:
        check_single(compose, ports[0])
    if "plant" in chosen:
        check_plant(compose, ports[1:])
    if "precedence" in chosen:
        refused = check_precedence(compose, ports[0])
    if refused:
        _say("compose-check: all as it should be, but for precedence, which this engine may not give: not checked")
        return 1 if "precedence" in sys.argv[1:] else 0
    _say("compose-check: all as it should be")
    return 0


if __name__ == "__main__":
    sys.exit(main())
