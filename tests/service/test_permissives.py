"""What must hold before a valve moves, over the interface: read without moving, refused by 423, kept with the test."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import multiprocessing
import os
import socket
import time
from collections.abc import Iterator, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import httpx
import pytest
from structlog.testing import capture_logs

from drivers.addresses import BusAddress
from drivers.motion import bus_lock
from drivers.motion.bus_lock import FOLDER_VARIABLE, BusLocks
from drivers.outcome import PlayOutcome
from drivers.permissive import Permissive
from service.config.settings import load_plant
from service.runs import permission
from simulator.faults import Fault, FaultKind
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service
from tests.support.wired_plant import TAG, wired_plant
from valve.errors import BusyError, ConfigurationError, DeviceError, InternalError
from valve.messages import say

ORDER = {"valve": "FV-101"}
_NOBODY = 65534
IN_AUTOMATIC = Permissive("loop_in_manual", False, "not in manual", "the loop in manual", "put it in manual")


async def test_permissives_are_read_from_the_device_and_nothing_moves(quick_path: Path) -> None:
    async with (
        wired_plant(quick_path) as (path, plant),
        running_service(load_plant(path), None, FakeAnalyst()) as client,
    ):
        shown = (await client.get(f"/valves/{TAG}/permissives")).json()
        names = {one["name"]: one for one in shown["permissives"]}
        assert shown["may_start"] is True, shown
        assert {"device", "owner", "loop_in_manual", "no_interlock", "position", "stem_at_rest", "watchdog"} <= set(
            names
        )
        assert {"disk", "last_test"} <= set(names)
        assert names["position"]["value"].endswith("mm")
        plant.inject(TAG, Fault(FaultKind.INTERLOCK, plant.clock.now_s() + 0.05))
        async with asyncio.timeout(20.0):
            missing: list[dict[str, Any]] = []
            while not missing:
                shown = (await client.get(f"/valves/{TAG}/permissives")).json()
                missing = [one for one in shown["permissives"] if one["met"] is False]
        assert [one["name"] for one in missing] == ["no_interlock"]
        assert missing[0]["remedy"] != ""
        refused = await client.post("/tests/run", json={"valve": TAG})
        assert refused.status_code == 423
        assert "interlock" in refused.json()["detail"]
        assert plant.records[TAG].events == ()


async def test_a_missing_permissive_answers_423_and_stores_nothing(plant_file: Path) -> None:
    rig = FakeRig()
    rig.shown = (IN_AUTOMATIC,)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        refused = await client.post("/tests/run", json=ORDER)
        assert refused.status_code == 423
        assert refused.json()["type"] == "urn:breakaway:error:PermissiveError"
        assert "put it in manual" in refused.json()["detail"]
        assert (await client.get("/tests")).json()["tests"] == []
        rig.shown = ()
        assert (await client.post("/tests/run", json=ORDER)).status_code == 202


async def test_a_refused_start_leaves_a_line_in_the_log(plant_file: Path) -> None:
    plant, rig = load_plant(plant_file), FakeRig()
    rig.shown = (IN_AUTOMATIC,)
    async with running_service(plant, rig, FakeAnalyst()) as client:
        with capture_logs() as logs:
            assert (await client.post("/tests/run", json={**ORDER, "sequence": "triangle"})).status_code == 423
            async with BusLocks(plant.buses).hold(["plc-1"]):
                assert (await client.post("/tests/run", json=ORDER)).status_code == 409
    refused = [line for line in logs if line["event"] == "test refused"]
    assert [(line["valve"], line["log_level"]) for line in refused] == [("FV-101", "warning")] * 2
    assert refused[0]["sequence"] == "triangle"
    assert "put it in manual" in refused[0]["reason"]
    assert "another process" in refused[1]["reason"]


async def test_a_permit_reaches_the_rig_and_the_permissives_stay_with_the_test(plant_file: Path) -> None:
    rig = FakeRig()
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        order = {**ORDER, "permit": "W-17"}
        body = (await client.post("/tests/run", json=order, headers={"Prefer": "wait=10"})).json()
        assert body["state"] == "completed", body["error"]
        assert rig.permits == ["W-17"]
        assert rig.orders[0].permit == "W-17"
        assert body["permissives"]["permit"] == "W-17"
        kept = {one["name"]: one["met"] for one in body["permissives"]["permissives"]}
        assert kept == {"loop_in_manual": True, "disk": True, "last_test": True}


async def test_permissives_can_be_asked_for_with_a_permit_and_in_other_units(plant_file: Path) -> None:
    rig = FakeRig()
    least = {"least": 2.0e5}
    rig.shown = (
        Permissive(
            "supply",
            False,
            say("supply", "{now:.1f kPa}", now=1.5e5),
            say("at_least", "at least {least:.3g kPa}", **least),
            say("open_supply", "open the supply to {least:.3g kPa}", **least),
        ),
    )
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        asked = {"permit": "W-17", "units": "psi"}
        (shown, *_) = (await client.get("/valves/FV-101/permissives", params=asked)).json()["permissives"]
        assert rig.permits == ["W-17"]
        assert [shown["value"], shown["limit"]] == ["21.76 psi", "at least 29.0 psi"]
        assert shown["remedy"] == "open the supply to 29.0 psi"
        (shown, *_) = (await client.get("/valves/FV-101/permissives")).json()["permissives"]
        assert [rig.permits[-1], shown["value"]] == [None, "150.0 kPa"]
        assert (await client.get("/valves/FV-101/permissives", params={"permit": ""})).status_code == 422


async def test_a_disk_with_no_room_permits_no_test(plant_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(permission, "LEAST_FREE_BYTES", 10**18)
    async with running_service(load_plant(plant_file), FakeRig(), FakeAnalyst()) as client:
        refused = await client.post("/tests/run", json=ORDER)
        assert refused.status_code == 423
        assert "disk" in refused.json()["detail"]


class _BadEnd(FakeRig):
    """Moves, and ends as a rule demands; whether the valve is safe then is ``safe_confirmed``."""

    async def play(self, *said: Any) -> PlayOutcome:
        outcome = await super().play(*said)
        error = DeviceError("FV-101: the stem is stuck: look at it")
        return PlayOutcome(outcome.recording, type(outcome.ended)("failed"), self.safe_confirmed, error)


async def _ended(client: httpx.AsyncClient) -> dict[str, object]:
    body: dict[str, object] = (await client.post("/tests/run", json=ORDER, headers={"Prefer": "wait=10"})).json()
    return body


@pytest.mark.parametrize("safe", [True, False])
async def test_a_bad_end_bars_the_next_test_until_somebody_acknowledges_it(plant_file: Path, safe: bool) -> None:
    rig = _BadEnd()
    rig.safe_confirmed = safe
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        body = await _ended(client)
        assert body["needs_acknowledgement"] is True
        valve = next(one for one in (await client.get("/valves")).json()["valves"] if one["tag"] == "FV-101")
        assert ("SAFE STATE NOT CONFIRMED" in valve["alarms"][0]) is not safe
        refused = await client.post("/tests/run", json=ORDER)
        assert refused.status_code == 423
        assert "acknowledge first" in refused.json()["detail"]
        assert (await client.post(f"/tests/{body['id']}/acknowledge", json={})).status_code == 422
        noted = (await client.post(f"/tests/{body['id']}/acknowledge", json={"note": "gland repacked"})).json()
        assert (noted["acknowledgement"], noted["acknowledged_by"]) == ("gland repacked", "local")
        again = (await client.post(f"/tests/{body['id']}/acknowledge", json={"note": "another"})).json()
        assert again["acknowledgement"] == "gland repacked"
        assert (await client.post("/tests/run", json=ORDER)).status_code == 202


async def test_a_good_end_needs_no_acknowledgement(plant_file: Path) -> None:
    async with running_service(load_plant(plant_file), FakeRig(), FakeAnalyst()) as client:
        body = await _ended(client)
        assert body["needs_acknowledgement"] is False
        assert (await client.post(f"/tests/{body['id']}/acknowledge", json={"note": "why"})).status_code == 422


async def test_stop_by_tag_stops_the_test_of_that_valve_and_nothing_else(plant_file: Path) -> None:
    rig = FakeRig(duration_s=30.0)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        assert (await client.post("/valves/FV-101/stop")).status_code == 404
        started = (await client.post("/tests/run", json=ORDER)).json()
        await rig.moving.wait()
        stopped = (await client.post("/valves/FV-101/stop")).json()
        assert (stopped["id"], stopped["safe_confirmed"]) == (started["id"], True)


async def test_while_a_test_runs_the_last_known_permissives_are_shown(plant_file: Path) -> None:
    rig = FakeRig(duration_s=30.0)
    async with running_service(load_plant(plant_file), rig, FakeAnalyst()) as client:
        await client.post("/tests/run", json=ORDER)
        await rig.moving.wait()
        shown = (await client.get("/valves/FV-101/permissives")).json()
        assert "uses this valve" in shown["not_fresh_because"]
        assert shown["read_at"] is not None
        assert len(rig.permits) == 1
        await client.post("/valves/FV-101/stop")


async def test_a_bus_that_another_process_uses_is_busy(plant_file: Path) -> None:
    plant = load_plant(plant_file)
    other = BusLocks(plant.buses)
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client:
        async with other.hold(["plc-1"]):
            refused = await client.post("/tests/run", json=ORDER)
            assert refused.status_code == 409
            assert "another process" in refused.json()["detail"]
        assert (await client.post("/tests/run", json=ORDER)).status_code == 202


async def test_buses_are_locked_all_or_none(plant_file: Path) -> None:
    addresses = load_plant(plant_file).buses
    one, other = BusLocks(addresses), BusLocks(addresses)
    async with other.hold(["plc-1"]):
        with pytest.raises(BusyError):
            await one.take_aside(["gauge-1", "plc-1"])
    async with other.hold(["gauge-1", "plc-1"]):
        pass


async def test_a_lock_on_a_busy_disk_holds_up_nobody_and_is_not_kept_by_a_caller_that_goes(
    plant_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    locks, opened = BusLocks(load_plant(plant_file).buses), bus_lock._locked

    def slow(bus: str, place: str) -> int:
        time.sleep(0.5)
        return opened(bus, place)

    monkeypatch.setattr(bus_lock, "_locked", slow)
    taking = asyncio.create_task(locks.take_aside(["plc-1"]))
    longest_s, last_s = 0.0, time.monotonic()
    while not taking.done():
        await asyncio.sleep(0.005)
        longest_s, last_s = max(longest_s, time.monotonic() - last_s), time.monotonic()
    assert longest_s < 0.3
    locks.give_back(["plc-1"])
    going = asyncio.create_task(locks.take_aside(["plc-1"]))
    await asyncio.sleep(0.1)
    going.cancel()
    with pytest.raises(asyncio.CancelledError):
        await going
    await asyncio.sleep(0.6)
    monkeypatch.undo()
    async with BusLocks(load_plant(plant_file).buses).hold(["plc-1"]):
        pass


async def test_a_lock_that_is_taken_anew_writes_nothing_to_the_disk(
    plant_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "locks"))
    (tmp_path / "locks").mkdir()
    locks = BusLocks(load_plant(plant_file).buses)
    async with locks.hold(["plc-1"]):
        (file,) = (tmp_path / "locks").iterdir()
    os.utime(file, ns=(1, 1))
    async with locks.hold(["plc-1"]):
        assert file.read_text(encoding="ascii").strip() == str(os.getpid())
    assert file.stat().st_mtime_ns == 1
    file.write_text("7\n", encoding="ascii")
    async with locks.hold(["plc-1"]):
        assert file.read_text(encoding="ascii").strip() == str(os.getpid())


def test_a_map_that_shows_no_manual_mode_must_say_how_a_test_is_permitted(plant_file: Path) -> None:
    text = plant_file.read_text(encoding="utf-8")
    first = text.index('map = "reference"')
    text = text[:first] + text[first:].replace(
        'map = "reference"',
        'map = "advantech_adam_6024"\nsignal = [0.004, 0.02]\nquantity = [0.0, 82737.0]',
        1,
    )
    plant_file.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match="does not show whether the loop is in manual"):
        load_plant(plant_file)


def _hold_as_another(addresses: Mapping[str, BusAddress], told: Connection) -> None:
    """Hold plc-1 as another user, where this one may become one, until the process is killed."""
    if os.getuid() == 0:
        os.setuid(_NOBODY)
    BusLocks(addresses).take(["plc-1"])
    told.send(os.getuid())
    time.sleep(60.0)


@contextlib.contextmanager
def held_elsewhere(addresses: Mapping[str, BusAddress]) -> Iterator[int]:
    """Let another process hold plc-1; return its number."""
    fork = multiprocessing.get_context("fork")  # another user may not start this interpreter anew
    heard, told = fork.Pipe(duplex=False)
    process = fork.Process(target=_hold_as_another, args=(addresses, told), daemon=True)
    process.start()
    try:
        assert heard.poll(30.0)
        assert (heard.recv() != os.getuid()) == (os.getuid() == 0)
        assert process.pid is not None
        yield process.pid
    finally:
        process.kill()
        process.join()


def test_services_of_two_users_keep_each_other_off_a_bus_and_say_who_has_it(
    plant_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(FOLDER_VARIABLE)
    addresses = load_plant(plant_file).buses
    locks = BusLocks(addresses)
    with held_elsewhere(addresses) as process, pytest.raises(BusyError, match=rf"\(process {process}\)"):
        locks.take(["plc-1"])
    locks.take(["plc-1"])  # its holder was killed: the kernel has dropped it
    locks.give_back(["plc-1"])
    locks.take(["plc-1"])
    locks.give_back(["plc-1"])


def test_a_service_that_may_not_have_its_lock_moves_nothing_and_says_what_to_do(
    plant_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object) -> socket.socket:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.delenv(FOLDER_VARIABLE)
    monkeypatch.setattr(socket.socket, "bind", refused)
    with pytest.raises(InternalError, match=f"Operation not permitted.*nothing moves.*{FOLDER_VARIABLE}"):
        BusLocks(load_plant(plant_file).buses).take(["plc-1"])


@pytest.mark.parametrize("number", [errno.EAFNOSUPPORT, errno.EMFILE])
def test_a_machine_that_gives_no_socket_for_a_lock_is_told_what_to_allow(
    plant_file: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refused(*_: object) -> object:
        raise OSError(number, os.strerror(number))

    monkeypatch.delenv(FOLDER_VARIABLE, raising=False)
    monkeypatch.setattr(socket, "socket", refused)
    with pytest.raises(InternalError, match="RestrictAddressFamilies"):
        BusLocks(load_plant(plant_file).buses).take(["plc-1"])
