"""Valves read in service: only reads reach the wire, and whoever takes the bus has it after one transaction."""

from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import socket
import time
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import structlog

from drivers.addresses import BusAddress, GaugeAddress, Parity, Point, RtuAddress, TcpAddress, ValveWiring
from drivers.motion.bus_lock import FOLDER_VARIABLE, BusLocks, is_taken, watch_name
from drivers.motion.motion import Motion
from drivers.motion.orders import Order
from drivers.motion.rig import WiredRig
from drivers.motion.watch_file import days_in, read_watch_file
from drivers.motion.watch_post import ask_to_leave
from drivers.motion.watched_bus import WatchedBus
from drivers.motion.watching import Watching
from drivers.outcome import Ended
from drivers.stands_at import RestRules
from drivers.transport import ReadTransport
from drivers.watch_rules import WatchRules
from tests.support.played_device import WIRING
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import Fault, RawSlave, SerialPort, TcpPort
from valve.errors import BusyError
from valve.waveform import triangle

READS = {1, 2, 3, 4}
RULES = WatchRules(0.02)
WATCHED = replace(WIRING, rest=RestRules(after_s=0.0, travel_m=0.1), watch=RULES)


@dataclass
class Plant:
    wirings: dict[str, ValveWiring]

    def read(self) -> None:
        """Nothing is read."""

    def take(self, fresh: None, kept: frozenset[str]) -> None:
        """It is taken over already."""

    def settle(self, tag: str) -> None:
        """It is settled already."""


async def until(condition: Callable[[], bool], what: str, within_s: float = 20.0) -> None:
    deadline_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline_s, f"{what} did not happen within {within_s:g} s"
        await asyncio.sleep(0.005)


@asynccontextmanager
async def watching(
    folder: Path,
    address: BusAddress,
    *wirings: ValveWiring,
    plant: Plant | None = None,
    beside: BusAddress | None = None,
    after_s: float = 0.0,
) -> AsyncIterator[Watching]:
    plant = plant or Plant({one.tag: one for one in wirings or (WATCHED,)})
    addresses = {one.name: one for one in (address, beside) if one is not None}
    watch = Watching(plant, addresses, folder, "breakaway 0", after_s=lambda: after_s)
    running = asyncio.create_task(watch.run())
    try:
        yield watch
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running


@pytest.fixture
def address(tcp_port: TcpPort) -> TcpAddress:
    return TcpAddress("bus", "127.0.0.1", tcp_port.port, timeout_s=0.3)


@pytest.fixture
def leavings(slave: RawSlave, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return how many requests came while a bus was being left, for each time that one was, up to now."""
    counted: list[int] = []
    leave = WatchedBus._leave

    async def counting(bus: WatchedBus) -> None:
        before = len(slave.requests)
        await leave(bus)
        counted.append(len(slave.requests) - before)

    monkeypatch.setattr(WatchedBus, "_leave", counting)
    return counted


def functions(slave: RawSlave) -> set[int]:
    return {request[1] for request in slave.requests}


def kept_rows(folder: Path) -> np.ndarray[Any, Any]:
    (day,) = days_in(folder)
    return read_watch_file(day.path)[1]


def swinging(device: ReferenceDevice) -> None:
    """Let a controller move the valve: its pressure goes to and fro once a second."""
    began_s = time.monotonic()
    device.position_m = lambda _: 0.05 + 0.02 * float(np.sin(2.0 * np.pi * (time.monotonic() - began_s)))


async def test_nothing_but_reads_reaches_the_wire_and_what_moved_is_kept(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    swinging(device)
    device.output_pa = 40_000.0
    began = datetime.now(UTC).timestamp()
    async with watching(quick_path, address) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 320, "320 samples")
    assert functions(slave) <= READS
    assert not slave.writes
    assert device.moves == []
    rows = kept_rows(quick_path)
    assert len(rows) >= 300
    assert np.all(np.diff(rows[:, 0]) > 0.0)
    assert began <= rows[0, 0] <= rows[-1, 0] <= datetime.now(UTC).timestamp()
    slots = watch.slots["FV-101"]
    assert np.ptp(rows[:, 0]) == pytest.approx(0.02 * (slots.read + slots.missed), rel=0.1)
    assert np.ptp(rows[:, 1]) == pytest.approx(0.04, rel=0.05)
    assert np.all(rows[:, 2:] == 40_000.0)
    assert slave.most_in_flight == 1


async def test_on_a_serial_line_too_only_reads_arrive(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, serial_port: SerialPort
) -> None:
    line = RtuAddress("bus", serial_port.path, 115200, Parity.NONE, timeout_s=0.3, worst_latency_s=0.3)
    async with watching(quick_path, line) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 20, "20 samples")
    assert functions(slave) <= READS


@pytest.mark.parametrize("is_silent", [False, True], ids=["answers", "is silent"])
async def test_a_test_on_a_watched_serial_line_finds_its_port_free_and_its_line_quiet(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, serial_port: SerialPort, is_silent: bool
) -> None:
    line = RtuAddress("bus", serial_port.path, 115200, Parity.NONE, timeout_s=0.3, worst_latency_s=0.5)
    plant = Plant({"FV-101": WATCHED})
    motion = Motion(
        plant, WiredRig({"bus": line}, "breakaway 0"), quick_path / "journals", locks=BusLocks({"bus": line})
    )
    (quick_path / "journals").mkdir()
    async with watching(quick_path / "watched", line, plant=plant) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 5, "5 samples")
        if is_silent:  # its answer comes when nobody waits for it any more, and must not meet the test's first request
            slave.always = Fault(delay_s=0.4)
            asked = len(slave.requests)
            await until(lambda: len(slave.requests) > asked, "a request whose answer is late")
        order = Order("20261121T031502Z-9f3c01ab", "FV-101", triangle(1.0, 1, 10_000.0, 30_000.0), "triangle", 1)
        playing = asyncio.create_task(motion.play(order))
        if is_silent:
            await until(lambda: watch.slots["FV-101"].failed > 0, "its deadline")
            slave.always = Fault()
        end = await playing
        if is_silent:
            silent_s, first_s = slave.asked_s[asked : asked + 2]
            assert first_s - silent_s >= line.worst_latency_s
        assert end.outcome.ended is Ended.COMPLETED, end.outcome.error
        assert end.outcome.safe_confirmed


@pytest.mark.parametrize("kind", [ReadTransport, WatchedBus])
def test_what_reads_in_service_has_no_way_to_write(kind: type) -> None:
    assert not {name for name in dir(kind) if "write" in name.lower() or "command" in name.lower()}


async def test_a_test_has_the_bus_after_one_transaction_and_watching_goes_on_behind_it(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress, leavings: list[int]
) -> None:
    answer_s = 0.05
    slave.always = Fault(delay_s=answer_s)  # each slot is late: a read is in flight all the time
    plant = Plant({"FV-101": WATCHED})
    locks = BusLocks({"bus": address})
    motion = Motion(plant, WiredRig({"bus": address}, "breakaway 0"), quick_path / "journals", locks=locks)
    (quick_path / "journals").mkdir()
    async with watching(quick_path / "watched", address, plant=plant) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 5, "5 samples")
        for _ in range(5):
            await locks.take_aside(["bus"])
            asked = len(slave.requests)
            await asyncio.sleep(2.0 * answer_s)
            assert len(slave.requests) == asked, "somebody read while the bus was taken"
            locks.give_back(["bus"])
            read = watch.slots["FV-101"].read
            await until(lambda read=read: watch.slots["FV-101"].read > read, "watching went on")  # type: ignore[misc]
        assert len(leavings) == 5
        assert max(leavings) <= 1  # the one that was on its way as the bus was asked for
        slave.always = Fault()
        wave = triangle(0.5, 1, 10_000.0, 30_000.0)
        order = Order("20261121T031502Z-9f3c01ab", "FV-101", wave, "triangle", 1)
        asked = len(slave.requests)
        end = await motion.play(order)
        assert end.outcome.ended is Ended.COMPLETED
        assert end.outcome.safe_confirmed
        own = slave.requests[asked:]
        assert slave.most_in_flight == 1
        assert any(request[1] == 16 for request in own)
        read = watch.slots["FV-101"].read
        await until(lambda: watch.slots["FV-101"].read > read + 5, "watching went on")
        ended = len(slave.requests)
        await until(lambda: len(slave.requests) > ended + 20, "20 further reads")
        assert {request[1] for request in slave.requests[ended:]} <= READS


@pytest.mark.parametrize("folder", [True, False], ids=["lock files", "kernel names"])
async def test_another_process_that_takes_the_bus_is_alone_on_it(
    quick_path: Path, device: ReferenceDevice, address: TcpAddress, monkeypatch: pytest.MonkeyPatch, folder: bool
) -> None:
    slave = device.slave
    if not folder:
        monkeypatch.delenv(FOLDER_VARIABLE)
    others = BusLocks({"bus": address})
    others.take(["bus"])
    assert is_taken(address)
    async with watching(quick_path, address) as watch:
        await asyncio.sleep(0.2)
        assert slave.requests == []  # it was taken before anybody watched
        others.give_back(["bus"])
        await until(lambda: watch.slots["FV-101"].read >= 3, "the first samples")
        assert not is_taken(address)  # who watches takes no bus from anybody
        await others.take_aside(["bus"])
        asked = len(slave.requests)
        await asyncio.sleep(0.2)
        assert len(slave.requests) == asked
        others.give_back(["bus"])
        await until(lambda: len(slave.requests) > asked, "watching went on")


async def test_one_process_alone_watches_a_bus_and_the_next_one_behind_it(
    quick_path: Path, device: ReferenceDevice, address: TcpAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.motion.watching._RAREST_S", 0.02)
    with structlog.testing.capture_logs() as said:
        async with AsyncExitStack() as later:
            async with watching(quick_path / "first", address) as first:
                await until(lambda: first.slots["FV-101"].read >= 3, "the first samples")
                with pytest.raises(BusyError, match="another process watches it"):
                    await WatchedBus(address).start()
                second = await later.enter_async_context(watching(quick_path / "second", address))
                await until(lambda: any(one["event"] == "bus not watched" for one in said), "the refusal")
                read = first.slots["FV-101"].read
                await until(lambda: first.slots["FV-101"].read > read + 5, "the first goes on")
                assert second.slots["FV-101"].read == 0
            await until(lambda: second.slots["FV-101"].read >= 3, "the second, once the first has ended")
    assert sum(one["event"] == "bus not watched" for one in said) == 1


async def test_a_watcher_that_hangs_keeps_no_test_from_its_bus(
    address: TcpAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.motion.bus_lock._LEAVING_S", 0.05)
    monkeypatch.delenv(FOLDER_VARIABLE)
    locks = BusLocks({"bus": replace(address, timeout_s=0.05)})
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as hung, structlog.testing.capture_logs() as said:
        hung.bind(watch_name(address))
        hung.listen(1)
        await locks.take_aside(["bus"])
    assert locks.held == {"bus"}
    assert [one["bus"] for one in said if "did not leave it in time" in one["event"]] == ["bus"]
    locks.give_back(["bus"])
    assert not is_taken(address)


async def test_a_valve_that_does_not_answer_is_asked_more_rarely_and_said_once(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    quick = replace(address, timeout_s=0.2)
    with structlog.testing.capture_logs() as said:
        async with watching(quick_path, quick) as watch:
            await until(lambda: watch.slots["FV-101"].read >= 3, "the first samples")
            slave.always = Fault(drop=True)
            await until(lambda: watch.slots["FV-101"].failed >= 5, "five silent slots")
            failed_s = time.monotonic()
            asked = len(slave.requests)
            slave.always = Fault()
            await until(lambda: any(one["event"].endswith("answers again") for one in said), "it answered again")
    waited_s = time.monotonic() - failed_s
    assert waited_s > 1.0  # behind five failures it is asked after four seconds
    assert len(slave.requests) - asked < 30
    assert sum("does not answer" in one["event"] for one in said) == 1


async def test_another_device_behind_the_address_is_not_taken_for_the_valve(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    device.show(canary=1)
    with structlog.testing.capture_logs() as said:
        async with watching(quick_path, address) as watch:
            await until(lambda: watch.slots["FV-101"].failed >= 3, "three refusals")
            assert watch.slots["FV-101"].read == 0
    assert "another device answers" in next(one["reason"] for one in said if "does not answer" in one["event"])


async def test_slots_that_a_slow_bus_has_no_time_for_are_counted(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    slave.always = Fault(delay_s=0.05)
    async with watching(quick_path, address) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 20, "20 samples")
        lasted_s = time.monotonic() - slave.asked_s[0]
        slots = watch.slots["FV-101"]
        assert slots.missed > slots.read  # 50 ms and more an answer, 20 ms a slot
        assert slots.read + slots.missed == pytest.approx(lasted_s / 0.02, abs=12)


async def test_outside_its_hours_a_valve_is_not_read(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    now = datetime.now().astimezone()
    begins, ends = ((now + timedelta(hours=hours)).time().replace(second=0, microsecond=0) for hours in (2, 3))
    later = WatchRules(0.02, begins, ends)
    awake = replace(WATCHED, tag="FV-102", command=Point("bus", 1, "reference"))
    asleep = replace(WATCHED, watch=later)
    async with watching(quick_path, address, asleep, awake) as watch:
        await until(lambda: watch.slots["FV-102"].read >= 20, "20 samples of the other")
        assert watch.slots["FV-101"].read == 0


async def test_a_plant_file_that_is_read_again_is_taken_over(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    plant = Plant({"FV-101": WIRING})
    async with watching(quick_path, address, plant=plant) as watch:
        plant.wirings = {"FV-101": WATCHED}
        watch.refresh()
        await until(lambda: watch.slots["FV-101"].read >= 3, "the first samples")
        plant.wirings = {"FV-101": WIRING}
        watch.refresh()
        await until(lambda: not is_watched(address), "the bus was left")
        asked = len(slave.requests)
        await asyncio.sleep(0.1)
        assert len(slave.requests) == asked


def is_watched(address: BusAddress) -> bool:
    asked = ask_to_leave(watch_name(address), 0.01)
    if asked is not None:
        asked.close()
    return asked is not None


async def test_a_bus_whose_device_is_silent_is_left_within_the_deadline_of_its_answer(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress, leavings: list[int]
) -> None:
    slave.always = Fault(drop=True)
    locks = BusLocks({"bus": address})
    async with watching(quick_path, address):
        await until(lambda: len(slave.requests) > 0, "the first request")
        await locks.take_aside(["bus"])
        assert len(leavings) == 1
        assert leavings[0] <= 1
        locks.give_back(["bus"])


async def test_a_bus_on_which_an_answer_failed_is_left_without_a_recovery_of_ours(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, serial_port: SerialPort, leavings: list[int]
) -> None:
    line = RtuAddress("bus", serial_port.path, 115200, Parity.NONE, timeout_s=0.3, worst_latency_s=0.5)
    locks = BusLocks({"bus": line})
    async with watching(quick_path, line) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 3, "the first samples")
        slave.always = Fault(delay_s=0.4)
        await until(lambda: watch.slots["FV-101"].failed > 0, "an answer that is late")
        slave.always = Fault()
        await asyncio.sleep(0.05)  # its next slot is due, and waits until the line must be quiet
        await locks.take_aside(["bus"])
        assert leavings[0] <= 1
        locks.give_back(["bus"])
        read = watch.slots["FV-101"].read
        await until(lambda: watch.slots["FV-101"].read > read + 3, "watching went on")


async def test_a_serial_line_is_quiet_before_it_is_given_up_in_the_middle_of_a_read(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, serial_port: SerialPort
) -> None:
    line = RtuAddress("bus", serial_port.path, 115200, Parity.NONE, timeout_s=2.0, worst_latency_s=0.5)
    slave.always = Fault(delay_s=1.0)
    plant = Plant({"FV-101": WATCHED})
    async with watching(quick_path, line, plant=plant) as watch:
        await until(lambda: len(slave.requests) > 0, "a request")
        plant.wirings, refreshed_s = {"FV-101": WIRING}, time.monotonic()
        watch.refresh()
        await until(lambda: not is_watched(line), "the line was given up")
        assert time.monotonic() - refreshed_s >= line.worst_latency_s


async def test_a_stop_ends_a_motion_at_once_where_its_bus_is_watched(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    plant = Plant({"FV-101": WATCHED})
    motion = Motion(
        plant, WiredRig({"bus": address}, "breakaway 0"), quick_path / "journals", locks=BusLocks({"bus": address})
    )
    (quick_path / "journals").mkdir()
    async with watching(quick_path / "watched", address, plant=plant) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 5, "5 samples")
        order = Order("20261121T031502Z-9f3c01ab", "FV-101", triangle(20.0, 1, 10_000.0, 30_000.0), "triangle", 1)
        playing = asyncio.create_task(motion.play(order))
        await until(lambda: len(device.moves) > 20, "the motion")
        read = watch.slots["FV-101"].read
        stopped_s = time.monotonic()
        motion.stop(order.run_id, "pressed")
        end = await playing
        assert end.outcome.ended is Ended.STOPPED
        assert end.outcome.safe_confirmed
        assert time.monotonic() - stopped_s < 10.0  # half of what the motion has left
        assert device.moves[-1][1] == WIRING.safe_value_pa
        assert watch.slots["FV-101"].read - read <= 1  # nobody read beside it


class TalkingGauge:
    """A gauge on a pseudo-terminal that shows 12.345 mm."""

    def __init__(self) -> None:
        self.asked = 0
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self.path = os.ttyname(self.theirs)
        asyncio.get_running_loop().add_reader(self.ours, self._heard)

    def _heard(self) -> None:
        os.read(self.ours, 100)
        self.asked += 1
        os.write(self.ours, b"+12.345 mm\r\n")

    def close(self) -> None:
        asyncio.get_running_loop().remove_reader(self.ours)
        os.close(self.ours)
        os.close(self.theirs)


async def test_a_position_from_a_gauge_is_read_beside_its_pressure_and_either_bus_is_left(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    gauge = TalkingGauge()
    line = GaugeAddress("gauge", gauge.path, "?\r", r"^(?P<value>[-+]?\d+\.\d+)\s*mm", "\r\n", "mm", timeout_s=0.5)
    seen_by_gauge = replace(WATCHED, position=Point("gauge"), watch=WatchRules(0.1))
    locks = BusLocks({"bus": address, "gauge": line})
    try:
        async with watching(quick_path, address, seen_by_gauge, beside=line) as watch:
            slots = watch.slots["FV-101"]
            await until(lambda: slots.read >= 3, "the first samples")
            for bus in ("gauge", "bus"):
                await locks.take_aside([bus])
                read, asked = slots.read, gauge.asked
                await asyncio.sleep(0.5)
                assert slots.read <= read + 1
                assert gauge.asked <= asked + 1
                locks.give_back([bus])
                await until(lambda read=read: slots.read > read + 2, "watching went on")  # type: ignore[misc]
        assert functions(slave) <= READS
        assert slots.failed == 0
    finally:
        gauge.close()


async def test_nothing_is_read_before_the_watchdog_of_a_valve_that_was_left_has_acted(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    """Whoever had the bus may have died, or failed to make its valve safe: at the start, and whenever it is free."""
    locks = BusLocks({"bus": address})
    began_s = time.monotonic()
    async with watching(quick_path, address, after_s=0.4) as watch:
        await until(lambda: watch.slots["FV-101"].read > 0, "the first sample")
        assert slave.asked_s[0] - began_s >= 0.4
        await locks.take_aside(["bus"])
        asked, given_back_s = len(slave.requests), time.monotonic()
        locks.give_back(["bus"])
        await until(lambda: len(slave.requests) > asked, "watching went on")
        assert slave.asked_s[asked] - given_back_s >= 0.4
