"""What a device with the reference map does: fence, watchdog and capture player, by its own clock.

What docs/reference-map.md leaves open is decided here so: a capture works on a copy of the corner table.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from drivers.crc import words_crc16
from drivers.maps.reference import (
    CORNER_CAPACITY,
    CORNER_WORDS,
    CaptureControl,
    CaptureState,
    Claim,
    WatchdogState,
)
from simulator.capture import SAMPLE_CAPACITY, SHORTEST_PERIOD_S, Capture, capture_ranges
from simulator.faults import FaultKind
from simulator.plant import SoftwareValve
from simulator.record import Event, Happening

FloatArray = npt.NDArray[np.float64]


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


class ReferenceDevice:
    """Drives one valve; watchdog and capture player act at their own simulated times, whenever somebody looks later.

    What stands here without a leading underscore is what its registers show; whoever serves them decides which writes
    count and are valid before anything is obeyed.
    """

    def __init__(self, device_id: int, valve: SoftwareValve, speed: float = 1.0) -> None:
        self.device_id, self.valve = device_id, valve
        self.ranges = capture_ranges(valve.settings)
        self.boots = 1
        self._speed = speed
        self._captures = 0
        self._until_s = valve.time_s
        self._forget_everything()
        valve.before_advance = self._run_until

    def _forget_everything(self) -> None:
        """Memory as after a restart."""
        low_pa = self.valve.settings.transducer.range_pa[0]
        self.owner, self.command_pa = 0, low_pa
        self.timeout_s, self.watchdog, self.safe_pa = 0.0, WatchdogState.OFF, low_pa
        self._fed_s, self.heartbeat, self.at_safe = self._until_s, 0, False
        self.capture: Capture | None = None
        self.settings = CaptureSettings()
        self.window_index = 0
        self.written: dict[str, float] = {}  # what each block held when it counted last
        self.corners = [0] * (CORNER_CAPACITY * CORNER_WORDS)

    # What the device does by itself

    def _run_until(self, to_s: float) -> None:
        """Do what falls due until ``to_s``, each at its own time, and bring the valve there."""
        while True:
            # The watchdog waits for the master, who lives in real time however fast the valve's clock runs.
            trip_s = self._fed_s + self.timeout_s * self._speed if self.watchdog is WatchdogState.ARMED else math.inf
            end_s = math.inf if self.capture is None or not self.capturing else self.capture.end_s
            restart_s = min(
                (
                    fault.start_s
                    for fault in self.valve.faults
                    if fault.kind is FaultKind.RESTART and fault.start_s > self._until_s
                ),
                default=math.inf,
            )
            due_s = min(trip_s, end_s, restart_s)
            if due_s > to_s:
                break
            self._settle(due_s)
            if due_s == restart_s:
                self.boots = (self.boots + 1) & 0xFFFF
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
        if self.capture is not None and self.capturing:
            samples = self.valve.advance(to_s, self.capture.due_s(to_s))
            if samples is not None:
                self.capture.store(samples, self.valve.settings, self.ranges)
        else:
            self.valve.advance(to_s)
        self._until_s = to_s

    @property
    def capturing(self) -> bool:
        """Whether a capture runs."""
        return self.capture is not None and self.capture.state is CaptureState.RUNNING

    def _trip(self) -> None:
        self.watchdog = WatchdogState.TRIPPED
        if self.capturing:
            self._end_capture(CaptureState.ABORTED)
        self.valve.ask(self.safe_pa)
        self.owner, self.at_safe = 0, True
        self.note(Happening.WATCHDOG_TRIPPED, pressure_pa=self.safe_pa)

    def _end_capture(self, state: CaptureState) -> None:
        assert self.capture is not None
        self.capture.state = state
        if state is CaptureState.ABORTED:
            self.valve.hold()
        done = state is CaptureState.DONE
        self.note(Happening.CAPTURE_ENDED if done else Happening.CAPTURE_ABORTED, pressure_pa=self.valve.asked_pa)

    def note(
        self,
        happening: Happening,
        address: int | None = None,
        words: Sequence[int] = (),
        pressure_pa: float | None = None,
        run: int | None = None,
    ) -> None:
        """Keep an event in the valve's record."""
        valve = self.valve
        device_id = None if address is None else self.device_id
        valve.record.add(
            Event(valve.time_s, valve.settings.tag, happening, device_id, address, tuple(words), pressure_pa, run)
        )

    def may_control(self, values: Mapping[str, float]) -> bool:
        """Whether a capture block has values that can be taken now."""
        control = values["capture_control"]
        if control == CaptureControl.ABORT:
            return True
        if control not in tuple(CaptureControl) or self.capturing:
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
        if words_crc16(self.corners[: count * CORNER_WORDS]) != settings.check:
            return None
        table = np.array(self.corners[: count * CORNER_WORDS], dtype=">u2").reshape(count, CORNER_WORDS)
        time_s = np.ascontiguousarray(table[:, :2]).view(">u4").astype(np.float64).ravel() * 1.0e-6
        pressure_pa = np.ascontiguousarray(table[:, 2:]).view(">f4").astype(np.float64).ravel()
        covers = self.valve.settings.transducer.covers
        if time_s[0] != 0.0 or (np.diff(time_s) < 0.0).any():
            return None
        if not (np.isfinite(pressure_pa).all() and covers(pressure_pa.min()) and covers(pressure_pa.max())):
            return None
        return time_s, pressure_pa

    def obey_command(self, pressure_pa: float, address: int, words: Sequence[int], run: int | None) -> None:
        """Ask for a pressure; a capture that runs is ended."""
        self.command_pa = pressure_pa
        if self.capturing:
            self._end_capture(CaptureState.ABORTED)
        self.valve.ask(pressure_pa)
        self._fed_s, self.at_safe = self._until_s, False
        self.note(Happening.COMMANDED, address, words, pressure_pa, run)

    def obey_claim(self, values: Mapping[str, float]) -> None:
        """Give the device to a run, or take it from its owner together with its watchdog."""
        if values["claim"] == Claim.TAKE:
            self.owner = int(values["claim_run"])
        elif not self.capturing and self.owner != 0:
            self.owner, self.timeout_s, self.watchdog = 0, 0.0, WatchdogState.OFF

    def set_watchdog(self, values: Mapping[str, float]) -> None:
        """Take timeout, safe value and heartbeat; only a change of the heartbeat, or arming, feeds."""
        armed = self.watchdog is WatchdogState.ARMED
        self.timeout_s, self.safe_pa = values["watchdog_timeout"], values["safe_value"]
        self.watchdog = WatchdogState.ARMED if self.timeout_s > 0.0 else WatchdogState.OFF
        heartbeat = int(values["heartbeat"])
        if heartbeat != self.heartbeat or not armed:
            self.heartbeat, self._fed_s = heartbeat, self._until_s

    def control(self, values: Mapping[str, float]) -> None:
        """Prepare, start or abort a capture."""
        control = CaptureControl(int(values["capture_control"]))
        if control is CaptureControl.ABORT:
            if self.capturing:
                self._end_capture(CaptureState.ABORTED)
            return
        self.settings = CaptureSettings.of(values)
        if control is CaptureControl.PREPARE:
            self.capture = None
        else:
            self._start_capture()

    def _start_capture(self) -> None:
        settings = self.settings
        corners = self._corner_table(settings)
        assert corners is not None  # checked before anything of this write took effect
        after_s, pressure_pa = corners
        self._captures += 1
        start_s = self._until_s
        self.valve.play(after_s, pressure_pa)
        self.capture = Capture(self._captures, start_s, settings.period_s, settings.wanted, float(after_s[-1]))
        self.at_safe = False
        self.note(Happening.CAPTURE_STARTED, pressure_pa=float(pressure_pa[0]), run=self.owner)
        self._settle(start_s)
