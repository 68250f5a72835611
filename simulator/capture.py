"""The capture buffer of a device: samples taken by its own clock, kept as 16-bit words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from drivers.crc import words_crc16
from drivers.maps.reference import MISSING_SAMPLE, WINDOW_CHANNELS, WINDOW_SAMPLES, CaptureState
from simulator.plant import SAMPLES_A_CAPTURE
from simulator.samples import Samples
from simulator.simulated_valve import SimulatedValve

FloatArray = npt.NDArray[np.float64]
WordArray = npt.NDArray[np.uint16]

TOP_WORD: Final = MISSING_SAMPLE - 1
SAMPLE_CAPACITY: Final = 400_000  # 400 s at 1 ms
SHORTEST_PERIOD_S: Final = 1.0e-4


@dataclass(frozen=True, slots=True)
class CaptureRanges:
    """What words 0 and 65534 stand for, a pair a channel, in the order of WINDOW_CHANNELS."""

    position_m: tuple[float, float]
    pressure_pa: tuple[float, float]
    command_pa: tuple[float, float]


def capture_ranges(valve: SimulatedValve) -> CaptureRanges:
    """Return the ranges of the valve's sensors and of its transducer."""
    range_pa = valve.transducer.range_pa
    return CaptureRanges(valve.position.span, range_pa if valve.pressure is None else valve.pressure.span, range_pa)


def _captured_words(value: FloatArray, span: tuple[float, float]) -> WordArray:
    """Words 0 to 65534 over ``span``, 0xFFFF for NaN; shape as given."""
    share = (value - span[0]) / (span[1] - span[0])
    word = np.clip(np.rint(share * TOP_WORD), 0.0, TOP_WORD)
    return np.where(np.isfinite(value), word, MISSING_SAMPLE).astype(np.uint16)


class Capture:
    """One capture: started at ``start_s``, ``wanted`` samples ``period_s`` apart, a waveform of ``duration_s``.

    It is done when the last sample was taken and the waveform has ended, whichever is later.
    """

    def __init__(self, number: int, start_s: float, period_s: float, wanted: int, duration_s: float) -> None:
        self.state = CaptureState.RUNNING
        self.taken = 0
        self.wanted = wanted
        self._start_s, self._period_s = start_s, period_s
        self.end_s = max(start_s + (wanted - 1) * period_s, start_s + duration_s)
        self._first_number = number * SAMPLES_A_CAPTURE
        self._words = np.full((wanted, len(WINDOW_CHANNELS)), MISSING_SAMPLE, dtype=np.uint16)

    def due_s(self, to_s: float) -> FloatArray:
        """Times of the samples that are not taken yet and fall at ``to_s`` or before."""
        last = min(self.wanted, math.floor((to_s - self._start_s) / self._period_s + 1.0e-6) + 1)
        times_s = self._start_s + np.arange(self.taken, max(last, self.taken)) * self._period_s
        return np.asarray(times_s[times_s <= to_s], dtype=np.float64)

    def store(self, samples: Samples, valve: SimulatedValve, ranges: CaptureRanges) -> None:
        """Keep the samples of the times that ``due_s`` gave, as the valve's sensors read them."""
        until = self.taken + samples.position_m.size
        rows, number = self._words[self.taken : until], self._first_number + self.taken
        readings_m = valve.position.readings(samples.sensed_m, number, samples.sensed_at_s)
        rows[:, 0] = _captured_words(readings_m, ranges.position_m)
        if valve.pressure is not None:
            readings_pa = valve.pressure.readings(samples.gauge_pa, number, samples.gauge_at_s)
            rows[:, 1] = _captured_words(readings_pa, ranges.pressure_pa)
        rows[:, 2] = _captured_words(samples.asked_pa, ranges.command_pa)
        self.taken = until

    def window(self, index: int) -> list[int]:
        """Samples from ``index`` on, without index and CRC; 0xFFFF where none was taken."""
        return window_words(self._words[: self.taken], index)


def window_words(samples: WordArray, index: int) -> list[int]:
    """WINDOW_SAMPLES rows of ``samples``, shape (n, 3), from ``index`` on, in one list; 0xFFFF beyond the end."""
    rows = samples[index : index + WINDOW_SAMPLES].reshape(-1).tolist()
    return [*rows, *([MISSING_SAMPLE] * (WINDOW_SAMPLES * len(WINDOW_CHANNELS) - len(rows)))]


def framed_window(index: int, samples: list[int]) -> list[int]:
    """Return the window as it is read: the index's two words, the samples, the CRC of all before."""
    words = [index >> 16, index & 0xFFFF, *samples]
    return [*words, words_crc16(words)]
