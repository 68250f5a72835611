"""The registers of a device with the reference map: what they show, and which writes count.

What docs/reference-map.md leaves open is decided here so: half of a 32-bit register can be read; addresses between the
registers do not exist.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from drivers.crc import words_crc16
from drivers.maps.reference import (
    CANARY_VALUE,
    CORNER_CAPACITY,
    CORNER_WORDS,
    CORNERS_ADDRESS,
    MAP,
    WINDOW_ADDRESS,
    WINDOW_WORDS,
    CaptureState,
    Claim,
    StatusBit,
)
from drivers.registers import Table
from simulator.capture import (
    SAMPLE_CAPACITY,
    framed_window,
    window_words,
)
from simulator.faults import FaultKind
from simulator.plant import SoftwareValve
from simulator.record import Happening
from simulator.reference_device import ReferenceDevice
from simulator.unit import (
    ExceptionCode,
    NoAnswer,
    Refusal,
    measured_words,
    obey_wire_faults,
    registers_by_address,
)

_REGISTERS: Final = registers_by_address(MAP.registers, Table.HOLDING)
_LIVE: Final = MAP.block(
    "device_time", "position", "pressure", "output", "supply_pressure", "status", "sample_counter", "live_check"
)
_COMMAND: Final = MAP.block("run_number", "command")
_CLAIM: Final = MAP.block("claim_run", "claim")
_WATCHDOG: Final = MAP.block("watchdog_run", "watchdog_timeout", "heartbeat", "safe_value")
_CAPTURE: Final = MAP.block(
    "capture_run", "capture_control", "corner_count", "corner_check", "capture_period", "capture_wanted"
)
_OWNED_BLOCKS: Final = {block.address: block for block in (_COMMAND, _CLAIM, _WATCHDOG, _CAPTURE)}
_BLOCKS: Final = {**_OWNED_BLOCKS, (_INDEX := MAP.block("window_index")).address: _INDEX}
_CORNERS_END: Final = CORNERS_ADDRESS + CORNER_CAPACITY * CORNER_WORDS
_WINDOW_END: Final = WINDOW_ADDRESS + WINDOW_WORDS
_DEVICE_TIME_WRAP_S: Final = 2**32 * 1.0e-6


def _block_values(address: int, words: Sequence[int]) -> dict[str, float]:
    """Values of a block that was written whole. Raises Refusal for any other write."""
    block = _BLOCKS.get(address)
    if block is None or len(words) != block.words:
        raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
    return block.decode(words)


class ReferenceUnit:
    """One device with the reference map that commands ``command`` and senses ``position`` and ``pressure``.

    The sensed valves are None where this device has no such sensor. The watchdog and the capture player act at their
    own simulated times, whenever somebody looks afterwards, through this unit or another. ``speed`` is that of the
    clock: the watchdog's timeout counts real seconds.
    """

    def __init__(
        self,
        device_id: int,
        command: SoftwareValve,
        *,
        position: SoftwareValve | None = None,
        pressure: SoftwareValve | None = None,
        speed: float = 1.0,
    ) -> None:
        self.device_id = device_id
        self._device = ReferenceDevice(device_id, command, speed)
        self._position, self._pressure = position, pressure
        self._valves = tuple({id(v): v for v in (command, position, pressure) if v is not None}.values())
        self._sample_counter = 0
        self._shows: dict[str, Callable[[], float]] = self._shown()

    # What is read

    def read(self, table: Table, address: int, count: int, now_s: float) -> list[int]:
        """Words at these addresses, computed now."""
        self._look(now_s)
        obey_wire_faults(self._valves)
        end = address + count
        if table is not Table.HOLDING:
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        if address >= CORNERS_ADDRESS and end <= _CORNERS_END:
            return self._device.corners[address - CORNERS_ADDRESS : end - CORNERS_ADDRESS]
        if address >= WINDOW_ADDRESS and end <= _WINDOW_END:
            return self._window()[address - WINDOW_ADDRESS : end - WINDOW_ADDRESS]
        if address == _LIVE.address and count == _LIVE.words:
            return self._live_words()
        return self._register_words(address, end)

    def _look(self, now_s: float) -> None:
        for valve in self._valves:
            valve.look(now_s)

    def _register_words(self, address: int, end: int) -> list[int]:
        words: list[int] = []
        live: list[int] | None = None
        at = address
        while at < end:
            register = _REGISTERS.get(at)
            if register is None:
                raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
            if _LIVE.address <= at < _LIVE.address + _LIVE.words:
                live = live or self._live_words()
                words.append(live[at - _LIVE.address])
                at += 1
                continue
            whole = measured_words(register, self._shows[register.name]())
            taken = whole[at - register.address : end - register.address]
            words += taken
            at += len(taken)
        return words

    def _shown(self) -> dict[str, Callable[[], float]]:
        """What each register outside the live block shows."""
        ranges = self._device.ranges
        return {
            "canary": lambda: CANARY_VALUE,
            "map_version": lambda: 1,
            "device_id": lambda: self.device_id,
            "boot_count": lambda: self._device.boots,
            **{
                name: partial(self._last_written, name)
                for name in ("run_number", "claim_run", "claim", "watchdog_run", "capture_run", "capture_control")
            },
            "command": lambda: self._device.command_pa,
            "run_owner": lambda: self._device.owner,
            "watchdog_timeout": lambda: self._device.timeout_s,
            "heartbeat": lambda: self._device.heartbeat,
            "safe_value": lambda: self._device.safe_pa,
            "watchdog_state": lambda: self._device.watchdog,
            "corner_count": lambda: self._device.settings.corners,
            "corner_check": lambda: self._device.settings.check,
            "capture_period": lambda: self._device.settings.period_s,
            "capture_wanted": lambda: self._device.settings.wanted,
            "capture_state": lambda: CaptureState.IDLE if self._device.capture is None else self._device.capture.state,
            "capture_taken": lambda: 0 if self._device.capture is None else self._device.capture.taken,
            "capture_capacity": lambda: SAMPLE_CAPACITY,
            "corner_capacity": lambda: CORNER_CAPACITY,
            "position_low": lambda: ranges.position_m[0],
            "position_high": lambda: ranges.position_m[1],
            "pressure_low": lambda: ranges.pressure_pa[0],
            "pressure_high": lambda: ranges.pressure_pa[1],
            "command_low": lambda: ranges.command_pa[0],
            "command_high": lambda: ranges.command_pa[1],
            "window_index": lambda: self._device.window_index,
        }

    def _last_written(self, name: str) -> float:
        return self._device.written.get(name, 0.0)

    def _live_words(self) -> list[int]:
        """Take one live sample; its words with their check."""
        self._sample_counter = (self._sample_counter + 1) & 0xFFFF
        valve = self._device.valve
        position_m = math.nan if self._position is None else self._position.read_position_m()
        values = {
            "device_time": math.floor(valve.time_s * 1.0e6) % 2**32 * 1.0e-6,
            "position": position_m,
            "pressure": math.nan if self._pressure is None else self._pressure.read_pressure_pa(),
            "output": valve.asked_pa,
            "supply_pressure": valve.supply_pa,
            "status": float(self._status(position_m)),
            "sample_counter": float(self._sample_counter),
        }
        words: list[int] = []
        for register in _LIVE.registers[:-1]:
            words += measured_words(register, values[register.name])
        words.append(words_crc16(words))
        return words

    def _status(self, position_m: float) -> int:
        valve = self._device.valve
        low_air = valve.supply_pa < valve.settings.transducer.range_pa[1]
        in_manual = valve.fault(FaultKind.LOOP_IN_AUTOMATIC) is None
        return (
            self._device.at_safe << StatusBit.AT_SAFE_VALUE
            | (self._position is not None and math.isnan(position_m)) << StatusBit.SENSOR_FAULT
            | in_manual << StatusBit.LOOP_IN_MANUAL
            | (valve.fault(FaultKind.INTERLOCK) is not None) << StatusBit.INTERLOCK
            | self._device.capturing << StatusBit.CAPTURE_RUNNING
            | low_air << StatusBit.SUPPLY_LOW
        )

    def _window(self) -> list[int]:
        nothing = np.empty((0, 3), dtype=np.uint16)
        index = self._device.window_index
        samples = window_words(nothing, 0) if self._device.capture is None else self._device.capture.window(index)
        return framed_window(index, samples)

    # What is written

    def write(self, address: int, words: Sequence[int], now_s: float) -> None:
        """Write registers or corners; all values are checked before any takes effect."""
        self._look(now_s)
        silent = self._device.valve.fault(FaultKind.SILENCE) is not None
        try:
            if not silent:
                obey_wire_faults(self._valves)
            self._write(address, words)
        except Refusal:
            self._device.note(Happening.REFUSED, address, words)
            raise
        if silent:
            raise NoAnswer

    def _write(self, address: int, words: Sequence[int]) -> None:
        ignored = self._device.valve.fault(FaultKind.IGNORED_WRITES) is not None
        end = address + len(words)
        if address >= CORNERS_ADDRESS and end <= _CORNERS_END:
            if not ignored:
                self._device.corners[address - CORNERS_ADDRESS : end - CORNERS_ADDRESS] = list(words)
            self._device.note(Happening.IGNORED if ignored else Happening.WRITTEN, address, words)
            return
        values = _block_values(address, words)
        run = int(next(iter(values.values()))) if address in _OWNED_BLOCKS else None
        counts = run is None or self._counts(address, run)
        if counts:
            self._check(values)
        if ignored or not counts:
            asked_pa = values.get("command")
            self._device.note(Happening.IGNORED if ignored else Happening.FENCED, address, words, asked_pa, run)
            return
        self._device.written |= values
        if "command" in values:
            self._device.obey_command(values["command"], address, words, run)
            return
        self._device.note(Happening.WRITTEN, address, words, run=run)
        if "claim" in values:
            self._device.obey_claim(values)
        elif "heartbeat" in values:
            self._device.set_watchdog(values)
        elif "capture_control" in values:
            self._device.control(values)
        else:
            self._device.window_index = int(values["window_index"])

    def _counts(self, address: int, run: int) -> bool:
        """Whether a block of this run may act: it owns the device, or takes it while nobody does."""
        free = self._device.owner == 0 and address == _CLAIM.address
        return run != 0 and (run == self._device.owner or free)

    def _check(self, values: dict[str, float]) -> None:
        """Raise Refusal where a block that counts has a value that cannot be taken."""
        covers = self._device.valve.settings.transducer.covers
        pressures = [values[name] for name in ("command", "safe_value") if name in values]
        fits = all(math.isfinite(pressure_pa) and covers(pressure_pa) for pressure_pa in pressures)
        if "claim" in values:
            fits = values["claim"] in tuple(Claim)
        if "capture_control" in values:
            fits = self._device.may_control(values)
        if not fits:
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)
