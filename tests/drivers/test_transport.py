from __future__ import annotations

import asyncio
import contextlib
import errno
import itertools
import struct
import sys
import time
from pathlib import Path

import pytest
import uvloop

from drivers import connection, faults
from drivers.addresses import GaugeAddress, Parity, RtuAddress, TcpAddress
from drivers.faults import BadAnswerError, ConnectionLostError, EchoError, NoAnswerError
from drivers.registers import Block, Register, Table
from drivers.serial_gauge import SerialGauge
from drivers.serial_port import why_not_opened
from drivers.transport import Transport
from tests.drivers.conftest import TIMEOUT_S, WORST_LATENCY_S
from tests.support.slave import Fault, RawSlave, SerialPort, TcpPort
from tests.support.stopwatch import Stopwatch
from valve.errors import ConfigurationError, DeviceError, ValveError, WireError


async def read(bus: Transport, address: int, count: int = 1) -> tuple[int, ...]:
    return (await bus.read_words(1, Table.HOLDING, address, count)).words


async def test_words_are_read_and_written_on_either_carrier(bus: Transport, slave: RawSlave) -> None:
    assert await read(bus, 10, 3) == (10, 11, 12)
    assert (await bus.read_words(1, Table.INPUT, 5, 2)).words == (1005, 1006)
    await bus.write(1, 20, [7, 8])
    assert slave.writes == [(1, 20, [7, 8])]
    assert (await bus.read_write(1, 30, [99], 30, 2)).words == (99, 31)


async def test_an_exchange_encloses_the_moment_at_which_the_slave_answered(bus: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(delay_s=0.03))
    before_s = time.monotonic()
    exchange = await bus.read_words(1, Table.HOLDING, 1, 1)
    assert before_s <= exchange.sent_s < exchange.sent_s + 0.029 <= exchange.received_s <= time.monotonic()


async def test_a_write_that_is_not_answered_goes_out_once(bus: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(drop=True))
    with pytest.raises(NoAnswerError):
        await bus.write(1, 20, [7])
    await asyncio.sleep(3 * TIMEOUT_S)
    assert len(slave.writes) == 1


async def test_a_silent_slave_costs_no_more_than_the_deadline(bus: Transport, slave: RawSlave) -> None:
    slave.always = Fault(drop=True)
    start_s, watch = time.monotonic(), Stopwatch()
    with pytest.raises(NoAnswerError, match="no answer within"):
        await read(bus, 1)
    assert time.monotonic() - start_s >= TIMEOUT_S
    assert watch.own_s < 2 * TIMEOUT_S


async def test_a_late_answer_never_becomes_the_next_one(bus: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(delay_s=TIMEOUT_S + 0.03))
    slave.always = Fault(delay_s=0.05)
    got = []
    for address in (100, 200, 300, 400):
        try:
            got.append(await read(bus, address))
        except WireError:
            got.append(())
    assert got == [(), (200,), (300,), (400,)]


async def test_an_answer_later_than_the_worst_latency_is_caught_by_the_canary(rtu: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(delay_s=WORST_LATENCY_S + 0.03))
    slave.always = Fault(delay_s=0.05)
    with pytest.raises(NoAnswerError):
        await read(rtu, 100)
    with pytest.raises(BadAnswerError):
        await read(rtu, 200)
    assert [await read(rtu, address) for address in (200, 300, 400)] == [(200,), (300,), (400,)]


async def test_a_stop_waits_for_one_attempt_to_recover_the_bus_and_not_for_three(
    bus: Transport, slave: RawSlave
) -> None:
    canary = Register("canary", 50)
    bus.set_canary(1, Block((canary,), 50, 1, Table.HOLDING), [4711])
    slave.faults.append(Fault(drop=True))
    with pytest.raises(NoAnswerError):
        await read(bus, 1)
    slave.always = Fault(delay_s=0.05)  # each attempt takes so long, and its canary is wrong
    watch = Stopwatch()
    recovering = asyncio.create_task(read(bus, 2))
    await asyncio.sleep(0)
    asked = len(slave.requests)
    with pytest.raises(BadAnswerError):
        await bus.write(1, 500, [1], priority=True)
    with pytest.raises(BadAnswerError):
        await recovering
    assert len(slave.requests) - asked == 2, "one canary for the read, one for the stop"
    longest_s = 2 * (0.05 + TIMEOUT_S) + (3 * WORST_LATENCY_S if bus.address.name == "line" else 0.0)
    assert watch.own_s < longest_s


async def test_a_serial_line_is_left_alone_until_the_slowest_answer_must_have_come(
    rtu: Transport, slave: RawSlave
) -> None:
    slave.faults.append(Fault(drop=True))
    begun_s = time.monotonic()  # not when the slave noticed it: on a busy machine that is later
    with pytest.raises(NoAnswerError):
        await read(rtu, 100)
    assert await read(rtu, 200) == (200,)
    assert slave.asked_s[1] - begun_s >= WORST_LATENCY_S


async def test_a_cancelled_caller_does_not_leave_the_bus_off_by_one(bus: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(delay_s=0.03))
    slave.always = Fault(delay_s=0.05)
    task = asyncio.create_task(read(bus, 100))
    await slave.asked.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert [await read(bus, address) for address in (200, 300, 400)] == [(200,), (300,), (400,)]


async def test_a_caller_cancelled_while_waiting_leaves_the_queue_in_order(bus: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(delay_s=0.03))
    tasks = [asyncio.create_task(read(bus, address)) for address in (1, 2, 3)]
    await asyncio.sleep(0.005)
    tasks[1].cancel()
    assert (await tasks[0], await tasks[2]) == ((1,), (3,))


async def test_a_stop_overtakes_everything_that_is_queued(bus: Transport, slave: RawSlave) -> None:
    slave.always = Fault(delay_s=0.01)
    reads = [asyncio.create_task(read(bus, address)) for address in range(8)]
    await slave.asked.wait()
    await bus.write(1, 500, [1], priority=True)
    await asyncio.gather(*reads)
    assert slave.requests[1][1] == 16


async def test_one_request_is_outstanding_at_a_time(bus: Transport, slave: RawSlave) -> None:
    slave.always = Fault(delay_s=0.005)
    await asyncio.gather(*(read(bus, address) for address in range(6)))
    assert (len(slave.requests), slave.most_in_flight) == (6, 1)


@pytest.mark.parametrize(
    "fault",
    [
        Fault(words=(5, 6)),
        Fault(words=()),
        Fault(function=4),
        Fault(cut=1),
        Fault(cut=4),
        Fault(unit=2),
        Fault(exception=0x55, function=9),
        Fault(drop=True, echo=True),
    ],
    ids=["two words", "no words", "function 4", "a byte short", "four bytes short", "unit 2", "function 9", "echo"],
)
async def test_an_answer_that_does_not_fit_is_an_error_and_the_next_is_right(
    bus: Transport, slave: RawSlave, fault: Fault
) -> None:
    slave.faults.append(fault)
    with pytest.raises(ValveError):
        await read(bus, 100)
    assert await read(bus, 200) == (200,)


async def test_an_answer_that_cannot_be_read_is_said_at_once_and_by_no_other_error(
    bus: Transport, slave: RawSlave, caplog: pytest.LogCaptureFixture
) -> None:
    slave.faults.append(Fault(function=0x42))
    with pytest.raises(WireError) as raised:
        await read(bus, 100)
    assert await read(bus, 200) == (200,)
    if isinstance(bus.address, TcpAddress):  # a serial line does not tell where an unknown frame ends
        assert isinstance(raised.value, BadAnswerError)
    assert [record.message for record in caplog.records if record.name == "asyncio"] == []


@pytest.mark.parametrize("bit", range(0, 24, 3))
async def test_a_bit_that_flips_on_a_serial_line_never_gives_a_value(rtu: Transport, slave: RawSlave, bit: int) -> None:
    slave.always = Fault(flip=bit)
    with pytest.raises(WireError):
        await read(rtu, 100)


@pytest.mark.parametrize("transaction", [0, 9999])
async def test_another_transaction_id_is_no_answer(tcp: Transport, slave: RawSlave, transaction: int) -> None:
    slave.faults.append(Fault(transaction=transaction, words=(77,)))
    with pytest.raises(WireError):
        await read(tcp, 100)
    assert await read(tcp, 200) == (200,)


@pytest.mark.parametrize("fault", [Fault(copies=2), Fault(copies=3)], ids=["doubled", "trebled"])
async def test_answers_that_come_twice_are_not_taken_for_the_next(
    bus: Transport, slave: RawSlave, fault: Fault
) -> None:
    slave.faults.append(fault)
    got = []
    for address in (100, 200, 300):
        try:
            got.append(await read(bus, address))
        except WireError:
            got.append((address,))
    assert got == [(100,), (200,), (300,)]
    assert await read(bus, 400) == (400,)


async def test_bytes_that_nobody_asked_for_are_cleared_away(
    rtu: Transport, serial_port: SerialPort, slave: RawSlave
) -> None:
    assert await read(rtu, 1) == (1,)
    serial_port.say(bytes.fromhex("010302000a38 43".replace(" ", "")))
    await asyncio.sleep(0.01)
    assert await read(rtu, 2) == (2,)
    assert rtu.recoveries == 1


async def test_an_echo_confirms_nothing(rtu: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(drop=True, echo=True, silent_execution=False))
    with pytest.raises(EchoError, match="echo"):
        await rtu.write(1, 20, [7])
    assert slave.holding[1, 20] == 20


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        (1, faults.IllegalFunctionError),
        (2, faults.IllegalAddressError),
        (3, faults.IllegalValueError),
        (4, faults.DeviceFailureError),
        (5, faults.AcknowledgedError),
        (6, faults.DeviceBusyError),
        (0x0A, faults.GatewayPathError),
        (0x0B, faults.GatewayTargetError),
        (0x77, faults.RefusedError),
    ],
)
async def test_each_exception_has_its_error_and_is_not_repeated(
    bus: Transport, slave: RawSlave, code: int, kind: type[ValveError]
) -> None:
    slave.faults.append(Fault(exception=code))
    with pytest.raises(kind, match=f"exception {code}"):
        await bus.write(1, 20, [7])
    assert len(slave.requests) == 1
    assert await read(bus, 3) == (3,)
    assert len(slave.requests) == 2  # an exception is an answer: no recovery was needed


async def test_a_register_that_is_not_there_is_said(bus: Transport) -> None:
    with pytest.raises(DeviceError, match="no such register"):
        await read(bus, 60000)


async def test_a_connection_that_breaks_is_noticed_at_once_and_mended(
    tcp: Transport, slave: RawSlave, tcp_port: TcpPort
) -> None:
    slave.faults.append(Fault(hang_up=True))
    watch = Stopwatch()
    with pytest.raises(ConnectionLostError):
        await read(tcp, 100)
    assert watch.own_s < TIMEOUT_S
    assert await read(tcp, 200) == (200,)
    assert tcp_port.connections == 2


async def test_a_port_that_nobody_serves_is_said_within_the_deadline() -> None:
    bus = Transport(TcpAddress("plc", "127.0.0.1", 9, timeout_s=TIMEOUT_S))
    with pytest.raises(ConnectionLostError, match=r"127\.0\.0\.1:9"):
        await bus.open()
    await bus.close()


async def test_a_black_hole_fails_every_request_within_its_deadlines(tcp_port: TcpPort, slave: RawSlave) -> None:
    slave.always = Fault(drop=True)
    bus = Transport(TcpAddress("plc", "127.0.0.1", tcp_port.port, timeout_s=TIMEOUT_S))
    await bus.open()
    watch = Stopwatch()
    for _ in range(3):
        with pytest.raises(WireError):
            await read(bus, 1)
    assert watch.own_s < 5 * TIMEOUT_S, "three deadlines, and none of them twice"
    await bus.close()


async def test_a_pulled_serial_line_is_a_wire_error_and_works_again_after_plugging(
    slave: RawSlave, tmp_path: Path
) -> None:
    link = tmp_path / "line"
    async with SerialPort(slave) as first:
        link.symlink_to(first.path)
        bus = Transport(RtuAddress("line", str(link), 115200, Parity.NONE, timeout_s=TIMEOUT_S, worst_latency_s=0.1))
        await bus.open()
        assert await read(bus, 1) == (1,)
        first.unplug()
        for _ in range(3):
            with pytest.raises(WireError):
                await read(bus, 2)
    link.unlink()
    async with SerialPort(slave) as second:
        link.symlink_to(second.path)
        assert await read(bus, 3) == (3,)
        await bus.close()


async def test_a_serial_port_that_is_not_there_is_said() -> None:
    bus = Transport(RtuAddress("line", "/nowhere/ttyUSB0", timeout_s=TIMEOUT_S))
    with pytest.raises(ConnectionLostError, match="/nowhere/ttyUSB0"):
        await bus.open()
    await bus.close()


@pytest.mark.parametrize("device_id", [0, 248, 255])
async def test_a_broadcast_on_a_serial_line_is_refused_before_anything_is_sent(
    rtu: Transport, slave: RawSlave, device_id: int
) -> None:
    with pytest.raises(ConfigurationError, match="1 to 247, which a serial line has"):
        await rtu.write(device_id, 20, [1])
    assert slave.requests == []


@pytest.mark.parametrize("device_id", [0, 255])
async def test_the_device_at_a_network_address_itself_is_read_and_written(
    tcp: Transport, slave: RawSlave, device_id: int
) -> None:
    slave.holding[device_id, 20] = 4711
    assert (await tcp.read_words(device_id, Table.HOLDING, 20, 1)).words == (4711,)
    await tcp.write(device_id, 20, [7])
    assert slave.writes == [(device_id, 20, [7])]
    slave.faults.append(Fault(unit=1))
    with pytest.raises(WireError, match=f"device 1 answered, {device_id} was asked"):
        await tcp.read_words(device_id, Table.HOLDING, 20, 1)


@pytest.mark.parametrize("device_id", [248, 254])
async def test_a_reserved_device_id_is_refused_on_a_network_too(tcp: Transport, device_id: int) -> None:
    with pytest.raises(ConfigurationError, match="0 to 247 and 255"):
        await tcp.write(device_id, 20, [1])


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (Fault(unit=9), "device 9 answered, 1 was asked: correct device_id"),
        (Fault(transaction=9999), "an answer to transaction 9999 came, 1 was asked"),
        (Fault(transaction=0), "an answer to transaction 0 came, 1 was asked"),
        (Fault(cut=4), "7 of 11 bytes came"),
    ],
    ids=["unit", "transaction", "no transaction", "torn"],
)
async def test_what_came_instead_of_the_answer_is_said_on_a_network(
    tcp: Transport, slave: RawSlave, fault: Fault, said: str
) -> None:
    slave.faults.append(fault)
    with pytest.raises(WireError, match=f"bus plc: device 1, reading 1 words at 100: .*{said}"):
        await read(tcp, 100)


async def test_what_always_comes_instead_is_said_by_every_later_request_too(tcp: Transport, slave: RawSlave) -> None:
    slave.always = Fault(transaction=0)
    for _ in range(2):
        with pytest.raises(WireError, match="an answer to transaction 0 came"):
            await read(tcp, 100)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (Fault(unit=9), "device 9 answered, 1 was asked: correct device_id"),
        (Fault(cut=2), "5 of 7 bytes came: check the line"),
        (Fault(flip=3), "7 bytes came and no frame whose CRC is right: check baud_rate"),
        (Fault(function=0x42), "an answer to function 66 came that cannot be read"),
    ],
    ids=["unit", "torn", "noise", "function"],
)
async def test_what_came_instead_of_the_answer_is_said_on_a_serial_line(
    rtu: Transport, slave: RawSlave, fault: Fault, said: str
) -> None:
    slave.always = fault
    with pytest.raises(WireError, match=f"bus line: device 1, reading 1 words at 100: .*{said}"):
        await read(rtu, 100)


async def test_a_stranger_beside_the_answer_does_no_harm(tcp: Transport, slave: RawSlave) -> None:
    slave.faults.append(Fault(drop=True))
    with pytest.raises(NoAnswerError, match="check the device and the wire"):
        await read(tcp, 100)
    assert await read(tcp, 200) == (200,)


async def test_another_service_at_the_port_is_told_by_what_it_says() -> None:
    async def refuse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(12)
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        await reader.read()
        writer.close()
        await writer.wait_closed()
        gone.set()

    gone = asyncio.Event()
    server = await asyncio.start_server(refuse, "127.0.0.1", 0)
    bus = Transport(TcpAddress("plc", "127.0.0.1", server.sockets[0].getsockname()[1], timeout_s=TIMEOUT_S))
    await bus.open()
    try:
        with pytest.raises(WireError, match=r"28 bytes came that are no Modbus/TCP: check host and port"):
            await read(bus, 1)
    finally:
        await bus.close()
        server.close()
        await gone.wait()


async def test_nobody_waits_long_to_learn_why_a_port_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "why_not_opened", lambda *_: time.sleep(1.5))  # /proc of a busy machine
    line = Transport(RtuAddress("line", "/dev/no-such-port", 115200, Parity.NONE, timeout_s=TIMEOUT_S))
    began_s = time.monotonic()
    with pytest.raises(ConnectionLostError, match="check the address and the wire"):
        await line.open()
    assert time.monotonic() - began_s < 1.0


_HOLDER = """
import fcntl, os, sys
line = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
if sys.argv[2] == "locked":
    fcntl.flock(line, fcntl.LOCK_EX)
print("held", flush=True)
sys.stdin.read()
"""


@pytest.mark.parametrize("how", ["locked", "opened"])
async def test_a_serial_port_that_somebody_else_has_is_said_to_be_in_use_and_by_whom(
    serial_port: SerialPort, how: str
) -> None:
    arguments = ("-c", _HOLDER, serial_port.path, how)
    holder = await asyncio.create_subprocess_exec(sys.executable, *arguments, stdin=-1, stdout=-1)
    assert holder.stdin is not None
    assert holder.stdout is not None
    try:
        assert await holder.stdout.readline() == b"held\n"
        if how == "opened":  # for itself alone (TIOCEXCL), which root does not notice
            said = why_not_opened(serial_port.path, OSError(errno.EBUSY, "busy"))
            assert said.startswith(f"it is in use by process {holder.pid} (python")
            return
        line = Transport(RtuAddress("line", serial_port.path, 115200, Parity.NONE, timeout_s=TIMEOUT_S))
        gauge = SerialGauge(GaugeAddress("gauge", serial_port.path, "?\r", "(?P<value>.+)"))
        for bus in (line, gauge):
            with pytest.raises(ConnectionLostError, match=f"it is in use by process {holder.pid} \\(python"):
                await bus.open()
            await bus.close()
    finally:
        holder.stdin.close()
        await holder.wait()


@pytest.mark.parametrize(
    ("number", "said"),
    [(errno.ENOENT, "there is no such port"), (errno.EACCES, "may not use it"), (errno.EIO, "check the port")],
)
def test_another_reason_is_not_told_as_a_port_in_use(number: int, said: str) -> None:
    assert said in why_not_opened("/nowhere/ttyS0", OSError(number, "told by the system"))


async def test_a_closed_bus_says_so(bus: Transport) -> None:
    await bus.close()
    with pytest.raises(ConnectionLostError, match="closed"):
        await read(bus, 1)


async def test_a_canary_that_shows_other_words_keeps_the_bus_closed(bus: Transport, slave: RawSlave) -> None:
    canary = Register("canary", 50)
    bus.set_canary(1, Block((canary,), 50, 1, Table.HOLDING), [4711])
    slave.faults.append(Fault(drop=True))
    with pytest.raises(NoAnswerError):
        await read(bus, 1)
    with pytest.raises(BadAnswerError):
        await read(bus, 2)
    slave.holding[1, 50] = 4711
    assert await read(bus, 2) == (2,)


@pytest.mark.parametrize("piece", [1, 3, 62])
async def test_an_answer_that_a_usb_adapter_hands_on_in_pieces_is_whole(slave: RawSlave, piece: int) -> None:
    async with SerialPort(slave) as port:
        port.piece = piece
        count = 4 if piece < 62 else 80
        bus = Transport(RtuAddress("line", port.path, 115200, Parity.NONE, timeout_s=0.5))
        await bus.open()
        for _ in range(2):
            exchange = await bus.read_words(1, Table.HOLDING, 10, count)
            assert exchange.words == tuple(range(10, 10 + count))
        await bus.write(1, 20, [7, 8])
        assert bus.recoveries == 0
        await bus.close()


async def test_frames_on_a_serial_line_keep_their_distance(serial_port: SerialPort, slave: RawSlave) -> None:
    bus = Transport(RtuAddress("line", serial_port.path, 9600, Parity.NONE, timeout_s=0.2))
    await bus.open()
    times = [await bus.read_words(1, Table.HOLDING, address, 1) for address in range(3)]
    gaps_s = [after.sent_s - before.received_s for before, after in itertools.pairwise(times)]
    assert min(gaps_s) >= 3.5 * 11 / 9600
    await bus.close()


@pytest.mark.parametrize("others", [1, 2, 3])
async def test_the_longest_answers_to_something_else_do_not_bury_ours(others: int) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(asyncio.IncompleteReadError):
            while True:
                asked = await reader.readexactly(12)
                (transaction,) = struct.unpack_from(">H", asked)
                for away in range(others, -1, -1):
                    number, words = transaction + away, struct.pack(">125H", *[away] * 125)
                    writer.write(struct.pack(">HHHBBB", number, 0, 253, 1, 3, 250) + words)
                    await writer.drain()
                    await asyncio.sleep(0.005)
        writer.close()
        await writer.wait_closed()
        ended.set()

    ended = asyncio.Event()
    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        bus = Transport(TcpAddress("plc", "127.0.0.1", server.sockets[0].getsockname()[1], timeout_s=1.0))
        await bus.open()
        assert await read(bus, 0, 125) == (0,) * 125
        await bus.close()
        await ended.wait()


async def test_longer_frames_get_the_time_that_they_take_on_the_line(serial_port: SerialPort, slave: RawSlave) -> None:
    bus = Transport(RtuAddress("line", serial_port.path, 9600, Parity.NONE, timeout_s=0.05))
    await bus.open()
    slave.faults.append(Fault(delay_s=0.05 + 255 * 11 / 9600 - 0.03))
    assert len(await read(bus, 0, 125)) == 125
    await bus.close()


async def _read_and_write(path: str, port: int, slave: RawSlave) -> list[tuple[int, ...]]:
    got = []
    for bus in (
        Transport(TcpAddress("plc", "127.0.0.1", port, timeout_s=TIMEOUT_S)),
        Transport(RtuAddress("line", path, 115200, Parity.NONE, timeout_s=TIMEOUT_S, worst_latency_s=WORST_LATENCY_S)),
    ):
        await bus.open()
        await bus.write(1, 20, [7])
        got.append(await read(bus, 20, 2))
        slave.faults.append(Fault(delay_s=TIMEOUT_S + 0.01))
        with pytest.raises(NoAnswerError):
            await read(bus, 100)
        got.append(await read(bus, 200))
        await bus.close()
    return got


def test_both_carriers_work_on_uvloop(slave: RawSlave) -> None:
    async def everything() -> list[tuple[int, ...]]:
        async with TcpPort(slave) as port, SerialPort(slave) as line:
            return await _read_and_write(line.path, port.port, slave)

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        assert runner.run(everything()) == [(7, 21), (200,), (7, 21), (200,)]
