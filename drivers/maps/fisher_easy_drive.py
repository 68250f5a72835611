"""Fisher easy-Drive electric actuator (D3, D4 valves) on Modbus RTU, in two generations.

Both keep command and position at the same addresses, the older in percent, the second generation in tenths of a
percent: taken for the other, one moves ten times too far or not at all. The older shows 45964 in its test register
40009, which is reserved in the second; the maps demand and exclude it.

Both are positioners: they hold a position whatever force it takes. They show where a stem is; friction is found from
the pressure that moves it, so a test cannot be commanded through them.
"""

from __future__ import annotations

from typing import Final

from drivers.capabilities import Role
from drivers.register_map import Canary, GoldenFrame, RegisterMap
from drivers.registers import Register

_TEST_VALUE: Final = 45964.0  # 0xB38C


def _travel(name: str, address: int, steps: int, meaning: str, *, writable: bool = False) -> Register:
    return Register(
        name, address, scale=1.0 / steps, writable=writable, raw_range=(0, steps), meaning=f"{meaning}, share of travel"
    )


def _registers(steps: int) -> tuple[Register, ...]:
    return (
        _travel("command", 0, steps, "position asked for", writable=True),
        Register("test", 8, meaning="45964 in the older generation, reserved in the second"),
        _travel("position", 9, steps, "position of the stem"),
        _travel("commanded", 10, steps, "position that the control loop follows"),
        Register("diagnostics", 11, meaning="flags, see the manual's table"),
    )


_ROLES: Final = {Role.COMMAND: "command", Role.POSITION: "position"}
_READBACKS: Final = {"command": "commanded"}

OLDER: Final = RegisterMap(
    name="fisher_easy_drive",
    source=(
        "Emerson D103460X012, D3 Valve with easy-Drive Actuator, October 2017, appendix A: table 4 and A.3.7 "
        "(test register 40009 = 45964)"
    ),
    registers=_registers(100),
    canary=Canary("test", _TEST_VALUE),
    is_positioner=True,
    roles=_ROLES,
    readbacks=_READBACKS,
    golden=(
        GoldenFrame(
            request=bytes.fromhex("01 03 00 09 00 01 54 08"),
            answer=bytes.fromhex("01 03 02 00 00 B8 44"),
            values={"position": 0.0},
            source="printed in Emerson D103460X012, A.4.2",
        ),
    ),
)

GEN_2: Final = RegisterMap(
    name="fisher_easy_drive_gen2",
    source=(
        "Emerson D104161X012, D3 Valve with Gen 2 easy-Drive Actuator, February 2021, appendix A: table 4 "
        "(40001, 40010, 40011: 1000 = 100.0 %)"
    ),
    registers=_registers(1000),
    canary=Canary("test", _TEST_VALUE, differs=True),
    is_positioner=True,
    roles=_ROLES,
    readbacks=_READBACKS,
    golden=(
        GoldenFrame(
            request=bytes.fromhex("01 03 00 09 00 02 14 09"),
            answer=bytes.fromhex("01 03 04 01 F4 03 E8 BA 83"),
            values={"position": 0.5, "commanded": 1.0},
            source="composed from the manual's table",
        ),
    ),
)
