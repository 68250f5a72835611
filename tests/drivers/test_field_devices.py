"""Kinds of field devices that users report, each as a slave that behaves that way."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager

import numpy as np
import pytest

from drivers.addresses import Parity, RtuAddress
from drivers.device import connect_valve
from drivers.faults import BadAnswerError, ConnectionLostError, EchoError, NoAnswerError
from drivers.outcome import Ended
from drivers.registers import Block, Register, Table
from drivers.transport import Transport
from tests.drivers.conftest import TIMEOUT_S, WORST_LATENCY_S
from tests.support.played_device import WIRING, Bench
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import Fault, RawSlave, SerialPort, TcpPort
from tests.support.stopwatch import Stopwatch
from valve.errors import ValveError, WireError

OpenLine = Callable[..., AbstractAsyncContextManager[Transport]]


@pytest.fixture
def line(serial_port: SerialPort) -> OpenLine:
    """Open the slave's serial line with or without ``echo`` in the plant file."""

    @asynccontextmanager
    async def opened(*, echo: bool) -> AsyncIterator[Transport]:
        bus = Transport(
            RtuAddress(
                "line",
                serial_port.path,
                115200,
                Parity.NONE,
                timeout_s=TIMEOUT_S,
                worst_latency_s=WORST_LATENCY_S,
                echo=echo,
            )
        )
        await bus.open()
        yield bus
        await bus.close()

    return opened


async def read(bus: Transport, address: int, count: int = 1) -> tuple[int, ...]:
    return (await bus.read_words(1, Table.HOLDING, address, count)).words


# ---- an adapter that returns what it sends


@pytest.mark.parametrize("piece", [0, 3, 7])
async def test_a_line_that_returns_what_is_sent_works_where_the_plant_file_says_so(
    line: OpenLine, serial_port: SerialPort, slave: RawSlave, piece: int
) -> None:
    slave.always, serial_port.piece = Fault(echo=True), piece
    async with line(echo=True) as bus:
        assert await read(bus, 10, 3) == (10, 11, 12)
        await bus.write(1, 20, [7, 8])
        await bus.write(1, 22, [9], function=6)
        assert await read(bus, 20, 3) == (7, 8, 9)
        assert (await bus.read_write(1, 30, [99], 30, 2)).words == (99, 31)
        assert bus.recoveries == 0


async def test_a_test_of_a_valve_runs_on_a_line_that_echoes(
    line: OpenLine, device: ReferenceDevice, slave: RawSlave
) -> None:
    slave.always = Fault(echo=True)
    async with line(echo=True) as bus:
        bench = Bench(device, connect_valve(WIRING, {"bus": bus}))
        outcome = await bench.play()
    assert outcome.ended is Ended.COMPLETED
    assert outcome.safe_confirmed
    assert bus.recoveries == 0


@pytest.mark.parametrize("piece", [0, 1, 5])
async def test_an_echo_that_the_plant_file_does_not_name_moves_nothing_and_the_error_says_what_to_do(
    line: OpenLine, serial_port: SerialPort, device: ReferenceDevice, slave: RawSlave, piece: int
) -> None:
    slave.always, serial_port.piece = Fault(echo=True), piece
    async with line(echo=False) as bus:
        bench = Bench(device, connect_valve(WIRING, {"bus": bus}))
        with pytest.raises(EchoError, match="switch off the adapter's echo, or say echo = true"):
            await bench.play()
    assert slave.writes == []
    assert device.moves == []


@pytest.mark.parametrize("function", [6, 16])
async def test_an_echo_alone_confirms_no_write(line: OpenLine, slave: RawSlave, function: int) -> None:
    async with line(echo=True) as bus:
        slave.faults.append(Fault(echo=True, drop=True, silent_execution=False))
        with pytest.raises(NoAnswerError):
            await bus.write(1, 20, [7], function=function)
    assert slave.holding[1, 20] == 20


async def test_a_line_without_the_echo_that_the_plant_file_names_is_told(line: OpenLine) -> None:
    async with line(echo=True) as bus:
        with pytest.raises(EchoError, match="remove echo where the adapter suppresses it"):
            await read(bus, 10, 3)
        with pytest.raises(WireError):
            await bus.write(1, 20, [7], function=6)


@pytest.mark.parametrize("echoes", [True, False])
async def test_a_write_whose_answer_looks_like_its_echo_waits_for_a_line_that_is_known_not_to_echo(
    line: OpenLine, slave: RawSlave, echoes: bool
) -> None:
    """An answer to function 6 is the request: only a read tells whether a line returns what is sent."""
    slave.always = Fault(echo=echoes)
    async with line(echo=False) as bus:
        if echoes:
            with pytest.raises(EchoError):
                await bus.write(1, 20, [7], function=6)
        else:
            await bus.write(1, 20, [7], function=6)
    assert slave.holding[1, 20] == (20 if echoes else 7)


# ---- noise before each frame


@pytest.mark.parametrize("stray", [b"\x00", b"\xff", b"\x01", b"\xff\x00", b"\x01\x03"])
@pytest.mark.parametrize("echo", [False, True])
async def test_a_stray_byte_before_each_frame_costs_nothing(
    line: OpenLine, slave: RawSlave, stray: bytes, echo: bool
) -> None:
    slave.always = Fault(stray=stray, echo=echo)
    async with line(echo=echo) as bus:
        for address in (10, 20, 30):
            assert await read(bus, address, 3) == (address, address + 1, address + 2)
        await bus.write(1, 40, [7, 8])
        await bus.write(1, 42, [9], function=6)
        assert bus.recoveries == 0
    assert len(slave.requests) == 5


async def test_a_stray_byte_in_a_piece_of_its_own_is_noise_too(
    line: OpenLine, serial_port: SerialPort, slave: RawSlave
) -> None:
    slave.always, serial_port.piece = Fault(stray=b"\xff"), 1
    async with line(echo=False) as bus:
        assert await read(bus, 10) == (10,)


@pytest.mark.parametrize("bit", range(0, 40, 3))
async def test_a_read_whose_answer_is_damaged_is_asked_again_in_its_own_time(
    line: OpenLine, slave: RawSlave, bit: int
) -> None:
    async with line(echo=False) as bus:
        slave.faults.append(Fault(flip=bit))
        exchange = await bus.read_words(1, Table.HOLDING, 100, 2)
        assert exchange.words == (100, 101)
        assert exchange.received_s - exchange.sent_s < bus.lost_answer_s
        assert exchange.sent_s <= slave.asked_s[0], "the sample's interval begins with the first request"
        assert bus.recoveries == 0
    assert len(slave.requests) == 2


async def test_a_stop_behind_a_damaged_answer_does_not_wait_for_the_line_to_be_cleaned(
    line: OpenLine, slave: RawSlave
) -> None:
    async with line(echo=False) as bus:
        slave.faults.append(Fault(flip=3))
        watch = Stopwatch()
        reading = asyncio.create_task(read(bus, 100))
        await slave.asked.wait()
        await bus.write(1, 20, [7], priority=True)
        assert watch.own_s < WORST_LATENCY_S
        assert await reading == (100,)


async def test_damage_that_stays_ends_within_one_deadline(line: OpenLine, slave: RawSlave) -> None:
    async with line(echo=False) as bus:
        slave.always = Fault(flip=3)
        begun_s = asyncio.get_running_loop().time()
        with pytest.raises(BadAnswerError, match="no frame whose CRC is right"):
            await read(bus, 100)
        assert asyncio.get_running_loop().time() - begun_s < 2.0 * TIMEOUT_S
        slave.always = Fault()
        assert await read(bus, 200) == (200,)


async def test_an_answer_that_comes_twice_at_once_is_believed_by_nobody_and_not_asked_for_again(
    line: OpenLine, slave: RawSlave
) -> None:
    async with line(echo=False) as bus:
        slave.faults.append(Fault(copies=2))
        with pytest.raises(BadAnswerError, match="7 bytes came behind the answer"):
            await read(bus, 100)
        assert len(slave.requests) == 1
        assert await read(bus, 200) == (200,)


@pytest.mark.parametrize("function", [6, 16])
async def test_a_write_whose_answer_is_damaged_goes_out_once(line: OpenLine, slave: RawSlave, function: int) -> None:
    async with line(echo=False) as bus:
        await read(bus, 1)
        slave.faults.append(Fault(flip=3))
        with pytest.raises(ValveError):
            await bus.write(1, 20, [7], function=function)
    assert len(slave.writes) == 1


async def test_an_answer_that_comes_late_is_not_asked_for_again(line: OpenLine, slave: RawSlave) -> None:
    """Noise that is no answer must not make a second request: its answer would be taken for the next one's."""
    slave.faults.append(Fault(delay_s=TIMEOUT_S + 0.05, stray=b"\x55" * 7))
    async with line(echo=False) as bus:
        with pytest.raises(NoAnswerError):
            await read(bus, 100)
        assert len(slave.requests) == 1
        assert await read(bus, 200) == (200,)


# ---- a device that closes the connection after each answer


@pytest.mark.parametrize("has_canary", [True, False])
async def test_a_device_that_closes_after_each_answer_is_connected_anew_for_each_request(
    tcp: Transport, tcp_port: TcpPort, slave: RawSlave, has_canary: bool
) -> None:
    slave.hangs_up = True
    if has_canary:
        tcp.set_canary(1, Block((Register("canary", 50),), 50, 1, Table.HOLDING), [50])
    for address in range(100, 110):
        assert await read(tcp, address) == (address,)
    await tcp.write(1, 20, [7])
    assert slave.writes == [(1, 20, [7])]
    assert tcp_port.connections <= (2 if has_canary else 1) * 11


async def test_a_test_runs_on_a_device_that_closes_after_each_answer(
    device: ReferenceDevice, tcp: Transport, slave: RawSlave
) -> None:
    slave.hangs_up = True
    bench = Bench(device, connect_valve(WIRING, {"bus": tcp}))
    outcome = await bench.play(period_s=0.05)
    assert (outcome.ended, outcome.error) == (Ended.COMPLETED, None)
    assert outcome.safe_confirmed
    assert outcome.recording is not None
    assert not np.isnan(outcome.recording.position_m).any()


async def test_a_connection_that_breaks_in_the_middle_of_a_command_is_a_fault_and_the_command_is_not_repeated(
    tcp: Transport, slave: RawSlave
) -> None:
    slave.hangs_up = True
    for address in (100, 101):
        await read(tcp, address)
    slave.faults.append(Fault(hang_up=True))
    with pytest.raises(ConnectionLostError, match="the connection broke"):
        await tcp.write(1, 20, [7])
    assert await read(tcp, 20) == (7,)
    assert len(slave.writes) == 1


async def test_another_device_at_the_address_of_one_that_hung_up_is_not_written_to(
    tcp: Transport, slave: RawSlave
) -> None:
    slave.hangs_up = True
    tcp.set_canary(1, Block((Register("canary", 50),), 50, 1, Table.HOLDING), [50])
    assert await read(tcp, 100) == (100,)
    slave.holding[1, 50] = 4711
    with pytest.raises(BadAnswerError):
        await tcp.write(1, 20, [7])
    assert slave.writes == []


async def test_a_device_that_is_gone_after_its_answer_is_asked_for_once_a_request(
    tcp: Transport, tcp_port: TcpPort, slave: RawSlave
) -> None:
    slave.hangs_up = True
    assert await read(tcp, 100) == (100,)
    slave.always = Fault(hang_up=True)
    for _ in range(3):
        with pytest.raises(ConnectionLostError):
            await read(tcp, 100)
    assert tcp_port.connections <= 4


async def test_a_connection_that_stays_open_is_kept(tcp: Transport, tcp_port: TcpPort) -> None:
    for address in range(5):
        assert await read(tcp, address) == (address,)
    assert tcp_port.connections == 1
