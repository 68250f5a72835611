"""Control loops as a historian has them, controller output and process value, with a sticking valve or an impostor.

A flow (self-regulating, quick), a level (integrating) and a temperature (self-regulating, slow) under a PI controller.
A sticking valve is the rough one of the benchmarks, its friction scaled to a share of its span.
``python -m tests.support.control_loops examples/loop.csv`` writes the example.
"""

from __future__ import annotations

import math
import sys
import zlib
from collections import deque
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np

from simulator.plant import SoftwareValve
from tests.support.rough_valves import rough_valve
from valve.recording import FloatArray

STATIC: Final = 1.25  # static over sliding friction: packings of the benchmarks' valves have 1.25 to 1.3
GOOD: Final = 0.001  # friction of a valve in order, share of the span: as with a positioner
_ENDS: Final = (0.02, 0.98)  # the controller's output stays within


class Kind(StrEnum):
    """What the loop does, and why."""

    STICKS = "valve sticks, 2 to 3 % of span"
    STICKS_HARD = "valve sticks, 5 to 10 % of span"
    STICKS_NOISY = "valve sticks, much noise and load"
    STICKS_SLOW_ROWS = "valve sticks, slow rows"
    QUIET = "quiet"
    STEPS = "set point steps"
    TIGHT = "tight tuning"
    TIGHT_NOISY = "tight tuning, much noise and load"
    TIGHT_SLOW_ROWS = "tight tuning, slow rows"
    SINE = "outer sine"
    SINE_SLOW_ROWS = "outer sine, slow rows"
    SQUARE = "outer on and off"
    TRIANGLE = "outer triangle"
    SETPOINT = "set point swings"
    SATURATED = "swings between the ends"

    @property
    def sticks(self) -> bool:
        """Whether the valve is the cause."""
        return self.name.startswith("STICKS")


@dataclass(frozen=True, slots=True)
class Process:
    """A process by its times in s; ``tau_s`` of an integrating one is the time in which a full flow fills it."""

    tau_s: float
    dead_s: float
    second_s: float
    gain: float
    is_integrating: bool
    scan_s: float
    hours: float
    controller_gain: float
    reset_s: float


PROCESSES: Final = {
    "flow": Process(5.0, 1.0, 0.5, 1.0, False, 1.0, 2.0, 0.5, 6.0),
    "level": Process(300.0, 4.0, 8.0, 1.0, True, 3.0, 6.0, 3.0, 200.0),
    "temperature": Process(150.0, 25.0, 30.0, 1.2, False, 12.0, 30.0, 1.2, 160.0),
}


@dataclass(frozen=True, slots=True, eq=False)
class ControlLoop:
    """Rows of shape (n,): s, and shares of the span; ``friction`` of the valve, share of its span."""

    time_s: FloatArray
    output: FloatArray
    value: FloatArray
    setpoint: FloatArray
    process: str
    kind: Kind
    friction: float
    period_s: float  # of the impostor, or what linear theory gives the tightest tuning
    position: FloatArray


@dataclass(slots=True)
class _Plant:
    """The process from the valve's position to the value, both shares of the span about 0."""

    process: Process
    value: float = 0.0
    lagged: float = 0.0
    delayed: deque[float] = field(default_factory=deque)

    def __post_init__(self) -> None:
        self.delayed.extend([0.0] * round(self.process.dead_s / self.process.scan_s))

    def advance(self, driven: float) -> None:
        """Go on by one scan."""
        one = self.process
        self.delayed.append(driven)
        self.lagged += (self.delayed.popleft() - self.lagged) * -math.expm1(-one.scan_s / one.second_s)
        if one.is_integrating:
            self.value += self.lagged * one.gain * one.scan_s / one.tau_s
        else:
            self.value += (one.gain * self.lagged - self.value) * -math.expm1(-one.scan_s / one.tau_s)


class _PositionedValve:
    """A valve in order: its positioner follows the signal 1 s later, but for a dead band."""

    def __init__(self, scan_s: float, dead_band: float = GOOD) -> None:
        self.position, self._keep, self._dead_band = 0.5, math.exp(-scan_s / 1.0), dead_band

    def advance(self, wanted: float) -> None:
        if abs(wanted - self.position) > self._dead_band:
            self.position += (wanted - self.position) * (1.0 - self._keep)


class _StickingValve:
    """The rough valve of the benchmarks with friction of this share of its span, on a bare I/P."""

    def __init__(self, friction: float, seed: int, scan_s: float) -> None:
        settings = rough_valve("large", "usual", seed)
        actuator = settings.nameplate.actuator
        assert actuator.bench_set_pa is not None
        assert actuator.diaphragm_area_m2 is not None
        self._low_pa, high_pa = actuator.bench_set_pa
        self._span_pa, self._travel_m, self._scan_s = high_pa - self._low_pa, actuator.travel_m, scan_s
        coulomb_n = friction * actuator.diaphragm_area_m2 * self._span_pa
        parameters = replace(settings.parameters, coulomb_friction_n=coulomb_n, static_friction_n=STATIC * coulomb_n)
        start_pa = self._low_pa + 0.5 * self._span_pa
        self._device = SoftwareValve(replace(settings, parameters=parameters, start_pa=start_pa))
        self._device.look(1.0)

    @property
    def position(self) -> float:
        return self._device.stem.position_m / self._travel_m

    def advance(self, wanted: float) -> None:
        self._device.ask(self._low_pa + wanted * self._span_pa)
        self._device.advance(self._device.time_s + self._scan_s)


def _swing_after_a_kick(one: Process, scans: int = 1500) -> FloatArray:
    """Value of the linear loop after a kick."""
    plant, valve, integral, values = _Plant(one), _PositionedValve(one.scan_s, 0.0), 0.0, np.empty(scans)
    plant.value, valve.position = 1.0, 0.0
    for scan in range(scans):
        integral -= one.controller_gain * plant.value * one.scan_s / one.reset_s
        valve.advance(integral - one.controller_gain * plant.value)
        plant.advance(valve.position)
        values[scan] = plant.value
        if abs(plant.value) > 10.0:
            return values[: scan + 1]
    return values


def _ultimate(one: Process) -> tuple[float, float]:
    """By how much the controller's gain may rise before the loop swings by itself, and the period of that, s."""
    low, high = 1.0, 100.0
    while high / low > 1.01:
        middle = math.sqrt(low * high)
        values = _swing_after_a_kick(replace(one, controller_gain=one.controller_gain * middle))
        grows = np.abs(values[-1]) > 10.0 or np.ptp(values[-300:]) > np.ptp(values[300:600])
        low, high = (low, middle) if grows else (middle, high)
    values = _swing_after_a_kick(replace(one, controller_gain=one.controller_gain * low))
    changes = np.flatnonzero(np.diff(np.signbit(values)))
    return low, float(2.0 * np.mean(np.diff(changes)) * one.scan_s)


def control_loop(process: str, kind: Kind, seed: int) -> ControlLoop:
    """Return a loop of some hours; the same arguments give the same loop."""
    random = np.random.default_rng([seed, zlib.crc32(f"{process} {kind.name}".encode())])

    def about(value: float, share: float = 0.4) -> float:
        return float(value * (1.0 + share) ** random.uniform(-1.0, 1.0))

    one = PROCESSES[process]
    one = replace(
        one,
        tau_s=about(one.tau_s),
        dead_s=about(one.dead_s),
        second_s=about(one.second_s),
        gain=about(one.gain),
        controller_gain=about(one.controller_gain, 0.3),
        reset_s=about(one.reset_s, 0.3),
    )
    friction = GOOD
    if kind.sticks:
        friction = float(random.uniform(0.05, 0.1) if kind is Kind.STICKS_HARD else random.uniform(0.02, 0.03))
        if kind in (Kind.STICKS_NOISY, Kind.STICKS_SLOW_ROWS):
            friction = float(random.uniform(0.02, 0.08))
    ultimate, period_s = _ultimate(one)
    if kind.name.startswith("TIGHT"):
        one = replace(one, controller_gain=one.controller_gain * ultimate * random.uniform(0.88, 0.97))
    if kind is Kind.SATURATED:
        one = replace(one, controller_gain=one.controller_gain * ultimate * random.uniform(1.15, 1.6))
    is_load = kind in (Kind.SINE, Kind.SINE_SLOW_ROWS, Kind.SQUARE, Kind.TRIANGLE)
    if is_load or kind is Kind.SETPOINT:
        period_s *= float(np.exp(random.uniform(math.log(1.5), math.log(15.0))))
        period_s = min(max(period_s, 10.0 * one.scan_s), 3600.0 * one.hours / 15.0)
    noise = about(0.001, 1.0) * (5.0 if "NOISY" in kind.name else 1.0) * (0.3 if process != "flow" else 1.0)
    load_size = about(0.003, 0.5) * (3.0 if "NOISY" in kind.name else 1.0)
    swing = float(random.uniform(0.02, 0.06))

    scans = round(3600.0 * one.hours / one.scan_s)
    load_s = 8.0 * one.tau_s if not one.is_integrating else one.tau_s
    keep = math.exp(-one.scan_s / load_s)
    load_noise = load_size * math.sqrt(1.0 - keep * keep) * random.standard_normal(scans)
    value_noise = noise * random.standard_normal(scans)
    angle = 2.0 * math.pi * one.scan_s * np.arange(scans) / period_s + random.uniform(0.0, 6.0)
    wave = np.sin(angle)
    if kind is Kind.SQUARE:
        wave = np.where(np.mod(angle / (2.0 * math.pi), 1.0) < random.uniform(0.3, 0.7), 1.0, -1.0)
    if kind is Kind.TRIANGLE:
        wave = 2.0 / math.pi * np.arcsin(wave)
    every_s = 40.0 * max(one.reset_s, one.dead_s)
    steps_at = random.random(scans) < (one.scan_s / every_s if kind is Kind.STEPS else 0.15 * one.scan_s / every_s)
    steps = 0.05 * random.standard_normal(scans)

    valve = _StickingValve(friction, seed, one.scan_s) if kind.sticks else _PositionedValve(one.scan_s)
    plant = _Plant(one)
    setpoint, load, integral = 0.5, 0.0, 0.5
    rows = np.empty((scans, 4))
    for scan in range(scans):
        load = keep * load + load_noise[scan]
        if steps_at[scan]:
            setpoint = min(max(setpoint + steps[scan], 0.35), 0.65)
        wanted = setpoint + (swing * wave[scan] if kind is Kind.SETPOINT else 0.0)
        measured = 0.5 + plant.value + value_noise[scan]
        error = wanted - measured
        integral = min(max(integral + one.controller_gain * error * one.scan_s / one.reset_s, _ENDS[0]), _ENDS[1])
        output = min(max(integral + one.controller_gain * error, _ENDS[0]), _ENDS[1])
        rows[scan] = output, measured, wanted, valve.position
        valve.advance(output)
        outer_load = swing * wave[scan] if is_load else 0.0
        plant.advance(valve.position - 0.5 + load + outer_load)
    every = 1
    if "SLOW_ROWS" in kind.name:
        # 8 to 14 rows a period: the rate at which many historians keep a loop
        every = max(1, round(_swing_s(rows[:, 0], one.scan_s) / random.uniform(8.0, 14.0) / one.scan_s))
    kept = rows[::every]
    time_s = one.scan_s * every * np.arange(kept.shape[0], dtype=np.float64)
    return ControlLoop(time_s, kept[:, 0], kept[:, 1], kept[:, 2], process, kind, friction, period_s, kept[:, 3])


def _swing_s(output: FloatArray, scan_s: float) -> float:
    """Mean period of a loop's output, from its changes of sign about its running mean."""
    smooth = output - np.mean(output)
    changes = np.flatnonzero(np.diff(np.signbit(smooth)))
    return float(2.0 * np.median(np.diff(changes)) * scan_s) if changes.size > 3 else 10.0 * scan_s


def write_example(path: Path) -> None:
    """Write a flow loop whose valve sticks as a historian exports it: two hours, a row each 5 s, percent and m3/h."""
    made = control_loop("flow", Kind.STICKS_HARD, 11)
    begin = datetime(2026, 3, 2, 6, tzinfo=UTC)
    lines = ["Timestamp;FIC-107.OP [%];FIC-107.PV [m3/h];FIC-107.SP [m3/h]"]
    for row in range(0, made.time_s.size, 5):
        stamp = begin + timedelta(seconds=float(made.time_s[row]))
        numbers = (100.0 * made.output[row], 40.0 * made.value[row], 40.0 * made.setpoint[row])
        lines.append(f"{stamp:%Y-%m-%d %H:%M:%S};" + ";".join(f"{number:.2f}" for number in numbers))
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    write_example(Path(sys.argv[1]))
