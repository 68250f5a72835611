"""A device with the reference map: identity, live values, fence, watchdog and capture buffer.

What docs/reference-map.md leaves open is decided here so: a command counts only when ``run_number`` and ``command``
come in one write; a write of ``run_owner`` that may not take the device is acknowledged and changes nothing, so read
it back; half of a 32-bit register cannot be written; a capture works on a copy of the corner table, is done when its
last sample was taken and its waveform has ended, and leaves the last corner's pressure; an aborted capture holds the
pressure of that moment; addresses between the registers do not exist.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
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
    StatusBit,
    WatchdogState,
)
from drivers.registers import Register, Table, words_crc16
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
    covered,
    measured_words,
    obey_wire_faults,
    registers_by_address,
)

FloatArray = npt.NDArray[np.float64]

_REGISTERS: Final = registers_by_address(MAP.registers, Table.HOLDING)
_LIVE: Final = MAP.block(
    "device_time", "position", "pressure", "output", "supply_pressure", "status", "sample_counter", "live_check"
)
_CORNERS_END: Final = CORNERS_ADDRESS + CORNER_CAPACITY * CORNER_WORDS
_WINDOW_END: Final = WINDOW_ADDRESS + WINDOW_WORDS
_DEVICE_TIME_WRAP_S: Final = 2**32 * 1.0e-6


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
        self._run_number, self._owner, self._command_pa = 0, 0, low_pa
        self._timeout_s, self._watchdog, self._safe_pa = 0.0, WatchdogState.OFF, low_pa
        self._fed_s, self._heartbeat, self._at_safe = self._until_s, 0, False
        self._capture: Capture | None = None
        self._period_s, self._wanted, self._corner_count, self._window_index = 1.0e-3, 0, 0, 0
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
            "run_number": lambda: self._run_number,
            "command": lambda: self._command_pa,
            "run_owner": lambda: self._owner,
            "watchdog_timeout": lambda: self._timeout_s,
            "watchdog_state": lambda: self._watchdog,
            "safe_value": lambda: self._safe_pa,
            "heartbeat": lambda: self._heartbeat,
            "capture_state": lambda: CaptureState.IDLE if self._capture is None else self._capture.state,
            "capture_control": lambda: CaptureControl.NONE,
            "capture_period": lambda: self._period_s,
            "capture_wanted": lambda: self._wanted,
            "capture_taken": lambda: 0 if self._capture is None else self._capture.taken,
            "capture_capacity": lambda: SAMPLE_CAPACITY,
            "corner_count": lambda: self._corner_count,
            "corner_capacity": lambda: CORNER_CAPACITY,
            "position_low": lambda: ranges.position_m[0],
            "position_high": lambda: ranges.position_m[1],
            "pressure_low": lambda: ranges.pressure_pa[0],
            "pressure_high": lambda: ranges.pressure_pa[1],
            "command_low": lambda: ranges.command_pa[0],
            "command_high": lambda: ranges.command_pa[1],
            "window_index": lambda: self._window_index,
        }

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
        registers = covered(_REGISTERS, address, len(words))
        values = {r.name: r.decode(list(words[r.address - address :][: r.words])) for r in registers}
        self._check(registers, values)
        if ignored:
            self._note(Happening.IGNORED, address, words)
            return
        if "command" in values:
            self._obey_command(values, address, words)
        else:
            self._note(Happening.WRITTEN, address, words)
        for name, value in values.items():
            self._take(name, value)

    def _check(self, registers: Sequence[Register], values: dict[str, float]) -> None:
        """Raise Refusal where a register cannot be written or does not take this value."""
        if not all(register.writable for register in registers):
            raise Refusal(ExceptionCode.ILLEGAL_ADDRESS)
        covers = self._valve.settings.transducer.covers
        for name in ("command", "safe_value"):
            if name in values and not (math.isfinite(values[name]) and covers(values[name])):
                raise Refusal(ExceptionCode.ILLEGAL_VALUE)
        if "capture_control" in values and not self._may_control(values):
            raise Refusal(ExceptionCode.ILLEGAL_VALUE)

    def _may_control(self, values: dict[str, float]) -> bool:
        control = values["capture_control"]
        if control == CaptureControl.START:
            if self._capturing or self._owner == 0:
                return False
            period_s = values.get("capture_period", self._period_s)
            wanted = values.get("capture_wanted", self._wanted)
            count = int(values.get("corner_count", self._corner_count))
            sampling = period_s >= SHORTEST_PERIOD_S * (1.0 - 1.0e-9) and 1 <= wanted <= SAMPLE_CAPACITY
            return sampling and self._corner_table(count) is not None
        if control == CaptureControl.CLEAR:
            return not self._capturing
        return control in (CaptureControl.NONE, CaptureControl.ABORT)

    def _corner_table(self, count: int) -> tuple[FloatArray, FloatArray] | None:
        """Times after the start and pressures of the table's first corners; None where they make no waveform."""
        if not 1 <= count <= CORNER_CAPACITY:
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

    def _obey_command(self, values: dict[str, float], address: int, words: Sequence[int]) -> None:
        """Let a command act if it comes with the owner's number in the same write."""
        run, pressure_pa = int(values.get("run_number", 0)), values["command"]
        self._command_pa = pressure_pa
        if run == 0 or run != self._owner:
            self._note(Happening.FENCED, address, words, pressure_pa, run)
            return
        if self._capturing:
            self._end_capture(CaptureState.ABORTED)
        self._valve.ask(pressure_pa)
        self._fed_s, self._at_safe = self._until_s, False
        self._note(Happening.COMMANDED, address, words, pressure_pa, run)

    def _take(self, name: str, value: float) -> None:
        """Let one written value act; commands were obeyed before."""
        number = int(value) if math.isfinite(value) else 0
        if name == "run_number":
            self._run_number = number
        elif name == "run_owner":
            release = number == 0 and not self._capturing
            if self._owner in (0, number) or release:
                self._owner = number
        elif name == "watchdog_timeout":
            self._timeout_s, self._fed_s = value, self._until_s
            self._watchdog = WatchdogState.ARMED if value > 0.0 else WatchdogState.OFF
        elif name == "safe_value":
            self._safe_pa = value
        elif name == "heartbeat":
            if number != self._heartbeat:
                self._heartbeat, self._fed_s = number, self._until_s
        elif name == "capture_period":
            self._period_s = value
        elif name == "capture_wanted":
            self._wanted = number
        elif name == "corner_count":
            self._corner_count = number
        elif name == "window_index":
            self._window_index = number
        elif name == "capture_control":
            self._control(CaptureControl(number))

    def _control(self, control: CaptureControl) -> None:
        if control is CaptureControl.START:
            self._start_capture()
        elif control is CaptureControl.ABORT and self._capturing:
            self._end_capture(CaptureState.ABORTED)
        elif control is CaptureControl.CLEAR:
            self._capture = None

    def _start_capture(self) -> None:
        corners = self._corner_table(self._corner_count)
        assert corners is not None  # checked before anything of this write took effect
        after_s, pressure_pa = corners
        self._captures += 1
        start_s = self._until_s
        self._valve.play(after_s, pressure_pa)
        self._capture = Capture(self._captures, start_s, self._period_s, self._wanted, float(after_s[-1]))
        self._at_safe = False
        self._note(Happening.CAPTURE_STARTED, pressure_pa=float(pressure_pa[0]), run=self._owner)
        self._settle(start_s)
