"""A device that plays a waveform by its own clock and keeps samples: hand over the corners, fetch the samples."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drivers.bus import Exchange
from drivers.capabilities import Capture
from drivers.course import Course
from drivers.crc import words_crc16
from drivers.faults import CorruptBlockError, IllegalFunctionError
from drivers.registers import Kind, Register, Table
from drivers.wiring import Unit
from valve.errors import DeviceError, WaveformError, WireError
from valve.messages import say

AfterEach = Callable[[], None]
FloatArray = npt.NDArray[np.float64]

_CORNERS_A_WRITE: Final = 30  # 120 words; one write carries 123
_READS_A_WINDOW: Final = 3  # reading moves nothing, so a window may be read again
CORNER_TIME: Final = Register("corner time", 0, Kind.U32, unit="s", scale=1.0e-6)
CORNER_PRESSURE: Final = Register("corner pressure", 2, Kind.F32, unit="Pa")


@dataclass(frozen=True, slots=True)
class Progress:
    """How far a capture is, and whose it is."""

    run_number: int
    taken: int
    wanted: int
    running: bool
    done: bool
    aborted: bool


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """Samples from ``first`` on, each channel of shape (n,), m and Pa; NaN where the device has no valid one."""

    first: int
    position_m: FloatArray
    pressure_pa: FloatArray
    command_pa: FloatArray


class CaptureBuffer:
    """The capture buffer of one device."""

    def __init__(self, tag: str, unit: Unit, capture: Capture) -> None:
        self._tag = tag
        self._unit = unit
        self._capture = capture
        self._has_read_write = unit.map.has_read_write
        self._settings: dict[str, float] = {}

    def kept_period_s(self, period_s: float) -> float:
        """Time between samples as the device can keep it, s. Raises ParameterError where it cannot."""
        register = self._unit.map.register(self._capture.period)
        return register.decode(register.encode(period_s))

    async def check(self, course: Course) -> None:
        """Make sure that a waveform and its samples fit. Raises WaveformError where they do not."""
        capture = self._capture
        shown = await self._unit.values(capture.capacity, capture.corner_capacity)
        if course.samples > shown[capture.capacity]:
            raise WaveformError(
                say(
                    "capture_too_many_samples",
                    "{tag}: {samples} samples, {device} keeps {kept:.0f}: make the test shorter or its period longer",
                    tag=self._tag,
                    samples=course.samples,
                    device=self._unit.subject,
                    kept=shown[capture.capacity],
                )
            )
        if course.waveform.time_s.size > shown[capture.corner_capacity]:
            raise WaveformError(
                say(
                    "capture_too_many_corners",
                    "{tag}: {corners} corners, {device} keeps {kept:.0f}: choose a waveform with fewer",
                    tag=self._tag,
                    corners=course.waveform.time_s.size,
                    device=self._unit.subject,
                    kept=shown[capture.corner_capacity],
                )
            )

    async def hand_over(self, course: Course, run_number: int) -> AsyncIterator[None]:
        """Write corners and settings and read them back, a part at a time: the caller may do other things between.

        Samples of an earlier capture are forgotten. Raises DeviceError where the device holds something else.
        """
        unit = self._unit
        words = [
            word
            for time_s, pressure_pa in zip(course.waveform.time_s, course.waveform.pressure_pa, strict=True)
            for word in (*CORNER_TIME.encode(float(time_s)), *CORNER_PRESSURE.encode(float(pressure_pa)))
        ]
        size = 4 * _CORNERS_A_WRITE
        for start in range(0, len(words), size):
            part, address = words[start : start + size], self._capture.corners_address + start
            await unit.bus.write(unit.device_id, address, part)
            shown = await unit.bus.read_words(unit.device_id, Table.HOLDING, address, len(part))
            if list(shown.words) != part:
                raise DeviceError(
                    say(
                        "capture_other_corners",
                        "{tag}: {device} holds other corners than were written: check the map",
                        tag=self._tag,
                        device=unit.subject,
                    )
                )
            yield
        await self._prepare(run_number, words_crc16(words), course)
        yield
        await self._require_settings()

    async def _prepare(self, run_number: int, check: int, course: Course) -> None:
        capture, unit = self._capture, self._unit
        settings = {
            capture.run: float(run_number),
            capture.corner_count: float(course.waveform.time_s.size),
            capture.corner_check: float(check),
            capture.period: course.period_s,
            capture.wanted: float(course.samples),
        }
        await unit.write({**settings, capture.control: capture.prepare})
        self._settings = settings

    async def _require_settings(self) -> None:
        """Read the settings back. Raises DeviceError where the device holds others."""
        unit = self._unit
        held = await unit.values(*self._settings)
        for name, value in self._settings.items():
            if abs(held[name] - value) > 0.5 * unit.map.register(name).resolution:
                raise DeviceError(
                    say(
                        "capture_written_otherwise",
                        "{tag}: {written:g} was written to {register} of {device} and it holds {held:g}: check the "
                        "device and its map",
                        tag=self._tag,
                        written=value,
                        register=name,
                        device=unit.subject,
                        held=held[name],
                    )
                )

    async def start(self) -> None:
        """Start what was handed over, once. Raises DeviceError where the device does not start."""
        capture = self._capture
        await self._unit.write({**self._settings, capture.control: capture.start})
        await self._require_settings()
        progress = await self.progress()
        if not (progress.running or progress.done):
            raise DeviceError(
                say(
                    "capture_not_started",
                    "{tag}: {device} does not start its capture: look at its state",
                    tag=self._tag,
                    device=self._unit.subject,
                )
            )

    async def progress(self, *, agreed: bool = False, after_each: AfterEach = lambda: None) -> Progress:
        """How far the capture is; ``agreed``: as two looks in a row show it, for one that has ended.

        ``after_each`` is called after each transaction; what it raises ends this.
        """
        capture = self._capture
        names = (capture.run, capture.state, capture.wanted, capture.taken)
        shown = await (self._agreed(names, after_each) if agreed else self._unit.values(*names))
        state = shown[capture.state]
        return Progress(
            run_number=round(shown[capture.run]),
            taken=round(shown[capture.taken]),
            wanted=round(shown[capture.wanted]),
            running=state == capture.states.running,
            done=state == capture.states.done,
            aborted=state == capture.states.aborted,
        )

    async def _agreed(self, names: Sequence[str], after_each: AfterEach) -> dict[str, float]:
        """Read registers until two readings agree: no check of their own guards them, and TCP brings a flipped bit.

        Raises CorruptBlockError where they never agree, and what a read raises.
        """
        before = await self._unit.values(*names)
        after_each()
        for _ in range(_READS_A_WINDOW):
            after = await self._unit.values(*names)
            after_each()
            if after == before:
                return after
            before = after
        raise CorruptBlockError(
            say(
                "capture_shows_otherwise",
                "{tag}: {device} shows {register} otherwise at every look",
                tag=self._tag,
                device=self._unit.subject,
                register=names[0],
            )
        )

    async def windows(self, samples: int, after_each: AfterEach = lambda: None) -> AsyncIterator[Window]:
        """Fetch the first ``samples`` samples, window by window. Raises WireError where one cannot be had.

        ``after_each`` is called after each transaction but the one that brought a window; what it raises ends this.
        """
        names = [name for pair in self._capture.ranges for name in pair]
        shown = await self._agreed(names, after_each)
        ranges = [(shown[low], shown[high]) for low, high in self._capture.ranges]
        for first in range(0, samples, self._capture.window_samples):
            raw = await self._window_words(first, after_each)
            count = min(self._capture.window_samples, samples - first)
            rows = np.array(raw[2:-1], dtype=np.float64).reshape(-1, len(ranges))[:count]
            rows[rows == self._capture.missing] = np.nan
            channels = [
                low + (high - low) / self._capture.full_scale * rows[:, i] for i, (low, high) in enumerate(ranges)
            ]
            yield Window(first, *channels)

    async def _window_words(self, first: int, after_each: AfterEach) -> tuple[int, ...]:
        """One whole window; read again, a few times, where it came wrong."""
        for attempt in range(1, _READS_A_WINDOW + 1):
            try:
                words = (await self._ask_window(first, after_each)).words
                if words_crc16(words[:-1]) == words[-1] and (words[0] << 16 | words[1]) == first:
                    return words
                raise CorruptBlockError(
                    say(
                        "capture_window_damaged",
                        "{tag}: the window of sample {sample} came with a wrong check or index",
                        tag=self._tag,
                        sample=first,
                    )
                )
            except WireError:
                if attempt == _READS_A_WINDOW:
                    raise
                after_each()
        raise AssertionError("unreachable")

    async def _ask_window(self, first: int, after_each: AfterEach) -> Exchange:
        capture, unit = self._capture, self._unit
        pointer = unit.map.register(capture.window_index)
        count = 2 + capture.window_samples * len(capture.ranges) + 1
        if self._has_read_write:
            try:
                return await unit.bus.read_write(
                    unit.device_id, pointer.address, pointer.encode(first), capture.window_address, count
                )
            except IllegalFunctionError:
                self._has_read_write = False
                after_each()
        await unit.bus.write(unit.device_id, pointer.address, pointer.encode(first))
        after_each()
        return await unit.bus.read_words(unit.device_id, pointer.table, capture.window_address, count)
