from __future__ import annotations

import asyncio
import contextlib
import shutil
import ssl
import struct
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import serial
from pymodbus.client import AsyncModbusTcpClient

from drivers.register_map import RegisterMap
from drivers.registers import Kind, Register, Table, WordOrder
from simulator.assembly import SimulatedChannel, SimulatedPlant, SimulatedUnit, reference_unit
from simulator.clock import ManualClock, RunningClock
from simulator.faults import Fault, FaultKind
from simulator.listeners import Listener, RtuListener, TcpListener
from simulator.simulated_valve import SimulatedValve
from simulator.unit import Quantity
from tests.support.simulated_plants import (
    CLAIM,
    CORNERS,
    INDEX,
    LIVE,
    LIVE_WORDS,
    RUN_NUMBER,
    RUN_OWNER,
    WINDOW,
    RefusedError,
    RtuMaster,
    TcpMaster,
    claim_words,
    crc,
    f32,
    floats,
    read_pdu,
    read_write_pdu,
    u32,
    valve,
    write_pdu,
)
from valve.errors import ConfigurationError

# A bare 4-channel module: outputs and inputs as raw words, 4 to 20 mA on 0 to 30000, the inputs in their own table.
MODULE = RegisterMap(
    name="module",
    source="these tests",
    registers=(
        *(
            Register(f"ao{i}", 100 + i, Kind.U16, unit="A", scale=0.016 / 30000, offset=0.004, writable=True)
            for i in range(2)
        ),
        *(
            Register(f"ai{i}", i, Kind.U16, Table.INPUT, "A", 0.016 / 30000, 0.004, raw_range=(0, 32000))
            for i in range(4)
        ),
        Register("serial", 200, Kind.U32, word_order=WordOrder.CDAB),
    ),
)
SIGNAL = (0.004, 0.020)


def channel(tag: str, quantity: Quantity, register: str, span: tuple[float, float]) -> SimulatedChannel:
    unit = "m" if quantity is Quantity.POSITION else "Pa"
    return SimulatedChannel(tag, quantity, MODULE.register(register).spanning(SIGNAL, span, unit))


MODULE_UNIT = SimulatedUnit(
    4,
    MODULE,
    (
        channel("A", Quantity.COMMAND, "ao0", (0.0, 82737.0)),
        channel("B", Quantity.COMMAND, "ao1", (0.0, 82737.0)),
        channel("A", Quantity.POSITION, "ai0", (0.0, 0.1016)),
        channel("B", Quantity.POSITION, "ai1", (0.0, 0.1016)),
        channel("A", Quantity.PRESSURE, "ai2", (0.0, 82737.0)),
    ),
)


class Rig:
    """A plant that is served, with one master on its first listener."""

    def __init__(self, plant: SimulatedPlant, master: TcpMaster, clock: ManualClock) -> None:
        self.plant, self.master, self.clock = plant, master, clock
        self.ask = master.ask


async def started(valves: list[SimulatedValve], units: list[SimulatedUnit]) -> Rig:
    clock = ManualClock()
    plant = SimulatedPlant(valves, {TcpListener(): units}, clock)
    await plant.start()
    return Rig(plant, await TcpMaster.connect(plant.addresses[0]), clock)


@pytest.fixture
async def rig() -> AsyncIterator[Rig]:
    """Three valves on one port: A and B on a module, C on a reference device."""
    entry = await started([valve("A"), valve("B"), valve("C")], [MODULE_UNIT, reference_unit(7, "C")])
    yield entry
    await entry.master.close()
    await entry.plant.stop()


async def test_three_units_on_one_port_answer_each_for_itself() -> None:
    rig = await started([valve(tag) for tag in "ABC"], [reference_unit(i, tag) for i, tag in enumerate("ABC", start=1)])
    for unit in (1, 2, 3):
        await rig.ask(write_pdu(CLAIM, claim_words(unit)), unit)
        await rig.ask(write_pdu(RUN_NUMBER, u32(unit) + f32(1.0e4 * unit)), unit)
    rig.clock.advance(1.0)
    for unit in (1, 2, 3):
        assert (await rig.ask(read_pdu(3, 3, 2), unit)) == u32(unit)
        outputs = floats(await rig.ask(read_pdu(3, LIVE + 6, 2), unit))
        assert outputs == pytest.approx([1.0e4 * unit], abs=1.0)
    await rig.master.close()
    await rig.plant.stop()


async def test_the_five_functions_read_and_write_over_tcp(rig: Rig) -> None:
    assert await rig.ask(read_pdu(3, 0, 2), 7) == [0x4257, 0x4159]
    assert await rig.ask(read_pdu(4, 0, 1), 4) == [0]
    assert await rig.ask(struct.pack(">BHH", 6, 1000, 9), 7) == [1000, 9]
    assert await rig.ask(read_pdu(3, 1000, 1), 7) == [9]
    assert await rig.ask(write_pdu(CLAIM, claim_words(70_000)), 7) == [CLAIM, 3]
    assert await rig.ask(read_write_pdu(RUN_OWNER, 2, INDEX, u32(123_456)), 7) == u32(70_000)
    words = await rig.ask(read_write_pdu(WINDOW, 123, INDEX, u32(80)), 7)
    assert words[:2] == u32(80)
    assert words[-1] == crc(b"".join(word.to_bytes(2, "big") for word in words[:-1]))


async def test_the_channels_of_one_module_move_and_show_different_valves(rig: Rig) -> None:
    await rig.ask(struct.pack(">BHH", 6, 100, 30000), 4)
    await rig.ask(write_pdu(101, [15000]), 4)
    rig.clock.advance(30.0)
    valves = rig.plant.valves
    assert valves["A"].asked_pa == pytest.approx(82737.0)
    assert valves["B"].asked_pa == pytest.approx(41368.5, abs=1.0)
    raw = await rig.ask(read_pdu(4, 0, 4), 4)
    for word, tag in zip(raw, "AB", strict=False):
        assert word / 30000 * 0.1016 == pytest.approx(valves[tag].stem.position_m, abs=4e-6)
    assert raw[2] == pytest.approx(30000, abs=1)
    assert raw[3] == 0
    assert await rig.ask(read_pdu(3, 100, 2), 4) == [30000, 15000]


async def test_a_valve_may_be_commanded_on_one_unit_and_sensed_on_another() -> None:
    sensing = SimulatedUnit(2, MODULE, (channel("A", Quantity.POSITION, "ai3", (0.0, 0.1016)),))
    rig = await started([valve("A")], [reference_unit(1, "A"), sensing])
    await rig.ask(write_pdu(CLAIM, claim_words(5)))
    await rig.ask(write_pdu(RUN_NUMBER, u32(5) + f32(7.0e4)))
    rig.clock.advance(20.0)
    (raw,) = await rig.ask(read_pdu(4, 3, 1), 2)
    (position_m,) = floats(await rig.ask(read_pdu(3, LIVE + 2, 2)))
    assert raw / 30000 * 0.1016 == pytest.approx(position_m, abs=4e-6)
    assert position_m > 0.04
    await rig.master.close()
    await rig.plant.stop()


async def test_a_bad_sensor_gives_a_raw_value_that_is_no_measurement(rig: Rig) -> None:
    rig.plant.inject("A", Fault(FaultKind.SENSOR_LOST, 1.0))
    rig.clock.advance(2.0)
    words = await rig.ask(read_pdu(4, 0, 1), 4)
    assert MODULE.register("ai0").raw_range == (0, 32000)
    assert words == [0xFFFF]


@pytest.mark.parametrize(
    ("pdu", "unit", "code"),
    [
        (read_pdu(3, 14, 1), 7, 2),
        (read_pdu(4, 0, 1), 7, 2),
        (read_pdu(3, 0, 1), 4, 2),
        (read_pdu(3, 16, 0), 7, 3),
        (read_pdu(3, 16, 126), 7, 3),
        (write_pdu(0, [1, 2]), 7, 2),
        (write_pdu(34, f32(1.0e4)), 7, 2),
        (write_pdu(CLAIM, claim_words(5, 9)), 7, 3),
        (write_pdu(1000, [0] * 124)[:6] + b"\xf8" + b"\x00" * 248, 7, 3),
        (struct.pack(">BHHB2H", 16, 1000, 3, 4, 0, 0), 7, 3),
        (struct.pack(">BHHHHBH", 23, 16, 0, 1000, 1, 2, 5), 7, 3),
        (struct.pack(">BHHHHB2H", 23, 16, 2, 1000, 1, 4, 5, 6), 7, 3),
        (b"\x01\x00\x00\x00\x08", 7, 1),
        (b"\x05\x00\x00\xff\x00", 7, 1),
        (b"\x18\x00\x00", 7, 1),
        (b"\x14\x07\x06\x00\x01\x00\x00\x00\x01", 7, 1),
        (b"\x2b\x0e\x01\x00", 7, 1),
        (b"\x08\x00\x00\x12\x34", 7, 1),
        (b"\x64", 7, 1),
        (read_pdu(3, 0, 1), 9, 0x0B),
        (write_pdu(34, f32(1.0e4)), 0, 0x0B),
    ],
)
async def test_what_cannot_be_answered_gets_its_exception_and_nothing_changes(
    rig: Rig, pdu: bytes, unit: int, code: int
) -> None:
    with pytest.raises(RefusedError) as refused:
        await rig.ask(pdu, unit)
    assert (refused.value.function, refused.value.code) == (pdu[0], code)
    assert await rig.ask(read_pdu(3, CORNERS, 1), 7) == [0]
    assert await rig.ask(read_pdu(3, 0, 2), 7) == [0x4257, 0x4159]


async def test_requests_in_one_piece_are_all_executed_and_answered_in_order(rig: Rig) -> None:
    numbers = [rig.master.send(7, struct.pack(">BHH", 6, CORNERS, value)) for value in range(1, 9)]
    numbers.append(rig.master.send(7, read_pdu(3, CORNERS, 1)))
    answers = [await rig.master.receive(7, number) for number in numbers]
    assert answers[-1] == b"\x03\x02\x00\x08"


async def test_a_request_that_comes_in_pieces_is_answered_once(rig: Rig) -> None:
    frame = struct.pack(">HHHB", 1, 0, 6, 7) + read_pdu(3, 0, 2)
    for byte in frame[:-1]:
        rig.master.writer.write(bytes([byte]))
        await asyncio.sleep(0.001)
    rig.master.writer.write(frame[-1:])
    assert await rig.master.receive(7, 1) == b"\x03\x04\x42\x57\x41\x59"


async def test_refusing_silent_and_deaf_devices_behave_so_until_the_fault_ends(rig: Rig) -> None:
    rig.plant.inject("C", Fault(FaultKind.REFUSAL, 1.0, 2.0, amount=6))
    rig.plant.inject("C", Fault(FaultKind.SILENCE, 3.0, 4.0))
    rig.clock.advance(1.5)
    for pdu in (read_pdu(3, 0, 2), write_pdu(CORNERS, [3])):
        with pytest.raises(RefusedError) as refused:
            await rig.ask(pdu, 7)
        assert refused.value.code == 6
    rig.clock.advance(2.0)
    rig.master.send(7, write_pdu(CORNERS, [4]))
    rig.master.send(7, read_pdu(3, CORNERS, 1))
    assert await rig.ask(read_pdu(4, 0, 1), 4) == [0]  # a neighbour answers, and nothing stands before its answer
    rig.clock.advance(1.0)
    assert await rig.ask(read_pdu(3, CORNERS, 1), 7) == [4]  # what was written in silence was executed


async def test_the_clocks_speed_is_that_of_the_device() -> None:
    plant = SimulatedPlant([valve("A")], {TcpListener(): [reference_unit(1, "A")]}, RunningClock(200.0))
    await plant.start()
    master = await TcpMaster.connect(plant.addresses[0])
    loop = asyncio.get_running_loop()

    async def device_time_s() -> tuple[float, float, float]:
        before = loop.time()
        high, low = await master.ask(read_pdu(3, LIVE, 2))
        return (high << 16 | low) * 1e-6, before, loop.time()

    first_s, before, after = await device_time_s()
    await asyncio.sleep(0.05)
    last_s, later_before, later_after = await device_time_s()
    assert 200.0 * (later_before - after) <= last_s - first_s + 0.001
    assert last_s - first_s <= 200.0 * (later_after - before) + 0.001
    await master.close()
    await plant.stop()


async def test_a_port_that_is_taken_is_refused_in_one_sentence() -> None:
    first = SimulatedPlant([valve("A")], {TcpListener(): [reference_unit(1, "A")]})
    await first.start()
    taken: Listener = TcpListener(port=int(first.addresses[0].rsplit(":", 1)[1]))
    with pytest.raises(ConfigurationError, match="cannot listen"):
        await SimulatedPlant([valve("A")], {taken: [reference_unit(1, "A")]}).start()
    await first.stop()


def test_units_that_contradict_each_other_are_refused() -> None:
    twice, stranger, broadcast = [reference_unit(1, "A")] * 2, [reference_unit(1, "X")], [reference_unit(248, "A")]
    mute = [SimulatedUnit(1, MODULE, (SimulatedChannel("A", Quantity.COMMAND, MODULE.register("ai0")),))]
    for units in (twice, stranger, broadcast, mute):
        with pytest.raises(ConfigurationError):
            SimulatedPlant([valve("A")], {TcpListener(): units})


async def test_a_watched_plant_leaves_no_gap_in_the_record_where_nobody_reads() -> None:
    clock = ManualClock()
    plant = SimulatedPlant([valve("A")], {TcpListener(): [reference_unit(1, "A")]}, clock)
    await plant.start(look_every_s=0.005)
    async with asyncio.timeout(5.0):
        while plant.records["A"].track.time_s[-1:].tolist() != [3.0]:
            clock.advance(0.25 if clock.now_s() < 3.0 else 0.0)
            await asyncio.sleep(0.01)
    await plant.stop()
    assert plant.records["A"].track.time_s.size >= 10


@pytest.fixture
async def rtu(tmp_path: Path) -> AsyncIterator[tuple[SimulatedPlant, Path, ManualClock]]:
    link, clock = tmp_path / "line", ManualClock()
    plant = SimulatedPlant(
        [valve("A"), valve("B")], {RtuListener(link): [reference_unit(1, "A"), reference_unit(2, "B")]}, clock
    )
    await plant.start()
    yield plant, link, clock
    await plant.stop()
    assert not link.is_symlink()


async def test_functions_3_16_and_23_work_over_the_serial_line(rtu: tuple[SimulatedPlant, Path, ManualClock]) -> None:
    _, link, clock = rtu
    master = RtuMaster(link)
    assert await master.ask(read_pdu(3, 0, 2), 9) == [0x4257, 0x4159]
    assert await master.ask(write_pdu(CLAIM, claim_words(5)), 8, 2) == [CLAIM, 3]
    assert await master.ask(write_pdu(RUN_NUMBER, u32(5) + f32(5.0e4)), 8, 2) == [RUN_NUMBER, 4]
    clock.advance(1.0)
    words = await master.ask(read_write_pdu(LIVE, LIVE_WORDS, INDEX, u32(1)), 5 + 2 * LIVE_WORDS, 2)
    assert floats(words[6:8]) == pytest.approx([5.0e4], abs=1.0)
    with pytest.raises(RefusedError) as refused:
        await master.ask(read_pdu(3, 14, 1), 5)
    assert refused.value.code == 2
    master.close()


async def test_a_serial_slave_is_silent_for_others_broken_frames_and_broadcasts_and_goes_on(
    rtu: tuple[SimulatedPlant, Path, ManualClock],
) -> None:
    _, link, _ = rtu
    master = RtuMaster(link)
    good = b"\x01" + read_pdu(3, 0, 2)
    for frame in (
        b"\x09" + read_pdu(3, 0, 2),  # nobody's id
        b"\x00" + write_pdu(INDEX, u32(7)),  # everybody's id
    ):
        master.send(frame + crc(frame).to_bytes(2, "little"))
        assert await master.receive(1, 0.1) == b""
    unfinished = b"\x01" + write_pdu(1000, [0] * 120)[:50]  # without a pause it would swallow what comes next
    for broken in (good + b"\x00\x00", good[:3], b"\x01\x10\x00", b"\x55" * 40, unfinished):
        master.send(broken)
        assert await master.receive(1, 0.1) == b""
    assert await master.ask(read_pdu(3, INDEX, 2), 9) == [0, 0]
    master.close()


async def test_a_line_is_clean_for_a_master_that_sets_nothing_and_for_one_that_sets_parity_again_and_again(
    rtu: tuple[SimulatedPlant, Path, ManualClock],
) -> None:
    _, link, _ = rtu
    plain = RtuMaster(link, raw=False)
    assert await plain.ask(read_pdu(3, 0, 1), 7) == [0x4257]
    plain.close()
    for _ in range(3):
        with serial.Serial(str(link), 115200, parity="E"):
            pass
        master = RtuMaster(link, raw=False)
        assert await master.ask(read_pdu(3, 0, 1), 7) == [0x4257]
        master.close()


async def test_a_pulled_line_is_gone_and_works_again_when_it_is_back(
    rtu: tuple[SimulatedPlant, Path, ManualClock],
) -> None:
    plant, link, _ = rtu
    line = plant.slaves[0].line
    assert line is not None
    master = RtuMaster(link)
    assert await master.ask(read_pdu(3, 0, 1), 7) == [0x4257]
    line.pull()
    assert not link.exists()
    with pytest.raises(OSError, match="error"):
        master.send(b"\x01")
    master.close()
    line.plug()
    again = RtuMaster(link)
    assert await again.ask(read_pdu(3, 0, 1), 7) == [0x4257]
    again.close()


async def test_a_serial_port_that_is_not_the_simulators_is_never_touched(tmp_path: Path) -> None:
    real = tmp_path / "ttyUSB0"
    real.write_text("a device")
    (tmp_path / "link").symlink_to(real)
    for path in (real, tmp_path / "link", tmp_path / "nowhere" / "line"):
        plant = SimulatedPlant([valve("A")], {RtuListener(path): [reference_unit(1, "A")]})
        with pytest.raises(ConfigurationError):
            await plant.start()
    assert real.read_text() == "a device"
    (tmp_path / "dead").symlink_to("/dev/pts/99999")
    plant = SimulatedPlant([valve("A")], {RtuListener(tmp_path / "dead"): [reference_unit(1, "A")]})
    await plant.start()
    await plant.stop()


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """Return a self-signed certificate and its key."""
    key, made = tmp_path / "key.pem", tmp_path / "certificate.pem"
    options = [
        "req",
        "-x509",
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
        "-nodes",
        "-days",
        "2",
        "-subj",
        "/CN=localhost",
    ]
    command = ["openssl", *options, "-keyout", str(key), "-out", str(made)]
    if shutil.which("openssl") is None or subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("openssl is not there to make a certificate")
    return made, key


def tls_client(authority: Path) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=str(authority))
    context.check_hostname = False
    return context


async def test_tls_carries_the_same_frames_and_asks_for_a_clients_certificate(certificate: tuple[Path, Path]) -> None:
    listener = TcpListener(certificate_file=certificate[0], key_file=certificate[1], client_ca_file=certificate[0])
    plant = SimulatedPlant([valve("A")], {listener: [reference_unit(1, "A")]})
    await plant.start()
    known = tls_client(certificate[0])
    known.load_cert_chain(*certificate)
    master = await TcpMaster.connect(plant.addresses[0], known)
    numbers = [master.send(1, read_pdu(3, 0, 2)) for _ in range(3)]
    assert [await master.receive(1, number) for number in numbers] == [b"\x03\x04\x42\x57\x41\x59"] * 3
    await master.close()
    stranger = await TcpMaster.connect(plant.addresses[0], tls_client(certificate[0]))
    with pytest.raises((ssl.SSLError, ConnectionError, asyncio.IncompleteReadError)):
        await stranger.ask(read_pdu(3, 0, 2))
    with contextlib.suppress(ssl.SSLError, ConnectionError):
        await stranger.close()
    await plant.stop()


async def test_pymodbus_own_client_reads_what_was_written(rig: Rig) -> None:
    host, port = rig.plant.addresses[0].rsplit(":", 1)
    client = AsyncModbusTcpClient(host, port=int(port), retries=0, reconnect_delay=0)
    assert await client.connect()
    assert not (await client.write_registers(CORNERS, [77], device_id=7)).isError()
    assert (await client.read_holding_registers(CORNERS, count=1, device_id=7)).registers == [77]
    client.close()
