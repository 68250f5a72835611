"""What a device can do beside keeping values, as data: a map names the registers, device code never asks for a map."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Role(StrEnum):
    """What a register is to a valve."""

    COMMAND = "command"
    POSITION = "position"
    PRESSURE = "pressure"
    SUPPLY = "supply"


@dataclass(frozen=True, slots=True)
class Fence:
    """Blocks that move count only while the run number that each begins with equals ``owner``.

    ``run_number`` begins the command's block. A device is taken and released by ``claim_run`` and ``claim`` together.
    """

    run_number: str
    owner: str
    claim_run: str
    claim: str
    take: int
    release: int


@dataclass(frozen=True, slots=True)
class Watchdog:
    """A timer in the device that drives ``safe_value`` after ``timeout`` without a command or a changed heartbeat.

    ``run``, ``timeout``, ``heartbeat`` and ``safe_value`` are neighbours and are written together; a device that knows
    no runs has no ``run``.
    """

    run: str | None
    timeout: str
    state: str
    safe_value: str
    heartbeat: str
    armed: int
    tripped: int


@dataclass(frozen=True, slots=True)
class LiveBlock:
    """Values that are read in one transaction and belong to one instant.

    ``check`` is the CRC of every word before it. The masks are bits of ``status``: the device drives its safe value,
    its sensor is bad, the loop is in manual, an interlock is active, the air supply is low; 0 where it has no such bit.
    ``supply`` is the air supply's register, if any.
    """

    registers: tuple[str, ...]
    check: str
    clock: str
    counter: str
    status: str
    at_safe_mask: int
    sensor_fault_mask: int
    manual_mask: int = 0
    interlock_mask: int = 0
    supply_low_mask: int = 0
    supply: str | None = None


@dataclass(frozen=True, slots=True)
class CaptureStates:
    """Values of a capture's state register."""

    running: int
    done: int
    aborted: int


@dataclass(frozen=True, slots=True)
class Capture:
    """A device that plays corners by its own clock and keeps samples, which are fetched window by window.

    A window holds the index of its first sample (u32), ``window_samples`` rows of u16 (position, pressure, command;
    each range's two registers stand for 0 and ``full_scale``) and the CRC of all before. ``run``, ``control``,
    ``corner_count``, ``corner_check`` (CRC of the corners), ``period`` and ``wanted`` are written together.
    """

    run: str
    state: str
    control: str
    prepare: int
    start: int
    abort: int
    states: CaptureStates
    period: str
    wanted: str
    taken: str
    capacity: str
    corner_count: str
    corner_check: str
    corner_capacity: str
    corners_address: int
    ranges: tuple[tuple[str, str], tuple[str, str], tuple[str, str]]
    full_scale: int
    missing: int
    window_index: str
    window_address: int
    window_samples: int
