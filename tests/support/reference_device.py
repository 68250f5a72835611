"""A device with the reference map on a raw slave: fence, watchdog, capture and a stem that follows at once."""

from __future__ import annotations

import math
import struct
import time
from collections.abc import Callable

from drivers.crc import words_crc16
from drivers.maps.reference import (
    CANARY_VALUE,
    CORNERS_ADDRESS,
    MAP,
    WINDOW_ADDRESS,
    WINDOW_SAMPLES,
    CaptureControl,
    CaptureState,
    Claim,
    StatusBit,
    WatchdogState,
)
from tests.support.slave import RawSlave

SPAN_PA = 100_000.0
METRE_PER_PA = 1.0e-6
BLOCKS = {"run_number", "claim_run", "watchdog_run", "capture_run"}  # what each block of a run begins with


class ReferenceDevice:
    """Unit 1 of ``slave``. ``output_pa`` and ``moves`` are what a judge looks at."""

    def __init__(self, slave: RawSlave) -> None:
        self.slave = slave
        self.output_pa = 0.0
        self.moves: list[tuple[float, float]] = []  # time and pressure of every accepted command
        self.ignored = 0
        self.stuck = False
        self.break_check = 0  # live blocks whose CRC is spoiled
        self.break_windows = 0
        self.status = 1 << StatusBit.LOOP_IN_MANUAL
        self.frozen = False
        self.position_m: Callable[[float], float] = lambda pressure_pa: pressure_pa * METRE_PER_PA
        self._fed_s = math.inf
        self._counter = 0
        self._capture_start_s = math.nan
        self._corners: list[tuple[float, float]] = []
        slave.holding.clear()
        self.show(canary=CANARY_VALUE, map_version=1, device_id=77, boot_count=1)
        self.show(run_number=0, command=0.0, claim_run=0, claim=0, run_owner=0)
        self.show(watchdog_run=0, watchdog_timeout=0.0, heartbeat=0, safe_value=0.0, watchdog_state=WatchdogState.OFF)
        self.show(capture_run=0, capture_control=0, corner_count=0, corner_check=0, capture_period=0.001)
        self.show(capture_wanted=0, capture_state=0, capture_taken=0, capture_capacity=100_000, corner_capacity=1024)
        self.show(window_index=0)
        self.show(position_low=0.0, position_high=0.1, pressure_low=0.0, pressure_high=SPAN_PA)
        self.show(command_low=0.0, command_high=SPAN_PA)
        for address in range(CORNERS_ADDRESS, CORNERS_ADDRESS + 4 * 1024):
            slave.holding[1, address] = 0
        slave.on_read, slave.on_write = self.on_read, self.on_write

    def show(self, **values: float) -> None:
        for name, value in values.items():
            register = MAP.register(name)
            self.slave.set_words(1, register.address, list(register.encode(value)))

    def value(self, name: str) -> float:
        register = MAP.register(name)
        return register.decode([self.slave.holding[1, register.address + i] for i in range(register.words)])

    def move(self, pressure_pa: float) -> None:
        if not self.stuck:
            self.output_pa = pressure_pa
        self.moves.append((time.monotonic(), pressure_pa))

    # ---- what it does by itself

    def tick(self) -> None:
        now_s = time.monotonic()
        if self.value("watchdog_state") == WatchdogState.ARMED and now_s - self._fed_s > self.value("watchdog_timeout"):
            self.show(watchdog_state=WatchdogState.TRIPPED, run_owner=0)
            self.output_pa = self.value("safe_value")
            self._end_capture(CaptureState.ABORTED)
        if self.value("capture_state") == CaptureState.RUNNING:
            elapsed_s = now_s - self._capture_start_s
            self.output_pa = self._wave(elapsed_s)
            period_s, wanted = self.value("capture_period"), self.value("capture_wanted")
            taken = min(wanted, math.floor(elapsed_s / period_s) + 1)
            self.show(capture_taken=taken)
            if taken == wanted and elapsed_s >= self._corners[-1][0]:
                self._end_capture(CaptureState.DONE)

    def _end_capture(self, state: CaptureState) -> None:
        if self.value("capture_state") == CaptureState.RUNNING:
            self.show(capture_state=state)

    def _wave(self, at_s: float) -> float:
        before = self._corners[0]
        for corner in self._corners:
            if corner[0] > at_s:
                share = (at_s - before[0]) / (corner[0] - before[0])
                return before[1] + share * (corner[1] - before[1])
            before = corner
        return before[1]

    # ---- what is read

    def on_read(self, _unit: int, address: int, _count: int) -> None:
        self.tick()
        if address == 16:
            self._sample()
        if address == MAP.register("output").address:
            self.show(output=self.output_pa)
        if address == WINDOW_ADDRESS:
            self._window()

    def _sample(self) -> None:
        if not self.frozen:
            self._counter = (self._counter + 1) & 0xFFFF
            self.show(device_time=time.monotonic() % 4000.0, sample_counter=self._counter)
        tripped = self.value("watchdog_state") == WatchdogState.TRIPPED
        position_m = self.position_m(self.output_pa)
        self.show(output=self.output_pa, supply_pressure=140_000.0, status=self.status | int(tripped))
        for name, value in (("position", position_m), ("pressure", self.output_pa)):
            raw = struct.unpack(">HH", struct.pack(">f", value))
            self.slave.set_words(1, MAP.register(name).address, raw)
        words = [self.slave.holding[1, address] for address in range(16, 28)]
        check = words_crc16(words)
        if self.break_check > 0:
            self.break_check, check = self.break_check - 1, check ^ 1
        self.slave.holding[1, 28] = check

    def _window(self) -> None:
        first = round(self.value("window_index"))
        taken, period_s = self.value("capture_taken"), self.value("capture_period")
        words = [first >> 16, first & 0xFFFF]
        for index in range(first, first + WINDOW_SAMPLES):
            if index >= taken:
                words += [0xFFFF] * 3
                continue
            pressure_pa = self._wave(index * period_s)
            word = round(pressure_pa / SPAN_PA * 65534)
            words += [round(self.position_m(pressure_pa) / 0.1 * 65534), word, word]
        words.append(words_crc16(words))
        if self.break_windows > 0:
            self.break_windows, words[5] = self.break_windows - 1, words[5] ^ 8
        self.slave.set_words(1, WINDOW_ADDRESS, words)

    # ---- what is written

    def on_write(self, _unit: int, address: int, words: list[int]) -> int | None:
        self.tick()
        written = {
            r.name: r.decode(words[r.address - address :][: r.words])
            for r in MAP.registers
            if address <= r.address and r.address + r.words <= address + len(words)
        }
        if not self._counts(written):
            self.ignored += 1
            words[:] = [self.slave.holding[1, address + i] for i in range(len(words))]
            return None
        if "command" in written:
            self._fed_s = time.monotonic()
            self._end_capture(CaptureState.ABORTED)
            self.move(written["command"])
        if "claim" in written:
            self._claim(written)
        if "watchdog_timeout" in written:
            self._watchdog(written)
        if "capture_control" in written:
            return self._control(written)
        return None

    def _counts(self, written: dict[str, float]) -> bool:
        run = next((value for name, value in written.items() if name in BLOCKS), None)
        owner = self.value("run_owner")
        return run is None or (run != 0.0 and (run == owner or (owner == 0.0 and "claim" in written)))

    def _claim(self, written: dict[str, float]) -> None:
        if written["claim"] == Claim.TAKE:
            self.show(run_owner=written["claim_run"])
        else:
            self.show(run_owner=0, watchdog_state=WatchdogState.OFF)

    def _watchdog(self, written: dict[str, float]) -> None:
        if written["heartbeat"] != self.value("heartbeat") or self.value("watchdog_state") != WatchdogState.ARMED:
            self._fed_s = time.monotonic()
        self.show(watchdog_state=WatchdogState.ARMED if written["watchdog_timeout"] else WatchdogState.OFF)

    def _control(self, written: dict[str, float]) -> int | None:
        if written["capture_control"] == CaptureControl.PREPARE:
            self.show(capture_state=CaptureState.IDLE, capture_taken=0)
        if written["capture_control"] == CaptureControl.ABORT:
            self._end_capture(CaptureState.ABORTED)
        if written["capture_control"] != CaptureControl.START:
            return None
        self._corners, table = [], []
        for corner in range(round(written["corner_count"])):
            at = CORNERS_ADDRESS + 4 * corner
            words = [self.slave.holding[1, at + i] for i in range(4)]
            table += words
            time_us = words[0] << 16 | words[1]
            self._corners.append((time_us * 1e-6, struct.unpack(">f", struct.pack(">HH", words[2], words[3]))[0]))
        if words_crc16(table) != written["corner_check"]:
            return 3
        self._capture_start_s = time.monotonic()
        self.show(capture_state=CaptureState.RUNNING, capture_taken=0)
        return None
