"""Two services as processes on one PostgreSQL, each with its own buses, over real Modbus to simulated valves."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.cli.demo_plant import free_ports
from tests.support.databases import postgresql_database
from tests.support.plants import bus_text, service_text, valve_text

DEADLINE_S = 600.0
_SIMULATED = """\
[valves.simulation]
parameter_set = "nominal"
position_noise_m = 5.0e-6
seed = {seed}
"""
_SCHEDULE = """\
[[schedules]]
name = "nightly"
cron = "30 2 1 1 *"
zone = "Europe/Berlin"
valves = ["FV-1", "FV-2"]
sequence = "triangle"
window_s = 3600.0
[schedules.overrides]
cycles = 1
period_s = 4.0
"""


def _plant(folder: Path, gateway: str, ports: list[int], database: str) -> Path:
    port = ports[0] if gateway == "g1" else ports[1]
    text = service_text(f'gateway = "{gateway}"\ndatabase = "{database}"', port=port) + _SCHEDULE
    for number, name in enumerate(("g1", "g2"), start=1):
        text += f'[[gateways]]\nname = "{name}"\nurl = "http://127.0.0.1:{ports[number - 1]}"\n'
        text += bus_text(f"b{number}", ports[number + 1], f'gateway = "{name}"\ntimeout_s = 2.0')
        more = _SIMULATED.format(seed=number)
        text += valve_text(
            f"FV-{number}", f"b{number}", safe="20000.0", rate_pa_per_s=60000.0, watchdog_s=2.0, more=more
        )
    (folder / gateway).mkdir()
    path = folder / gateway / "plant.toml"
    path.write_text(text, encoding="utf-8")
    return path


@contextlib.contextmanager
def _process(folder: Path, command: str, config: Path) -> Iterator[subprocess.Popen[bytes]]:
    with (folder / f"{command}-{config.parent.name}.log").open("ab") as log:
        arguments = [sys.executable, "-m", "service.cli", command, "--config", str(config)]
        with subprocess.Popen(arguments, stdout=log, stderr=log) as process:
            try:
                yield process
            finally:
                process.terminate()
                try:
                    process.wait(120.0)
                except subprocess.TimeoutExpired:
                    process.kill()


def _until(what: Callable[[], Any], processes: list[subprocess.Popen[bytes]], folder: Path) -> Any:
    ends_s = time.monotonic() + DEADLINE_S
    while True:
        with contextlib.suppress(httpx.TransportError):
            if found := what():
                return found
        logs = {path.name: path.read_text(encoding="utf-8")[-1500:] for path in folder.glob("*.log")}
        assert all(process.poll() is None for process in processes), logs
        assert time.monotonic() < ends_s, logs
        time.sleep(0.2)


def _lives(client: httpx.Client) -> bool:
    return client.get("/healthz").is_success


def _last_night(client: httpx.Client) -> dict[str, dict[str, Any]]:
    entries = client.get("/schedules/night").json()
    return {one["valve"]: one for one in entries if one["state"] != "planned"}


def _asked(client: httpx.Client, test_id: str) -> dict[str, Any]:
    test: dict[str, Any] = client.get(f"/tests/{test_id}").json()
    return test


def _state(client: httpx.Client, test_id: str) -> str:
    return str(_asked(client, test_id)["state"])


@pytest.mark.long
def test_two_gateways_test_their_own_valves_and_see_all_results(tmp_path: Path) -> None:
    with postgresql_database() as database, contextlib.ExitStack() as stack:
        ports = free_ports(4)
        plants = {name: _plant(tmp_path, name, ports, database) for name in ("g1", "g2")}
        running = [stack.enter_context(_process(tmp_path, "simulate", plants["g1"]))]
        services = {name: stack.enter_context(_process(tmp_path, "serve", path)) for name, path in plants.items()}
        motions = {name: stack.enter_context(_process(tmp_path, "motion", path)) for name, path in plants.items()}
        running += [*services.values(), *motions.values()]
        one, two = (
            stack.enter_context(httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=120.0)) for port in ports[:2]
        )
        for client in (one, two):
            _until(partial(_lives, client), running, tmp_path)

        elsewhere = one.post("/tests/run", json={"valve": "FV-2"})
        assert elsewhere.status_code == 421
        assert (elsewhere.json()["gateway"], elsewhere.json()["url"]) == ("g2", str(two.base_url))

        for client in (one, two):
            assert client.post("/schedules/nightly/run").json()["states"] == {"queued": 1}
        _until(lambda: len([c for c in _last_night(one).values() if c["test_id"]]) == 2, running, tmp_path)
        tests = {tag: check["test_id"] for tag, check in _last_night(one).items()}
        _until(lambda: _asked(one, tests["FV-1"])["progress"] > 0.05, running, tmp_path)  # it was commanded
        assert _state(two, tests["FV-1"]) == "running"
        for process in (services["g1"], motions["g1"]):  # in the middle of the motion
            process.send_signal(signal.SIGKILL)
            process.wait(120.0)
            running.remove(process)
        moved = _until(lambda: (t := _asked(two, tests["FV-2"]))["motion_ended_at"] and t, running, tmp_path)
        assert moved["safe_confirmed"] is True
        assert _last_night(two)["FV-1"]["state"] == "running"  # nobody else speaks for g1
        assert two.get(f"/tests/{tests['FV-2']}/recording").is_success

        running += [stack.enter_context(_process(tmp_path, name, plants["g1"])) for name in ("motion", "serve")]
        night = _until(lambda: (c := _last_night(one))["FV-1"]["state"] != "running" and c, running, tmp_path)
        assert night["FV-1"]["state"] == "interrupted"
        safe = _until(lambda: (t := _asked(one, tests["FV-1"]))["safe_confirmed"] is not None and t, running, tmp_path)
        assert safe["safe_confirmed"] is True
        elsewhere = one.get(f"/tests/{tests['FV-2']}/recording")
        assert (elsewhere.status_code, elsewhere.json()["url"]) == (421, str(two.base_url))
        for client in (one, two):  # each sees both, and what is stored is the same
            listed = {test["id"]: test for test in client.get("/tests").json()["tests"]}
            assert set(listed) == set(tests.values())
            assert listed[tests["FV-1"]]["state"] == "interrupted"
            assert listed[tests["FV-2"]]["state"] in {"analyzing", "completed"}, listed[tests["FV-2"]]["error"]
