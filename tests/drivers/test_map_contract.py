"""What every register map keeps, whichever device it describes; a new one is tested by its line in the registry."""

from __future__ import annotations

import math
import struct
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.capabilities import Role
from drivers.crc import crc16
from drivers.map_faults import map_faults
from drivers.maps import REGISTER_MAPS, register_map
from drivers.register_map import GoldenFrame, RegisterMap
from drivers.registers import Block, Kind, Register, Table, WordOrder
from valve.errors import ConfigurationError, ParameterError

MAPS = list(REGISTER_MAPS.values())
REGISTERS = [(entry, register) for entry in MAPS for register in entry.registers]
FRAMES = [(entry, frame) for entry in MAPS for frame in entry.golden]
every_map = pytest.mark.parametrize("entry", MAPS, ids=lambda entry: entry.name)
every_register = pytest.mark.parametrize(
    ("entry", "register"), REGISTERS, ids=[f"{entry.name}-{register.name}" for entry, register in REGISTERS]
)
every_frame = pytest.mark.parametrize(("entry", "frame"), FRAMES, ids=[entry.name for entry, _ in FRAMES])


@every_map
def test_a_map_cites_its_source_and_is_found_by_its_name(entry: RegisterMap) -> None:
    assert len(entry.source) > 20
    assert register_map(entry.name) is entry


@every_map
def test_no_two_registers_share_a_word(entry: RegisterMap) -> None:
    taken = [(r.table, address) for r in entry.registers for address in range(r.address, r.address + r.words)]
    assert len(taken) == len(set(taken))


@every_register
def test_a_register_gives_back_what_is_written_at_the_ends_of_its_range(entry: RegisterMap, register: Register) -> None:
    largest = {Kind.U16: 0xFFFF, Kind.I16: 0x7FFF, Kind.U32: 0xFFFFFFFF, Kind.I32: 0x7FFFFFFF, Kind.F32: 1.0e30}
    least = {Kind.U16: 0, Kind.I16: -0x8000, Kind.U32: 0, Kind.I32: -0x80000000, Kind.F32: -1.0e30}
    for raw in register.raw_range or (least[register.kind], largest[register.kind]):
        value = register.scale * raw + register.offset
        words = register.encode(value)
        assert len(words) == register.words
        assert register.decode(words) == pytest.approx(value, rel=1e-6, abs=0.0)


@every_register
def test_a_value_beyond_a_register_is_refused(entry: RegisterMap, register: Register) -> None:
    for value in (math.nan, math.inf, register.scale * 1.0e39 + register.offset):
        with pytest.raises(ParameterError, match=register.name):
            register.encode(value)


@every_map
def test_the_roles_of_a_map_are_fit_for_them(entry: RegisterMap) -> None:
    assert entry.roles
    if Role.COMMAND in entry.roles:
        assert entry.register(entry.roles[Role.COMMAND]).writable
    for command, shown in entry.readbacks.items():
        assert entry.register(command).unit == entry.register(shown).unit
        assert command != shown


@every_map
def test_every_register_can_be_read_alone_and_its_capabilities_in_one_go(entry: RegisterMap) -> None:
    assert all(entry.block(register.name).words == register.words for register in entry.registers)
    if entry.live is not None:
        block = entry.block(*entry.live.registers)
        assert sum(register.words for register in block.registers) == block.words <= 125
        assert block.registers[-1].name == entry.live.check
    if entry.fence is not None:
        number, command = entry.register(entry.fence.run_number), entry.register(entry.roles[Role.COMMAND])
        assert number.address + number.words == command.address
        assert entry.block(entry.fence.claim_run, entry.fence.claim).words == 3
    if entry.capture is not None:
        window_words = 2 + entry.capture.window_samples * len(entry.capture.ranges) + 1
        taken = range(entry.capture.window_address, entry.capture.window_address + window_words)
        assert window_words <= 125
        assert all(register.address not in taken for register in entry.registers)


@every_map
def test_a_map_can_carry_every_number_that_its_capabilities_need(entry: RegisterMap) -> None:
    assert map_faults(entry) == ()


@pytest.mark.parametrize(
    ("name", "kind", "said"),
    [
        ("claim_run", Kind.F32, "claim_run must hold 4294967295 exactly"),
        ("heartbeat", Kind.I16, "heartbeat must hold 65535 exactly"),
        ("status", Kind.F32, "overlap"),
        ("canary", Kind.F32, "canary must hold 1113014617 exactly"),
        ("corner_check", Kind.I16, "corner_check must hold 65535 exactly"),
    ],
)
def test_a_number_that_a_map_cannot_carry_is_found(name: str, kind: Kind, said: str) -> None:
    entry = register_map("reference")
    try:
        registers = tuple(replace(one, kind=kind) if one.name == name else one for one in entry.registers)
        found = map_faults(replace(entry, registers=registers))
    except ConfigurationError as error:
        found = (str(error),)
    assert any(said in one for one in found), found


@every_register
def test_what_a_register_says_it_holds_it_holds_and_nothing_beyond(entry: RegisterMap, register: Register) -> None:
    span = register.span
    for value in (span.least, span.greatest):
        assert register.holds(value)
        assert register.nearest(value) == pytest.approx(value, rel=1e-6, abs=span.step)
    if span.step > 0.0:
        assert not register.holds(span.least - span.step)
        assert not register.holds(span.greatest + span.step)
        assert register.nearest(span.least + 1.3 * span.step) == pytest.approx(span.least + span.step)


@every_map
def test_a_map_has_a_golden_frame(entry: RegisterMap) -> None:
    assert entry.golden


@every_frame
def test_a_golden_frame_is_whole_and_means_what_the_map_says(entry: RegisterMap, frame: GoldenFrame) -> None:
    for data in (frame.request, frame.answer):
        assert crc16(data[:-2]) == int.from_bytes(data[-2:], "little")
    function, address, count = frame.request[1], *struct.unpack(">HH", frame.request[2:6])
    if function == 16:
        assert frame.answer[:6] == frame.request[:6]
        words = struct.unpack(f">{count}H", frame.request[7:-2])
    else:
        words = struct.unpack(f">{count}H", frame.answer[3:-2])
    table = Table.INPUT if function == 4 else Table.HOLDING
    chosen = tuple(entry.register(name) for name in frame.values)
    assert {register.table for register in chosen} == {table}
    assert Block(chosen, address, count, table).decode(words) == pytest.approx(frame.values, rel=1e-9, abs=1e-12)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False), st.sampled_from(WordOrder))
def test_a_float_survives_every_word_order(value: float, order: WordOrder) -> None:
    register = Register("x", 0, Kind.F32, word_order=order)
    if abs(value) < 3.4e38:
        assert register.decode(register.encode(value)) == value


def test_word_orders_stand_on_the_wire_as_they_are_called() -> None:
    data = struct.pack(">I", 0x0A0B0C0D)
    for order, expected in {
        WordOrder.ABCD: (0x0A0B, 0x0C0D),
        WordOrder.CDAB: (0x0C0D, 0x0A0B),
        WordOrder.BADC: (0x0B0A, 0x0D0C),
        WordOrder.DCBA: (0x0D0C, 0x0B0A),
    }.items():
        assert Register("x", 0, Kind.U32, word_order=order).encode(float(int.from_bytes(data, "big"))) == expected


def test_signed_values_go_below_zero() -> None:
    assert Register("x", 0, Kind.I16, scale=0.1).encode(-12.3) == (0xFF85,)
    assert Register("x", 0, Kind.I32).decode((0xFFFF, 0xFFFE)) == -2.0


@pytest.mark.parametrize(
    ("registers", "match"),
    [
        ((Register("a", 0, Kind.F32), Register("b", 1)), "overlap"),
        ((Register("a", 0), Register("a", 1)), "twice"),
    ],
)
def test_a_map_that_contradicts_itself_is_refused(registers: tuple[Register, ...], match: str) -> None:
    with pytest.raises(ConfigurationError, match=match):
        RegisterMap("broken", "nowhere", registers)


def test_a_current_that_no_transmitter_gives_is_no_measurement() -> None:
    """NAMUR NE 43: a broken wire must not read as a stem a quarter of its travel below its seat."""
    scaled = register_map("moxa_iologik_e1240").register("ai0").within_standard_signal()
    stem = scaled.spanning((0.004, 0.020), (0.0, 0.1), "m")
    for milliamperes, position_m in (
        (0.0, math.nan),
        (3.59, math.nan),
        (3.7, -0.001875),
        (20.9, 0.105625),
        (22, math.nan),
    ):
        words = struct.unpack(">HH", struct.pack(">f", milliamperes))
        assert stem.decode(words) == pytest.approx(position_m, rel=1e-6, nan_ok=True)


def test_a_role_that_no_register_plays_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="no register 'b'"):
        RegisterMap("broken", "nowhere", (Register("a", 0),), roles={Role.COMMAND: "b"})


def test_the_two_generations_of_one_actuator_are_told_apart() -> None:
    older, second = register_map("fisher_easy_drive"), register_map("fisher_easy_drive_gen2")
    assert older.canary is not None
    assert second.canary is not None
    assert (older.canary.accepts(45964.0), second.canary.accepts(45964.0)) == (True, False)
    assert (older.canary.accepts(0.0), second.canary.accepts(0.0)) == (False, True)
    assert older.register("command").encode(0.5) == (50,)
    assert second.register("command").encode(0.5) == (500,)
