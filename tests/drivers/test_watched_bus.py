"""A bus on which valves are read in service: whoever takes it has it after one transaction."""

from __future__ import annotations

import asyncio
import gc
import os
import socket
import time
from collections.abc import Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import structlog

from drivers.addresses import BusAddress, Parity, RtuAddress, TcpAddress
from drivers.motion.bus_lock import FOLDER_VARIABLE, BusLocks, is_taken, watch_name
from drivers.motion.motion import Motion
from drivers.motion.orders import Order
from drivers.motion.rig import WiredRig
from drivers.motion.watch_post import WatchPost
from drivers.motion.watched_bus import WatchedBus
from drivers.outcome import Ended
from tests.support.played_device import WIRING
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import Fault, RawSlave, SerialPort, TcpPort
from tests.support.watching import READS, WATCHED, Plant, is_watched, until, watching
from valve.errors import BusyError
from valve.waveform import triangle


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
                assert "another process watches it: watch each" in second.unread()["FV-101"].reason
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


async def test_a_bus_that_was_taken_before_is_not_read_before_a_watchdog_could_act_since_it_is_free(
    quick_path: Path, device: ReferenceDevice, address: TcpAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its taker asked nobody: how long it is free counts from when that was seen, not from the look before."""
    slave, looks_s = device.slave, list[float]()

    def looked(place: BusAddress) -> bool:
        looks_s.append(time.monotonic())
        return is_taken(place)

    monkeypatch.setattr("drivers.motion.watched_bus.is_taken", looked)
    monkeypatch.setattr("drivers.motion.watched_bus._LOOK_AGAIN_S", 0.5)
    others = BusLocks({"bus": address})
    others.take(["bus"])
    async with watching(quick_path, address, after_s=0.6):
        await until(lambda: bool(looks_s), "a look")
        others.give_back(["bus"])
        await until(lambda: bool(slave.asked_s), "the first request")
    assert slave.asked_s[0] - looks_s[1] >= 0.6


async def test_whoever_takes_a_bus_waits_for_no_look_of_who_watches_it(
    quick_path: Path, device: ReferenceDevice, address: TcpAddress, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A watcher looks now and then whether a bus is free that was taken before: that keeps only itself waiting."""
    monkeypatch.setattr("drivers.motion.watched_bus._LOOK_AGAIN_S", 3600.0)
    others, ours = BusLocks({"bus": address}), BusLocks({"bus": address})
    others.take(["bus"])
    async with watching(quick_path, address):
        await until(lambda: is_watched(address), "somebody watches")
        others.give_back(["bus"])
        async with asyncio.timeout(1.0):
            for _ in range(5):
                await ours.take_aside(["bus"])
                ours.give_back(["bus"])


async def test_of_two_that_find_the_name_of_a_dead_process_one_alone_watches(address: TcpAddress) -> None:
    """The second comes after the first has found that nobody answers, and before it has the name."""
    name = watch_name(address)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(name)
    first, second = (WatchPost(name, _left, lambda: None) for _ in range(2))
    unlink = os.unlink
    refused: list[BaseException | None] = []

    def other_first(path: str) -> None:
        patched.setattr("os.unlink", unlink)
        with ThreadPoolExecutor(1) as other:
            refused.append(other.submit(asyncio.run, second.open()).exception())
        unlink(path)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("os.unlink", other_first)
        await first.open()
    assert "another process watches it" in str(refused[0])
    assert is_watched(address)
    await first.close()
    await second.open()  # the lock is free again
    await second.close()


@pytest.mark.parametrize("passes", range(6))
def test_a_post_that_is_closed_as_somebody_comes_leaves_nothing_open(address: TcpAddress, passes: int) -> None:
    """Whatever the loop had got to: a socket that is left open is an error where it is collected."""

    async def come_and_close() -> None:
        post = WatchPost(watch_name(address), _left, lambda: None)
        await post.open()
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as taker:
            taker.connect(watch_name(address))
            for _ in range(passes):
                await asyncio.sleep(0)
            await post.close()

    assert not _left_open_by(come_and_close())


@pytest.mark.parametrize("passes", range(4))
def test_a_post_whose_opening_is_cancelled_is_free_for_the_next(address: TcpAddress, passes: int) -> None:
    async def open_and_cancel() -> None:
        post, following = (WatchPost(watch_name(address), _left, lambda: None) for _ in range(2))
        opening = asyncio.ensure_future(post.open())
        for _ in range(passes):
            await asyncio.sleep(0)
        opening.cancel()
        await asyncio.gather(opening, return_exceptions=True)
        await post.close()
        await following.open()
        await following.close()

    assert not _left_open_by(open_and_cancel())


def _left_open_by(work: Coroutine[Any, Any, None]) -> list[object]:
    """Return what is told of as it is collected after a loop has ended."""
    told: list[object] = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("sys.unraisablehook", lambda unraisable: told.append(unraisable.exc_value))
        asyncio.run(work)
        gc.collect()
    return told


async def _left() -> None:
    """Nothing is on the bus."""
