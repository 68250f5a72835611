"""Moxa ioLogik E1240 (eight analog inputs) and E1241 (four analog outputs) on Modbus TCP, factory address table.

Raw words are a share of the range that is set for the channel. The scaled values are floats, high word first; they
are in mA as long as the module's own point-slope scaling is off.
"""

from __future__ import annotations

from typing import Final

from drivers.capabilities import Role
from drivers.register_map import GoldenFrame, RegisterMap
from drivers.registers import Kind, Register, Table, WordOrder

_AMPERE: Final = 1.0e-3  # the module counts milliamperes
_MANUAL: Final = "Moxa ioLogik E1200 Series User's Manual, appendix A, Modbus/TCP default address mappings"


def _raw_input(channel: int) -> Register:
    # FFFFh says over range and 0000h burnout in the mode that watches for it (the same manual, Using the Web Console).
    return Register(
        f"ai{channel}_raw",
        channel,
        table=Table.INPUT,
        scale=1.0 / 65535,
        raw_range=(1, 65534),
        meaning=f"analog input {channel}, share of its range",
    )


def _scaled(kind: str, channel: int, address: int) -> Register:
    return Register(
        f"{kind}{channel}",
        address,
        Kind.F32,
        Table.INPUT,
        unit="A",
        scale=_AMPERE,
        word_order=WordOrder.ABCD,
        meaning=f"analog {'input' if kind == 'ai' else 'output'} {channel}",
    )


def _raw_output(channel: int) -> Register:
    return Register(
        f"ao{channel}_raw",
        0x0400 + channel,
        unit="A",
        scale=0.016 / 4095,
        offset=0.004,
        writable=True,
        raw_range=(0, 4095),
        meaning=f"analog output {channel}, 12 bits over 4-20 mA",
    )


E1240: Final = RegisterMap(
    name="moxa_iologik_e1240",
    source=f"{_MANUAL}: E1240, raw 30001-30008, scaled Hi and Lo words 30009-30024",
    registers=(*map(_raw_input, range(8)), *(_scaled("ai", channel, 8 + 2 * channel) for channel in range(8))),
    roles={Role.POSITION: "ai0", Role.PRESSURE: "ai1"},
    golden=(
        GoldenFrame(
            request=bytes.fromhex("01 04 00 08 00 02 F0 09"),
            answer=bytes.fromhex("01 04 04 41 40 00 00 EE 6C"),
            values={"ai0": 0.012},
            source="composed from the manual's table: 12.0 mA, high word first",
        ),
    ),
)

E1241: Final = RegisterMap(
    name="moxa_iologik_e1241",
    source=f"{_MANUAL}: E1241, raw 41025-41028 (functions 3, 6, 16), scaled 30001-30008; 12-bit outputs at 4-20 mA",
    registers=(*map(_raw_output, range(4)), *(_scaled("ao", channel, 2 * channel) for channel in range(4))),
    roles={Role.COMMAND: "ao0_raw"},
    readbacks={f"ao{channel}_raw": f"ao{channel}" for channel in range(4)},
    golden=(
        GoldenFrame(
            request=bytes.fromhex("01 10 04 00 00 01 02 0F FF A6 20"),
            answer=bytes.fromhex("01 10 04 00 00 01 00 F9"),
            values={"ao0_raw": 0.020},
            source="composed from the manual's table: 20 mA on output 0",
        ),
    ),
)
