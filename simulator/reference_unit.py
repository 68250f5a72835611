"""A device with the reference map: identity, live values, fence, watchdog and capture buffer.

What docs/reference-map.md leaves open is decided here so: a block that does not count is not looked at further, so
its values are not refused either; a capture works on a copy of the corner table; half of a 32-bit register can be read;
addresses between the registers do not exist.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from drivers.maps.reference import (
    CANARY_VALUE,
    CORNER_CAPACITY,
    CORNER_WORDS,
    CORNERS_ADDRESS,
    MAP,
    WINDOW_ADDRESS,
    WINDOW_WORDS,
    CaptureControl,
    CaptureState,
    Claim,
    StatusBit,
    WatchdogState,
)
from drivers.registers import Table, words_crc16
from simulator.capture import (
    SAMPLE_CAPACITY,
    SHORTEST_PERIOD_S,
    Capture,
    capture_ranges,
    framed_window,
    window_words,
)
from simulator.faults import FaultKind
from simulator.plant import SoftwareValve
from simulator.record import Event, Happening
from simulator.unit import (
    ExceptionCode,
    NoAnswer,
    Refusal,
    measured_words,
    obey_wire_faults,
    registers_by_address,
)

FloatArray = npt.NDArray[np.float64]

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


@dataclass(frozen=True, slots=True)
class CaptureSettings:
    """What a capture is to be: corners of the table and their CRC, time between samples, number of samples."""

    corners: int = 0
    check: int = 0
    period_s: float = 1.0e-3
    wanted: int = 0

    @classmethod
    def of(cls, values: Mapping[str, float]) -> CaptureSettings:
        """Return the settings that a capture block carries."""
        corners, check = int(values["corner_count"]), int(values["corner_check"])
        return cls(corners, check, values["capture_period"], int(values["capture_wanted"]))


def _block_values(address: int, words: Sequence[int]) -> dict[str, float]:
    """Values of a block that was written whole. Raises Refusal for any other write."""
    block = _BLOCKS.get(address)
    if block is None or len(words) != block.words:
        raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
    return block.decode(words)


class ReferenceUnit:
    """One device with the reference map that commands ``command`` and senses ``position`` and ``pressure``.

    The sensed valves are None where this device has no such sensor. The watchdog and the capture player act at their
    own simulated times, whenever somebody looks afterwards, through this unit or another.
    """

    def __init__(
        self,
        device_id: int,
        command: SoftwareValve,
        *,
        position: SoftwareValve | None = None,
        pressure: SoftwareValve | None = None,
    ) -> None:
        self.device_id = device_id
        self._valve, self._position, self._pressure = command, position, pressure
        self._valves = tuple({id(v): v for v in (command, position, pressure) if v is not None}.values())
        self._ranges = capture_ranges(command.settings)
        self._boots = 1
        self._captures = 0
        self._sample_counter = 0
        self._until_s = command.time_s
        self._forget_everything()
        self._shows: dict[str, Callable[[], float]] = self._shown()
        command.before_advance = self._run_until

    def _forget_everything(self) -> None:
        """Memory as after a restart."""
        low_pa = self._valve.settings.transducer.range_pa[0]
        self._owner, self._command_pa = 0, low_pa
        self._timeout_s, self._watchdog, self._safe_pa = 0.0, WatchdogState.OFF, low_pa
        self._fed_s, self._heartbeat, self._at_safe = self._until_s, 0, False
        self._capture: Capture | None = None
        self._settings = CaptureSettings()
        self._window_index = 0
        self._written: dict[str, float] = {}  # what each block held when it counted last
        self._corners = [0] * (CORNER_CAPACITY * CORNER_WORDS)

    # What the device does by itself

    def _run_until(self, to_s: float) -> None:
        """Do what falls due until ``to_s``, each at its own time, and bring the valve there."""
        while True:
            trip_s = self._fed_s + self._timeout_s if self._watchdog is WatchdogState.ARMED else math.inf
            end_s = math.inf if self._capture is None or not self._capturing else self._capture.end_s
            restart_s = min(
                (
                    fault.start_s
                    for fault in self._valve.faults
                    if fault.kind is FaultKind.RESTART and fault.start_s > self._until_s
                ),
                default=math.inf,
            )
            due_s = min(trip_s, end_s, restart_s)
            if due_s > to_s:
                break
            self._settle(due_s)
            if due_s == restart_s:
                self._boots = (self._boots + 1) & 0xFFFF
                self._forget_everything()
            elif due_s == trip_s:
                self._trip()
            else:
                self._end_capture(CaptureState.DONE)
        self._settle(to_s)

    def _settle(self, to_s: float) -> None:
        """Advance the valve and take the samples that fall due."""
        if to_s < self._until_s:
            return
        if self._capture is not None and self._capturing:
            samples = self._valve.advance(to_s, self._capture.due_s(to_s))
            if samples is not None:
                self._capture.store(samples, self._valve.settings, self._ranges)
        else:
            self._valve.advance(to_s)
        self._until_s = to_s

    @property
    def _capturing(self) -> bool:
        return self._capture is not None and self._capture.state is CaptureState.RUNNING

    def _trip(self) -> None:
        self._watchdog = WatchdogState.TRIPPED
        if self._capturing:
            self._end_capture(CaptureState.ABORTED)
        self._valve.ask(self._safe_pa)
        self._owner, self._at_safe = 0, True
        self._note(Happening.WATCHDOG_TRIPPED, pressure_pa=self._safe_pa)

    def _end_capture(self, state: CaptureState) -> None:
        assert self._capture is not None
        self._capture.state = state
        if state is CaptureState.ABORTED:
            self._valve.hold()
        done = state is CaptureState.DONE
        self._note(Happening.CAPTURE_ENDED if done else Happening.CAPTURE_ABORTED, pressure_pa=self._valve.asked_pa)

    def _note(
        self,
        happening: Happening,
        address: int | None = None,
        words: Sequence[int] = (),
        pressure_pa: float | None = None,
        run: int | None = None,
    ) -> None:
        valve = self._valve
        device_id = None if address is None else self.device_id
        valve.record.add(
            Event(valve.time_s, valve.settings.tag, happening, device_id, address, tuple(words), pressure_pa, run)
        )

    # What is read

    def read(self, table: Table, address: int, count: int, now_s: float) -> list[int]:
        """Words at these addresses, computed now."""
        self._look(now_s)
        obey_wire_faults(self._valves)
        end = address + count
        if table is not Table.HOLDING:
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        if address >= CORNERS_ADDRESS and end <= _CORNERS_END:
            return self._corners[address - CORNERS_ADDRESS : end - CORNERS_ADDRESS]
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
        ranges = self._ranges
        return {
            "canary": lambda: CANARY_VALUE,
            "map_version": lambda: 1,
            "device_id": lambda: self.device_id,
            "boot_count": lambda: self._boots,
            **{
                name: partial(self._last_written, name)
                for name in ("run_number", "claim_run", "claim", "watchdog_run", "capture_run", "capture_control")
            },
            "command": lambda: self._command_pa,
            "run_owner": lambda: self._owner,
            "watchdog_timeout": lambda: self._timeout_s,
            "heartbeat": lambda: self._heartbeat,
            "safe_value": lambda: self._safe_pa,
            "watchdog_state": lambda: self._watchdog,
            "corner_count": lambda: self._settings.corners,
            "corner_check": lambda: self._settings.check,
            "capture_period": lambda: self._settings.period_s,
            "capture_wanted": lambda: self._settings.wanted,
            "capture_state": lambda: CaptureState.IDLE if self._capture is None else self._capture.state,
            "capture_taken": lambda: 0 if self._capture is None else self._capture.taken,
            "capture_capacity": lambda: SAMPLE_CAPACITY,
            "corner_capacity": lambda: CORNER_CAPACITY,
            "position_low": lambda: ranges.position_m[0],
            "position_high": lambda: ranges.position_m[1],
            "pressure_low": lambda: ranges.pressure_pa[0],
            "pressure_high": lambda: ranges.pressure_pa[1],
            "command_low": lambda: ranges.command_pa[0],
            "command_high": lambda: ranges.command_pa[1],
            "window_index": lambda: self._window_index,
        }

    def _last_written(self, name: str) -> float:
        return self._written.get(name, 0.0)

    def _live_words(self) -> list[int]:
        """Take one live sample; its words with their check."""
        self._sample_counter = (self._sample_counter + 1) & 0xFFFF
        valve = self._valve
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
        low_air = self._valve.supply_pa < self._valve.settings.transducer.range_pa[1]
        return (
            self._at_safe << StatusBit.AT_SAFE_VALUE
            | (self._position is not None and math.isnan(position_m)) << StatusBit.SENSOR_FAULT
            | self._capturing << StatusBit.CAPTURE_RUNNING
            | low_air << StatusBit.SUPPLY_LOW
        )

    def _window(self) -> list[int]:
        nothing = np.empty((0, 3), dtype=np.uint16)
        index = self._window_index
        samples = window_words(nothing, 0) if self._capture is None else self._capture.window(index)
        return framed_window(index, samples)

    # What is written

    def write(self, address: int, words: Sequence[int], now_s: float) -> None:
        """Write registers or corners; all values are checked before any takes effect."""
        self._look(now_s)
        silent = self._valve.fault(FaultKind.SILENCE) is not None
        try:
            if not silent:
                obey_wire_faults(self._valves)
            self._write(address, words)
        except Refusal:
            self._note(Happening.REFUSED, address, words)
            raise
        if silent:
            raise NoAnswer

    def _write(self, address: int, words: Sequence[int]) -> None:
        ignored = self._valve.fault(FaultKind.IGNORED_WRITES) is not None
        end = address + len(words)
        if address >= CORNERS_ADDRESS and end <= _CORNERS_END:
            if not ignored:
                self._corners[address - CORNERS_ADDRESS : end - CORNERS_ADDRESS] = list(words)
            self._note(Happening.IGNORED if ignored else Happening.WRITTEN, address, words)
            return
        values = _block_values(address, words)
        run = int(next(iter(values.values()))) if address in _OWNED_BLOCKS else None
        counts = run is None or self._counts(address, run)
        if counts:
            self._check(values)
        if ignored or not counts:
            asked_pa = values.get("command")
            self._note(Happening.IGNORED if ignored else Happening.FENCED, address, words, asked_pa, run)
            return
        self._written |= values
        if "command" in values:
            self._obey_command(values["command"], address, words, run)
            return
        self._note(Happening.WRITTEN, address, words, run=run)
        if "claim" in values:
            self._obey_claim(values)
        elif "heartbeat" in values:
            self._set_watchdog(values)
        elif "capture_control" in values:
            self._control(values)
        else:
            self._window_index = int(values["window_index"])

    def _counts(self, address: int, run: int) -> bool:
        """Whether a block of this run may act: it owns the device, or takes it while nobody does."""
        free = self._owner == 0 and address == _CLAIM.address
        return run != 0 and (run == self._owner or free)

    def _check(self, values: dict[str, float]) -> None:
        """Raise Refusal where a block that counts has a value that cannot be taken."""
        covers = self._valve.settings.transducer.covers
        pressures = [values[name] for name in ("command", "safe_value") if name in values]
        fits = all(math.isfinite(pressure_pa) and covers(pressure_pa) for pressure_pa in pressures)
        if "claim" in values:
            fits = values["claim"] in tuple(Claim)
        if "capture_control" in values:
            fits = self._may_control(values)
        if not fits:
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)

    def _may_control(self, values: dict[str, float]) -> bool:
        control = values["capture_control"]
        if control == CaptureControl.ABORT:
            return True
        if control not in tuple(CaptureControl) or self._capturing:
            return False
        return control == CaptureControl.PREPARE or self._may_start(CaptureSettings.of(values))

    def _may_start(self, settings: CaptureSettings) -> bool:
        sampling = settings.period_s >= SHORTEST_PERIOD_S * (1.0 - 1.0e-9) and 1 <= settings.wanted <= SAMPLE_CAPACITY
        return sampling and self._corner_table(settings) is not None

    def _corner_table(self, settings: CaptureSettings) -> tuple[FloatArray, FloatArray] | None:
        """Times after the start and pressures of the table's first corners; None where they make no waveform."""
        count = settings.corners
        if not 2 <= count <= CORNER_CAPACITY:
            return None
        if words_crc16(self._corners[: count * CORNER_WORDS]) != settings.check:
            return None
        table = np.array(self._corners[: count * CORNER_WORDS], dtype=">u2").reshape(count, CORNER_WORDS)
        time_s = np.ascontiguousarray(table[:, :2]).view(">u4").astype(np.float64).ravel() * 1.0e-6
        pressure_pa = np.ascontiguousarray(table[:, 2:]).view(">f4").astype(np.float64).ravel()
        covers = self._valve.settings.transducer.covers
        if time_s[0] != 0.0 or (np.diff(time_s) < 0.0).any():
            return None
        if not (np.isfinite(pressure_pa).all() and covers(pressure_pa.min()) and covers(pressure_pa.max())):
            return None
        return time_s, pressure_pa

    def _obey_command(self, pressure_pa: float, address: int, words: Sequence[int], run: int | None) -> None:
        self._command_pa = pressure_pa
        if self._capturing:
            self._end_capture(CaptureState.ABORTED)
        self._valve.ask(pressure_pa)
        self._fed_s, self._at_safe = self._until_s, False
        self._note(Happening.COMMANDED, address, words, pressure_pa, run)

    def _obey_claim(self, values: dict[str, float]) -> None:
        if values["claim"] == Claim.TAKE:
            self._owner = int(values["claim_run"])
        elif not self._capturing and self._owner != 0:
            self._owner, self._timeout_s, self._watchdog = 0, 0.0, WatchdogState.OFF

    def _set_watchdog(self, values: dict[str, float]) -> None:
        """Take timeout, safe value and heartbeat; only a change of the heartbeat, or arming, feeds."""
        armed = self._watchdog is WatchdogState.ARMED
        self._timeout_s, self._safe_pa = values["watchdog_timeout"], values["safe_value"]
        self._watchdog = WatchdogState.ARMED if self._timeout_s > 0.0 else WatchdogState.OFF
        heartbeat = int(values["heartbeat"])
        if heartbeat != self._heartbeat or not armed:
            self._heartbeat, self._fed_s = heartbeat, self._until_s

    def _control(self, values: dict[str, float]) -> None:
        control = CaptureControl(int(values["capture_control"]))
        if control is CaptureControl.ABORT:
            if self._capturing:
                self._end_capture(CaptureState.ABORTED)
            return
        self._settings = CaptureSettings.of(values)
        if control is CaptureControl.PREPARE:
            self._capture = None
        else:
            self._start_capture()

    def _start_capture(self) -> None:
        settings = self._settings
        corners = self._corner_table(settings)
        assert corners is not None  # checked before anything of this write took effect
        after_s, pressure_pa = corners
        self._captures += 1
        start_s = self._until_s
        self._valve.play(after_s, pressure_pa)
        self._capture = Capture(self._captures, start_s, settings.period_s, settings.wanted, float(after_s[-1]))
        self._at_safe = False
        self._note(Happening.CAPTURE_STARTED, pressure_pa=float(pressure_pa[0]), run=self._owner)
        self._settle(start_s)
