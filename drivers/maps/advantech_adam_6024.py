"""Advantech ADAM-6024: universal I/O module on Modbus TCP, six analog inputs and two analog outputs.

An output drives the I/P, inputs read position and pressure transmitters. It has no fence, no watchdog and no canary:
the wiring must waive the watchdog. Its outputs are read back through their own registers, it has no others.

An input's codes end at 4 and 20 mA: a broken wire reads as 4 mA, a stem at the lower end. The input's status alone
tells them apart.
"""

from __future__ import annotations

from typing import Final

from drivers.capabilities import Role
from drivers.register_map import GoldenFrame, RegisterMap
from drivers.registers import Register

_INPUT_CODES: Final = 65535  # 16 bits over the configured range
_OUTPUT_CODES: Final = 4095  # 12 bits over the configured range
_LOW_A, _HIGH_A = 0.004, 0.020  # the map is for channels that are configured as 4-20 mA


def _input(channel: int) -> Register:
    scale = (_HIGH_A - _LOW_A) / _INPUT_CODES
    return Register(f"ai{channel}", channel, unit="A", scale=scale, offset=_LOW_A, meaning=f"analog input {channel}")


def _output(channel: int) -> Register:
    return Register(
        f"ao{channel}",
        10 + channel,
        unit="A",
        scale=(_HIGH_A - _LOW_A) / _OUTPUT_CODES,
        offset=_LOW_A,
        writable=True,
        raw_range=(0, _OUTPUT_CODES),
        meaning=f"analog output {channel}",
    )


def _status(channel: int) -> Register:
    return Register(f"ai{channel}_status", 20 + channel, meaning="bits: 1 over high, 2 over low, 0 normal")


MAP: Final = RegisterMap(
    name="advantech_adam_6024",
    source=(
        "Advantech ADAM-6000 Series User Manual, appendix B.2.4 (40001-40006 inputs, 40011-40012 outputs, "
        "40021-40026 status); codes: 16-bit inputs and 12-bit outputs (0x0FFF) over the range configured for the "
        "channel, here 4-20 mA"
    ),
    registers=(*map(_input, range(6)), *map(_output, range(2)), *map(_status, range(6))),
    roles={Role.COMMAND: "ao0", Role.POSITION: "ai0", Role.PRESSURE: "ai1"},
    statuses={f"ai{channel}": f"ai{channel}_status" for channel in range(6)},
    golden=(
        GoldenFrame(
            request=bytes.fromhex("01 03 00 00 00 02 C4 0B"),
            answer=bytes.fromhex("01 03 04 80 00 FF FF D2 43"),
            values={"ai0": 0.0120001220721752, "ai1": 0.020},
            source="composed from the manual's table",
        ),
    ),
)
