"""What is watched beside the samples during a test: contacts on other buses, the owner; each by its own time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace

import pytest

from drivers.addresses import Parity, Point, RtuAddress, TcpAddress
from drivers.device import connect_valve
from drivers.outcome import Ended, PlayOutcome, SampleBlock
from drivers.permissive_rules import Contact, PermissiveRules
from drivers.transport import Transport
from tests.support.played_device import SAFE_PA, WIRING, Bench, until
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import Fault, RawSlave, TcpPort
from tests.support.stopwatch import Stopwatch
from valve.errors import ConfigurationError, PermissiveError, WireError
from valve.waveform import triangle

LONG = triangle(20.0, 1, 10_000.0, 60_000.0)
CLOSED, OPEN, INVALID = 12_000, 3_000, 0xFFFF  # words of an input of 4-20 mA: 6.9, 4.7 and 20 mA
MANUAL = Contact("remote", 9, "advantech_adam_6024", "ai2", above=0.006)
LOCKED = Contact("remote", 9, "advantech_adam_6024", "ai3", above=0.006)
SUPPLY = Point("remote", 9, "advantech_adam_6024", "ai4", (0.004, 0.020), (0.0, 400_000.0))
RULES = PermissiveRules(manual=MANUAL, interlock=LOCKED, supply=SUPPLY, supply_pa=(100_000.0, 300_000.0))
DEAD = Fault(drop=True, silent_execution=False)


@asynccontextmanager
async def remote(rules: PermissiveRules = RULES, watchdog_s: float = 2.0) -> AsyncIterator[tuple[Bench, RawSlave]]:
    """A valve on a bus of its own, and its contacts and its supply on another bus."""
    wiring = replace(WIRING, permissives=rules, watchdog=replace(WIRING.watchdog, timeout_s=watchdog_s))
    device, contacts = ReferenceDevice(RawSlave()), RawSlave()
    device.status = 0  # its own status says nothing of the loop
    for address in range(32):
        contacts.holding[9, address] = 0
    contacts.holding[9, 2], contacts.holding[9, 3], contacts.holding[9, 4] = CLOSED, OPEN, 32_768
    async with TcpPort(device.slave) as own, TcpPort(contacts) as other:
        buses = {
            "bus": Transport(TcpAddress("bus", "127.0.0.1", own.port, timeout_s=0.5)),
            "remote": Transport(TcpAddress("remote", "127.0.0.1", other.port, timeout_s=0.3)),
        }
        for bus in buses.values():
            await bus.open()
        try:
            yield Bench(device, connect_valve(wiring, buses)), contacts
        finally:
            for bus in buses.values():
                await bus.close()


async def ended(bench: Bench, contacts: RawSlave, fault: Fault, mode: str = "polled") -> tuple[PlayOutcome, float]:
    """Play until the test ends by itself, the contacts' bus broken from the midst on; and how long that took."""
    playing = asyncio.create_task(bench.play(LONG, mode=mode, period_s=0.02 if mode == "polled" else 0.001))
    await until(lambda: any(phase == "playing" and share > 0.06 for share, phase in bench.phases))
    contacts.always = fault
    watch = Stopwatch()
    outcome = await asyncio.wait_for(playing, 15.0)
    return outcome, watch.own_s


@pytest.mark.parametrize("mode", ["polled", "captured"])
@pytest.mark.parametrize("unread_s", [1.0, 2.5])
async def test_a_bus_of_contacts_that_dies_ends_the_test_in_their_time_and_is_named(mode: str, unread_s: float) -> None:
    async with remote(replace(RULES, unread_s=unread_s)) as (bench, contacts):
        outcome, took_s = await ended(bench, contacts, DEAD, mode)
    assert (outcome.ended, outcome.safe_confirmed) == (Ended.FAILED, True)
    assert "permissive lost" in str(outcome.error)
    assert (
        "ai2 of device 9 on remote" in str(outcome.error)
        or "ai3 of device 9 on remote" in str(outcome.error)
        or ("ai4 of device 9 on remote" in str(outcome.error))
    )
    assert bench.moved_pa[-1] == SAFE_PA
    assert 0.6 * unread_s < took_s < unread_s + 0.8


@pytest.mark.parametrize(
    ("rules", "place"),
    [
        (replace(RULES, interlock=None, supply=None, supply_pa=None), "ai2 of device 9 on remote"),
        (PermissiveRules(manual_waived="none", interlock=LOCKED), "ai3 of device 9 on remote"),
        (PermissiveRules(manual_waived="none", supply=SUPPLY, supply_pa=(1.0e5, 3.0e5)), "ai4 of device 9 on remote"),
    ],
)
async def test_each_place_elsewhere_has_its_own_time(rules: PermissiveRules, place: str) -> None:
    async with remote(rules) as (bench, contacts):
        outcome, _ = await ended(bench, contacts, DEAD)
    assert outcome.ended is Ended.FAILED
    assert place in str(outcome.error)


async def test_a_dead_bus_of_contacts_costs_the_samples_of_the_valve_nothing() -> None:
    async with remote(replace(RULES, unread_s=3.0)) as (bench, contacts):
        outcome, _ = await ended(bench, contacts, DEAD)
    assert outcome.recording is not None
    assert outcome.recording.gaps == 0
    assert outcome.recording.sampling_quality().missed_slots < 0.1 * outcome.recording.samples


async def test_an_answer_that_is_lost_now_and_then_ends_no_test() -> None:
    async with remote() as (bench, contacts):
        playing = asyncio.create_task(bench.play(triangle(6.0, 1, 10_000.0, 60_000.0)))
        while not playing.done():
            await asyncio.sleep(1.2)
            contacts.faults.append(Fault(drop=True))
        outcome = await playing
    assert (outcome.ended, outcome.error) == (Ended.COMPLETED, None)


async def test_a_contact_that_shows_no_valid_value_is_lost_in_its_time() -> None:
    async with remote() as (bench, contacts):
        contacts.on_read = lambda *_: None
        playing = asyncio.create_task(bench.play(LONG))
        await until(lambda: any(phase == "playing" for _, phase in bench.phases))
        contacts.holding[9, 4] = INVALID  # 20 mA is the supply's upper end, and above its limit
        outcome = await asyncio.wait_for(playing, 15.0)
    assert outcome.ended is Ended.FAILED
    assert "air supply" in str(outcome.error)


async def test_a_contact_that_opens_and_closes_in_turns_is_lost() -> None:
    async with remote(replace(RULES, supply=None, supply_pa=None)) as (bench, contacts):
        reads = [0]

        def toggle(_unit: int, address: int, _count: int) -> None:
            if address == 2:
                reads[0] += 1
                contacts.holding[9, 2] = OPEN if playing_now and reads[0] % 2 else CLOSED

        playing_now: list[bool] = []
        contacts.on_read = toggle
        bench.on_phase = lambda phase: playing_now.append(True) if phase == "playing" else None
        outcome = await asyncio.wait_for(bench.play(LONG), 15.0)
    assert outcome.ended is Ended.FAILED
    assert "no longer in manual" in str(outcome.error)


@pytest.mark.parametrize("how", ["a contact", "a dead bus"])
async def test_what_is_lost_between_two_slow_samples_is_heard_at_once_and_not_with_the_next_one(how: str) -> None:
    async with remote(replace(RULES, unread_s=0.5), watchdog_s=15.0) as (bench, contacts):
        lost_s: list[float] = []
        samples: list[float] = []

        def kept(block: SampleBlock) -> None:
            samples.append(time.monotonic())
            if len(samples) == 2:
                lost_s.append(time.monotonic())
                if how == "a contact":
                    contacts.holding[9, 2] = OPEN
                else:
                    contacts.always = DEAD

        outcome = await asyncio.wait_for(bench.play(LONG, period_s=2.5, on_samples=kept), 20.0)
    assert outcome.ended is Ended.FAILED
    assert "permissive lost" in str(outcome.error)
    (at_s,) = [at_s for at_s, pressure_pa in bench.device.moves if pressure_pa == SAFE_PA and at_s > lost_s[0]][:1]
    assert at_s - lost_s[0] < 1.5


# ---- at the first write


@pytest.mark.parametrize("mode", ["polled", "captured"])
async def test_at_the_first_write_every_permissive_was_read_within_half_a_second(mode: str) -> None:
    async with remote() as (bench, contacts):
        read_s: dict[int, float] = {}
        first_s: list[float] = []
        contacts.on_read = lambda _unit, address, _count: (
            read_s.update({address: time.monotonic()}) if not first_s else None
        )

        async def slow(*_: object) -> None:
            await asyncio.sleep(1.5)  # journal, audit log and database on a bad day

        obey = bench.device.on_write

        def watched(unit: int, address: int, words: list[int]) -> int | None:
            if address == 32 and not first_s:
                first_s.append(time.monotonic())
            return obey(unit, address, words)

        bench.device.slave.on_write = watched
        outcome = await bench.play(
            triangle(0.5, 1, 10_000.0, 60_000.0), mode=mode, on_ready=slow, on_intent=slow, period_s=0.02
        )
    assert outcome.ended is Ended.COMPLETED
    assert read_s.keys() == {2, 3, 4}
    assert max(first_s[0] - at_s for at_s in read_s.values()) < 0.5


@pytest.mark.parametrize("mode", ["polled", "captured"])
@pytest.mark.parametrize("when", ["on_ready", "on_intent"])
async def test_a_permissive_that_is_lost_while_the_test_is_prepared_keeps_the_valve_where_it_is(
    when: str, mode: str
) -> None:
    async with remote() as (bench, contacts):
        bench.device.output_pa = 30_000.0

        async def lose(*_: object) -> None:
            contacts.holding[9, 2] = OPEN

        with pytest.raises(PermissiveError, match="loop_in_manual"):
            await (
                bench.play(mode=mode, on_ready=lose) if when == "on_ready" else bench.play(mode=mode, on_intent=lose)
            )
        assert (bench.moved_pa, bench.device.output_pa, bench.valve.commanded) == ([], 30_000.0, False)
        assert bench.device.value("run_owner") == 0


@pytest.mark.parametrize("lost", [True, False])
async def test_a_process_that_stood_still_before_the_first_write_reads_the_permissives_again(lost: bool) -> None:
    async with remote() as (bench, contacts):
        bench.device.output_pa = 30_000.0
        stood: list[float] = []

        def stand_still(phase: str) -> None:
            if phase == "ramping" and not stood:
                stood.append(time.monotonic())
                time.sleep(0.8)  # as under SIGSTOP, or without a core: the permissives have been read just now
                contacts.holding[9, 2] = OPEN if lost else CLOSED

        bench.on_phase = stand_still
        if lost:
            with pytest.raises(PermissiveError, match="loop_in_manual"):
                await bench.play()
            assert (bench.moved_pa, bench.valve.commanded) == ([], False)
        else:
            assert (await bench.play()).ended is Ended.COMPLETED


@pytest.mark.parametrize("entry_pa", [0.0, 10_000.0])  # which is where the waveform begins
async def test_a_machine_that_never_is_in_time_moves_nothing(entry_pa: float) -> None:
    async with remote() as (bench, _):
        bench.device.output_pa = entry_pa
        bench.on_phase = lambda phase: time.sleep(0.8) if phase == "ramping" else None
        with pytest.raises(PermissiveError, match="too busy"):
            await bench.play()
        assert (bench.moved_pa, bench.device.value("run_owner")) == ([], 0)


async def test_a_device_that_falls_silent_before_the_first_write_is_given_back_and_not_moved() -> None:
    async with remote() as (bench, _):
        bench.device.output_pa = 30_000.0
        slave = bench.device.slave

        def fall_silent(phase: str) -> None:
            if phase == "ramping":
                slave.always = DEAD
                time.sleep(0.6)

        bench.on_phase = fall_silent
        with pytest.raises(WireError):
            await bench.play()
        assert (bench.moved_pa, bench.valve.commanded) == ([], False)


async def test_a_safe_value_at_entry_that_somebody_changed_meanwhile_keeps_the_valve_where_it_is() -> None:
    async with remote() as (bench, _):
        bench.valve.wiring = replace(bench.valve.wiring, safe_value_pa="entry")

        async def moved(*_: object) -> None:
            bench.device.output_pa = 50_000.0

        bench.device.output_pa = 30_000.0
        with pytest.raises(PermissiveError, match="from 30000 to 50000 Pa"):
            await bench.play(on_intent=moved)
        assert bench.moved_pa == []


async def test_nothing_is_commanded_by_a_look_that_is_older_than_half_a_second() -> None:
    async with remote() as (bench, _):
        slave = bench.device.slave
        seen: list[str] = []

        show, obey = bench.device.on_read, bench.device.on_write

        def note(unit: int, address: int, count: int) -> None:
            seen.append("read")
            show(unit, address, count)

        def watched(unit: int, address: int, words: list[int]) -> int | None:
            if address == 32:
                seen.append("command")
            return obey(unit, address, words)

        slave.on_read, slave.on_write = note, watched
        outcome = await bench.play(triangle(6.0, 1, 10_000.0, 60_000.0), period_s=0.8)
    assert outcome.ended is Ended.COMPLETED
    commands = [place for place, what in enumerate(seen) if what == "command"]
    assert all(seen[place - 1] == "read" for place in commands)
    slow = seen[commands[-9] : commands[-1]]
    assert slow.count("read") >= 2 * slow.count("command") - 2


def test_the_time_that_a_permissive_may_stay_unread_has_its_limits_and_fits_a_slow_line() -> None:
    for unread_s in (0.1, 11.0):
        with pytest.raises(ConfigurationError, match="unread_s"):
            PermissiveRules(unread_s=unread_s)
    line = Transport(RtuAddress("remote", "/dev/null", 9600, Parity.NONE))
    own = Transport(TcpAddress("bus", "127.0.0.1", 1))
    device = connect_valve(replace(WIRING, permissives=RULES), {"bus": own, "remote": line})
    assert 2.5 < device.unread_s("manual") < 3.0, "one lost answer costs two seconds there"
