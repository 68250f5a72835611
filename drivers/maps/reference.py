"""breakaway's own reference map: what a PLC implements to be a full partner (docs/reference-map.md).

Holding registers only, addresses from 0, 32-bit values high word first. Every block that is checked is read in
one transaction. Watchdog, fence and capture buffer are what a bare analog module lacks.

Every block that can change what the device does begins with the number of the run that writes it, is written whole in
one transaction and counts only for the run that owns the device: a write that is carried out late, of a run that has
ended, changes nothing.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Final

from drivers.capabilities import Capture, CaptureStates, Fence, LiveBlock, Role, Watchdog
from drivers.register_map import Canary, GoldenFrame, RegisterMap
from drivers.registers import Kind, Register

CANARY_VALUE: Final = 0x42574159  # "BWAY" in ASCII
CORNERS_ADDRESS: Final = 1000  # the corner table: 4 words a corner (time us u32, pressure Pa f32)
CORNER_WORDS: Final = 4
CORNER_CAPACITY: Final = 1024
WINDOW_ADDRESS: Final = 8000  # the sample window: index u32, WINDOW_SAMPLES x 3 words, CRC-16 of all before
WINDOW_SAMPLES: Final = 40
WINDOW_CHANNELS: Final = ("position", "pressure", "command")  # one u16 each, scaled by the ranges at 68-79
WINDOW_WORDS: Final = 2 + WINDOW_SAMPLES * len(WINDOW_CHANNELS) + 1
FULL_SCALE: Final = 65534  # the captured word that stands for the upper end of a range
MISSING_SAMPLE: Final = 0xFFFF  # a captured word that is no measurement; measurements use 0 to 65534


class WatchdogState(IntEnum):
    """What register ``watchdog_state`` says."""

    OFF = 0
    ARMED = 1
    TRIPPED = 2


class CaptureState(IntEnum):
    """What register ``capture_state`` says."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    ABORTED = 3


class CaptureControl(IntEnum):
    """What is written to ``capture_control``."""

    PREPARE = 1  # take the settings of this block, forget earlier samples
    START = 2
    ABORT = 3


class Claim(IntEnum):
    """What is written to ``claim``."""

    TAKE = 1
    RELEASE = 2


class StatusBit(IntEnum):
    """Bits of register ``status``."""

    AT_SAFE_VALUE = 0  # the device itself drives the safe value
    SENSOR_FAULT = 1
    LOOP_IN_MANUAL = 2
    INTERLOCK = 3
    CAPTURE_RUNNING = 4
    SUPPLY_LOW = 5


def _f32(name: str, address: int, unit: str, meaning: str, *, writable: bool = False) -> Register:
    return Register(name, address, Kind.F32, unit=unit, writable=writable, meaning=meaning)


def _u32(
    name: str, address: int, meaning: str, *, writable: bool = False, unit: str = "1", scale: float = 1.0
) -> Register:
    return Register(name, address, Kind.U32, unit=unit, scale=scale, writable=writable, meaning=meaning)


def _u16(
    name: str, address: int, meaning: str, *, writable: bool = False, unit: str = "1", scale: float = 1.0
) -> Register:
    return Register(name, address, Kind.U16, unit=unit, scale=scale, writable=writable, meaning=meaning)


MAP = RegisterMap(
    name="reference",
    source="docs/reference-map.md, version 1",
    canary=Canary("canary", float(CANARY_VALUE)),
    version=Canary("map_version", 1.0),
    number="device_id",
    roles={Role.COMMAND: "command", Role.POSITION: "position", Role.PRESSURE: "pressure"},
    readbacks={"command": "output"},
    fence=Fence(
        run_number="run_number",
        owner="run_owner",
        claim_run="claim_run",
        claim="claim",
        take=Claim.TAKE,
        release=Claim.RELEASE,
    ),
    watchdog=Watchdog(
        run="watchdog_run",
        timeout="watchdog_timeout",
        state="watchdog_state",
        safe_value="safe_value",
        heartbeat="heartbeat",
        armed=WatchdogState.ARMED,
        tripped=WatchdogState.TRIPPED,
    ),
    live=LiveBlock(
        registers=(
            "device_time",
            "position",
            "pressure",
            "output",
            "supply_pressure",
            "status",
            "sample_counter",
            "live_check",
        ),
        check="live_check",
        clock="device_time",
        counter="sample_counter",
        status="status",
        at_safe_mask=1 << StatusBit.AT_SAFE_VALUE,
        sensor_fault_mask=1 << StatusBit.SENSOR_FAULT,
        manual_mask=1 << StatusBit.LOOP_IN_MANUAL,
        interlock_mask=1 << StatusBit.INTERLOCK,
        supply_low_mask=1 << StatusBit.SUPPLY_LOW,
        supply="supply_pressure",
    ),
    capture=Capture(
        run="capture_run",
        state="capture_state",
        control="capture_control",
        prepare=CaptureControl.PREPARE,
        start=CaptureControl.START,
        abort=CaptureControl.ABORT,
        states=CaptureStates(running=CaptureState.RUNNING, done=CaptureState.DONE, aborted=CaptureState.ABORTED),
        period="capture_period",
        wanted="capture_wanted",
        taken="capture_taken",
        capacity="capture_capacity",
        corner_count="corner_count",
        corner_check="corner_check",
        corner_capacity="corner_capacity",
        corners_address=CORNERS_ADDRESS,
        ranges=(
            ("position_low", "position_high"),
            ("pressure_low", "pressure_high"),
            ("command_low", "command_high"),
        ),
        full_scale=FULL_SCALE,
        missing=MISSING_SAMPLE,
        window_index="window_index",
        window_address=WINDOW_ADDRESS,
        window_samples=WINDOW_SAMPLES,
    ),
    has_read_write=True,
    golden=(
        GoldenFrame(
            request=bytes.fromhex("01 03 00 00 00 03 05 CB"),
            answer=bytes.fromhex("01 03 06 42 57 41 59 00 01 5E 74"),
            values={"canary": float(CANARY_VALUE), "map_version": 1.0},
            source="composed from docs/reference-map.md: the canary and the version of unit 1",
        ),
        GoldenFrame(
            request=bytes.fromhex("01 10 00 20 00 04 08 00 00 00 07 47 1C 40 00 66 B7"),
            answer=bytes.fromhex("01 10 00 20 00 04 C0 00"),
            values={"run_number": 7.0, "command": 40_000.0},
            source="composed from docs/reference-map.md: run 7 commands 40 kPa",
        ),
    ),
    registers=(
        # identity, read only
        _u32("canary", 0, "always 0x42574159"),
        _u16("map_version", 2, "version of this map: 1"),
        _u32("device_id", 3, "number that the installer gave this device"),
        _u16("boot_count", 5, "one more after every restart of the device"),
        # live values, read as one block
        _u32("device_time", 16, "device clock, wraps after 4295 s", unit="s", scale=1.0e-6),
        _f32("position", 18, "m", "stem position; NaN when the sensor is bad"),
        _f32("pressure", 20, "Pa", "actuator pressure; NaN when there is no sensor or it is bad"),
        _f32("output", 22, "Pa", "pressure that the device asks of the I/P now"),
        _f32("supply_pressure", 24, "Pa", "air supply; NaN when there is no sensor"),
        _u16("status", 26, "bits: see StatusBit"),
        _u16("sample_counter", 27, "one more at every sample"),
        _u16("live_check", 28, "CRC-16/MODBUS of registers 16 to 27, high bytes first"),
        # command block
        _u32("run_number", 32, "number of the run that commands", writable=True),
        _f32("command", 34, "Pa", "pressure asked for", writable=True),
        # ownership block
        _u32("claim_run", 36, "number of the run that takes or releases the device", writable=True),
        _u16("claim", 38, "1 take, 2 release", writable=True),
        _u32("run_owner", 40, "run whose blocks count; 0: none, all are ignored"),
        # watchdog block
        _u32("watchdog_run", 44, "number of the run that sets or feeds the watchdog", writable=True),
        _u16(
            "watchdog_timeout",
            46,
            "silence until the safe value; 0: off",
            writable=True,
            unit="s",
            scale=1.0e-3,
        ),
        _u16("heartbeat", 47, "a change, or a command that counts, feeds the watchdog", writable=True),
        _f32("safe_value", 48, "Pa", "pressure that the device asks for when the watchdog trips", writable=True),
        _u16("watchdog_state", 50, "0 off, 1 armed, 2 tripped"),
        # capture block
        _u32("capture_run", 52, "number of the run whose capture this is", writable=True),
        _u16("capture_control", 54, "1 prepare, 2 start, 3 abort", writable=True),
        _u16("corner_count", 55, "corners of the waveform in the table at 1000", writable=True),
        _u16("corner_check", 56, "CRC-16/MODBUS of these corners, high bytes first", writable=True),
        _u32("capture_period", 57, "time between samples", writable=True, unit="s", scale=1.0e-6),
        _u32("capture_wanted", 59, "samples to take", writable=True),
        _u16("capture_state", 61, "0 idle, 1 running, 2 done, 3 aborted"),
        _u32("capture_taken", 62, "samples taken so far"),
        _u32("capture_capacity", 64, "samples that fit"),
        _u16("corner_capacity", 66, "corners that fit"),
        _f32("position_low", 68, "m", "position of a captured 0"),
        _f32("position_high", 70, "m", "position of a captured 65534"),
        _f32("pressure_low", 72, "Pa", "pressure of a captured 0"),
        _f32("pressure_high", 74, "Pa", "pressure of a captured 65534"),
        _f32("command_low", 76, "Pa", "command of a captured 0"),
        _f32("command_high", 78, "Pa", "command of a captured 65534"),
        _u32("window_index", 80, "first sample of the window at 8000", writable=True),
    ),
)
