"""Valves read in service: only reads reach the wire, each slot in its time, and what moved is kept."""

from __future__ import annotations

import asyncio
import os
import pty
import time
import tty
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
import structlog

from drivers.addresses import GaugeAddress, Parity, Point, RtuAddress, TcpAddress
from drivers.motion.bus_lock import BusLocks
from drivers.motion.watch_file import days_in, read_watch_file
from drivers.motion.watch_keeper import Row, WatchedValve, WatchKeeper
from drivers.motion.watched_bus import WatchedBus
from drivers.transport import ReadTransport
from drivers.watch_rules import WatchRules, WatchSpan
from tests.support.played_device import WIRING
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import Fault, RawSlave, SerialPort, TcpPort
from tests.support.watching import READS, WATCHED, Plant, functions, is_watched, swinging, until, watching


@pytest.fixture
def address(tcp_port: TcpPort) -> TcpAddress:
    return TcpAddress("bus", "127.0.0.1", tcp_port.port, timeout_s=0.3)


def kept_rows(folder: Path) -> np.ndarray[Any, Any]:
    (day,) = days_in(folder)
    return read_watch_file(day.path)[1]


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


@pytest.mark.parametrize("kind", [ReadTransport, WatchedBus])
def test_what_reads_in_service_has_no_way_to_write(kind: type) -> None:
    assert not {name for name in dir(kind) if "write" in name.lower() or "command" in name.lower()}


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


async def test_a_register_that_is_not_there_is_why_a_valve_is_unread_until_it_is_there(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    began = datetime.now(UTC)
    async with watching(quick_path, address) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 3, "the first samples")
        assert watch.unread() == {}
        slave.always = Fault(exception=2)
        await until(lambda: watch.slots["FV-101"].failed >= 5, "five refusals")
        unread = watch.unread()["FV-101"]
        slave.always = Fault()
        await until(lambda: watch.unread() == {}, "it is there")
    assert "device 1" in unread.reason
    assert "has no such register: " in unread.reason
    assert began <= unread.since <= datetime.now(UTC)


async def test_a_position_that_is_no_value_is_why_nothing_is_kept_and_is_said_once(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress
) -> None:
    with structlog.testing.capture_logs() as said:
        async with watching(quick_path, address) as watch:
            device.position_m = lambda _: float("nan")
            await until(lambda: bool(watch.unread()), "it is noted")
            read = watch.slots["FV-101"].read
            await until(lambda: watch.slots["FV-101"].read > read + 3, "more of the same")
            assert "look at its transmitter" in watch.unread()["FV-101"].reason
            device.position_m = lambda _: 0.05
            await until(lambda: not watch.unread(), "there is a position")
    assert sum("shows no position" in one["event"] for one in said) == 1


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


async def test_valves_that_begin_together_hand_their_samples_on_one_after_the_other(
    quick_path: Path,
    slave: RawSlave,
    device: ReferenceDevice,
    address: TcpAddress,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # the samples of 200 valves at once kept all reads waiting for 0.2 s
    rules = WatchRules(0.1)  # a block of 50 rows
    wirings = [replace(WATCHED, tag=f"FV-{number}", watch=rules) for number in range(4)]
    first: dict[str, int] = {}

    def take(_keeper: WatchKeeper, valve: WatchedValve, _span: WatchSpan, rows: Sequence[Row]) -> None:
        first.setdefault(valve.tag, len(rows))

    monkeypatch.setattr(WatchKeeper, "take", take)
    async with watching(quick_path, address, *wirings):
        await until(lambda: len(first) == len(wirings), "a block of each")
    assert first == {"FV-0": 12, "FV-1": 12, "FV-2": 25, "FV-3": 38}


class SetClock(datetime):
    """A clock that somebody sets: it is ``ahead`` of the true one."""

    ahead = timedelta(days=3650)

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> Self:
        return super().now(tz) + cls.ahead


async def test_a_clock_that_was_ahead_and_is_set_right_has_the_day_that_it_shows(
    quick_path: Path, slave: RawSlave, device: ReferenceDevice, address: TcpAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.motion.watching.datetime", SetClock)
    swinging(device)
    async with watching(quick_path, address) as watch:
        await until(lambda: watch.slots["FV-101"].read >= 260, "a first block")
        monkeypatch.setattr(SetClock, "ahead", timedelta())
        read, began = watch.slots["FV-101"].read, datetime.now(UTC)
        await until(lambda: watch.slots["FV-101"].read >= read + 260, "a further one")
    right, ahead = days_in(quick_path)
    assert ahead.day - right.day == timedelta(days=3650)
    rows = read_watch_file(right.path)[1]
    assert len(rows) >= 250
    assert began.timestamp() - 1.0 <= rows[0, 0] <= rows[-1, 0] <= datetime.now(UTC).timestamp()


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
