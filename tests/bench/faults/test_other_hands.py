"""What others do: contacts that are wired elsewhere, a second master on the bus, an audit log that refuses."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pytest

from drivers.addresses import TcpAddress
from drivers.device import connect_valve
from drivers.maps.reference import MAP, Claim
from drivers.motion.audit_log import AuditError, AuditLog
from drivers.outcome import Ended, PlayOutcome
from drivers.permissive_rules import Contact, PermissiveRules
from drivers.sequence import play_sequence
from drivers.transport import Transport
from service.config.settings import load_plant
from simulator.record import Happening
from tests.bench.faults.station import ORDER, TAG, station
from tests.support.fake_rig import FakeAnalyst
from tests.support.played_device import LIMITS, SAFE_PA, WIRING, Bench, until
from tests.support.reference_device import ReferenceDevice
from tests.support.running_service import running_service
from tests.support.slave import RawSlave, TcpPort
from valve.errors import PermissiveError
from valve.recording import Provenance
from valve.waveform import triangle

WAVE: Final = triangle(4.0, 1, 10_000.0, 60_000.0)
CLOSED, OPEN, BROKEN = 12_000, 3_000, 0xFFFF  # words of an input of 4-20 mA: 6.9, 4.7 and 20 mA
IN_MANUAL: Final = Contact("remote", 9, "advantech_adam_6024", "ai2", above=0.006)
LOCKED: Final = Contact("remote", 9, "advantech_adam_6024", "ai3", above=0.006)


@asynccontextmanager
async def remote_contacts() -> AsyncIterator[tuple[Bench, RawSlave]]:
    """A valve whose manual mode and interlock are inputs of another device on another bus."""
    device, remote = ReferenceDevice(RawSlave()), RawSlave()
    device.status = 0  # its own status says nothing of the loop
    for address in range(32):
        remote.holding[9, address] = 0
    remote.holding[9, 2], remote.holding[9, 3] = CLOSED, OPEN
    rules = PermissiveRules(manual=IN_MANUAL, interlock=LOCKED)
    async with TcpPort(device.slave) as own, TcpPort(remote) as other:
        buses = {
            "bus": Transport(TcpAddress("bus", "127.0.0.1", own.port, timeout_s=1.0)),
            "remote": Transport(TcpAddress("remote", "127.0.0.1", other.port, timeout_s=1.0)),
        }
        for bus in buses.values():
            await bus.open()
        try:
            yield Bench(device, connect_valve(replace(WIRING, permissives=rules), buses)), remote
        finally:
            for bus in buses.values():
                await bus.close()


async def test_contacts_of_another_device_on_another_bus_permit_a_test() -> None:
    async with remote_contacts() as (bench, remote):
        outcome = await bench.play(triangle(1.0, 1, 10_000.0, 30_000.0))
        assert (outcome.ended, outcome.error) == (Ended.COMPLETED, None)
        assert {request[0] for request in remote.requests} == {9}
        assert remote.writes == []


@pytest.mark.parametrize(("channel", "word", "name"), [(2, OPEN, "loop_in_manual"), (3, CLOSED, "no_interlock")])
async def test_a_contact_elsewhere_that_does_not_permit_keeps_the_valve_where_it_is(
    channel: int, word: int, name: str
) -> None:
    async with remote_contacts() as (bench, remote):
        remote.holding[9, channel] = word
        with pytest.raises(PermissiveError, match=name):
            await bench.play()
        assert bench.device.slave.writes == []


@pytest.mark.parametrize(
    ("channel", "word", "said"), [(2, OPEN, "no longer in manual"), (3, CLOSED, "interlock became active")]
)
async def test_a_contact_elsewhere_that_changes_during_a_test_ends_it(channel: int, word: int, said: str) -> None:
    async with remote_contacts() as (bench, remote):
        playing = asyncio.create_task(bench.play(WAVE))
        await until(lambda: len(bench.device.moves) > 20)
        remote.holding[9, channel] = word
        outcome = await playing
        assert outcome.ended is Ended.FAILED
        assert said in str(outcome.error)
        assert outcome.safe_confirmed
        assert bench.moved_pa[-1] == SAFE_PA


# ---- a second master, over a connection of its own to the same device

Meddling = Callable[[Transport], Awaitable[None]]


def _words(**values: float) -> list[int]:
    return [word for name, value in values.items() for word in MAP.register(name).encode(value)]


async def _command(bus: Transport, run: int, pressure_pa: float) -> None:
    await bus.write(1, MAP.register("run_number").address, _words(run_number=run, command=pressure_pa))


async def _claim(bus: Transport, run: int, claim: Claim) -> None:
    await bus.write(1, MAP.register("claim_run").address, _words(claim_run=run, claim=claim))


async def _meddled(folder: Path, mode: str, meddle: Meddling) -> tuple[PlayOutcome, Any]:
    """Play a test while another master does something; the outcome and the station."""
    async with station(folder, "tcp", "polled", None) as found:
        port = int(found.plant.addresses[0].rpartition(":")[2])
        address = TcpAddress("bus", "127.0.0.1", port, timeout_s=1.0)
        ours, theirs = Transport(address), Transport(address)
        await ours.open()
        await theirs.open()
        work: list[asyncio.Task[None]] = []

        def on_progress(_share: float, phase: str) -> None:
            if phase == "playing" and not work:
                work.append(asyncio.get_running_loop().create_task(_go(meddle, theirs)))

        try:
            outcome = await play_sequence(
                connect_valve(
                    replace(WIRING, tag=TAG, limits=replace(LIMITS, pressure_pa=(0.0, 82_737.0))), {"bus": ours}
                ),
                WAVE,
                mode=mode,
                period_s=0.04 if mode == "polled" else 0.01,
                run_number=7,
                stop=asyncio.Event(),
                on_samples=lambda _: None,
                on_progress=on_progress,
                limits=replace(LIMITS, pressure_pa=(0.0, 82_737.0)),
                provenance=Provenance(),
            )
            work[0].cancel()
            await asyncio.gather(*work, return_exceptions=True)
            found.plant.look()
            return outcome, found
        finally:
            await ours.close()
            await theirs.close()


async def _go(meddle: Meddling, bus: Transport) -> None:
    await meddle(bus)


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_commands_of_another_run_do_not_count_and_disturb_nothing(tmp_path: Path, mode: str) -> None:
    async def meddle(bus: Transport) -> None:
        while True:
            await _command(bus, 8, 75_000.0)
            await asyncio.sleep(0.05)

    outcome, found = await _meddled(tmp_path, mode, meddle)
    assert (outcome.ended, outcome.error, outcome.safe_confirmed) == (Ended.COMPLETED, None, True)
    events = [event for _, event in found.events]
    assert any(event.happening is Happening.FENCED for event in events)
    assert 75_000.0 not in [event.pressure_pa for event in events if event.happening is Happening.COMMANDED]


async def test_a_master_that_ends_a_capture_by_a_command_ends_the_test(tmp_path: Path) -> None:
    async def meddle(bus: Transport) -> None:
        await asyncio.sleep(0.5)
        await _command(bus, 7, 45_000.0)

    outcome, _ = await _meddled(tmp_path, "captured", meddle)
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.FAILED, True)
    assert "ended its capture" in str(outcome.error)


@pytest.mark.parametrize("pause_s", [0.01, 0.1])
async def test_a_master_that_writes_under_our_run_is_told_though_we_write_over_it(
    tmp_path: Path, pause_s: float
) -> None:
    async def meddle(bus: Transport) -> None:
        while True:
            await _command(bus, 7, 75_000.0)
            await asyncio.sleep(pause_s)

    outcome, _ = await _meddled(tmp_path, "polled", meddle)
    assert outcome.ended is Ended.FAILED
    assert "another master" in str(outcome.error) or "nobody else commands it" in str(outcome.error), outcome.error


async def _take(bus: Transport) -> None:
    await asyncio.sleep(0.5)
    await _claim(bus, 7, Claim.RELEASE)
    await _claim(bus, 99, Claim.TAKE)
    await _command(bus, 99, 70_000.0)


async def test_a_master_that_takes_the_device_is_told_and_the_valve_is_not_called_safe(tmp_path: Path) -> None:
    outcome, found = await _meddled(tmp_path, "polled", _take)
    assert outcome.ended is Ended.FAILED
    said = ("run 99 took", "nobody else commands it")
    assert any(words in str(outcome.error) for words in said), outcome.error
    assert outcome.safe_confirmed is False, "it stands where the other master put it"
    assert found.asked_pa == pytest.approx(70_000.0, abs=10.0)


async def test_a_device_that_plays_by_itself_cannot_be_taken(tmp_path: Path) -> None:
    outcome, found = await _meddled(tmp_path, "captured", _take)
    assert (outcome.ended, outcome.error, outcome.safe_confirmed) == (Ended.COMPLETED, None, True)
    assert 99 in [event.run for _, event in found.events if event.happening is Happening.FENCED]


# ---- the audit log


@pytest.mark.parametrize("event", ["motion.armed", "motion.ended"])
async def test_an_audit_log_that_refuses_moves_nothing_or_ends_with_the_valve_safe_and_says_so(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch, event: str
) -> None:
    append = AuditLog.append

    def refusing(log: AuditLog, what: str, **details: Any) -> None:
        if what == event:
            raise AuditError("the audit log cannot be written (No space left on device)")
        append(log, what, **details)

    monkeypatch.setattr(AuditLog, "append", refusing)
    async with station(quick_path, "tcp", "polled", None) as found:
        async with running_service(load_plant(found.plant_file), None, FakeAnalyst()) as client:
            body = (await client.post("/tests/run", json=dict(ORDER), headers={"Prefer": "wait=15"})).json()
        assert body["state"] == "failed", json.dumps(body)
        assert "audit log" in body["error"]
        moves = [one for _, one in found.events if one.happening is Happening.COMMANDED]
        if event == "motion.armed":
            assert "nothing was moved" in body["error"]
            assert found.events == []
        else:
            assert moves != []
            assert body["safe_confirmed"] is True
            assert await found.until_safe(0.0)
