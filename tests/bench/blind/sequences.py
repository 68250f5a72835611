"""The waveforms of the blind tests, each between two levels with a short hold at the start: forces or pressures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from valve.diagnostic_waveform import diagnostic as product_diagnostic
from valve.waveform import Waveform, dwell, multi_rate_triangle, sine, triangle

Draw = Callable[[np.random.Generator, float, float], Waveform]
_LONGEST_S: Final = 150.0
HELD_OUT_PERIOD_S: Final = 8.0  # the paper's validation sine
_HOLD_S: Final = (0.1, 1.1)  # puts the corners between the samples


def held(wave: Waveform, hold_s: float) -> Waveform:
    """The waveform after a hold at its first level."""
    time_s = np.concatenate([[0.0], hold_s + wave.time_s])
    return Waveform(wave.name, time_s, np.concatenate([wave.pressure_pa[:1], wave.pressure_pa]))


def paper_triangle(rng: np.random.Generator, low: float, high: float) -> Waveform:
    """The paper's triangle, two cycles of 20 to 25 s."""
    return triangle(float(rng.uniform(20.0, 25.0)), 2, low, high)


def two_rates(rng: np.random.Generator, low: float, high: float) -> Waveform:
    """One slow cycle and fast ones."""
    return multi_rate_triangle([float(rng.uniform(20.0, 25.0)), 8.0, 5.0, 3.1, 2.3, 2.7], low, high)


def dwells(rng: np.random.Generator, low: float, high: float) -> Waveform:
    """Triangles that rest for different times at the middle of each ramp."""
    return dwell(16.0, low, high, (float(rng.uniform(0.3, 0.8)), float(rng.uniform(6.0, 10.0))))


def small_loops(rng: np.random.Generator, low: float, high: float) -> Waveform:
    """Three loops about the middle, each a third smaller than the last, and back to the low level."""
    middle, swing = (low + high) / 2.0, float(rng.uniform(0.3, 0.4)) * (high - low)
    legs = [(0.0, low), (6.0, middle)]
    for share in (1.0, 0.67, 0.45):
        legs += [(3.0, middle + share * swing), (6.0, middle - share * swing), (3.0, middle)]
    legs.append((6.0, low))
    time_s, level = np.cumsum([leg_s for leg_s, _ in legs]), [to for _, to in legs]
    return Waveform("small_loops", time_s, np.array(level))


def diagnostic(_rng: np.random.Generator, low: float, high: float) -> Waveform:
    """The product's diagnostic sequence: two rates, dwells and small loops within 150 s."""
    return product_diagnostic(low, high, rate_pa_per_s=high - low, longest_s=_LONGEST_S)


def held_out_sine(_rng: np.random.Generator, low: float, high: float) -> Waveform:
    """Two cycles of the paper's validation sine."""
    return sine(HELD_OUT_PERIOD_S, 2, low, high, corners_per_period=800)


WAVEFORMS: Final[dict[str, Draw]] = {
    "triangle": paper_triangle,
    "two_rates": two_rates,
    "dwells": dwells,
    "small_loops": small_loops,
    "diagnostic": diagnostic,
}


def from_rest(wave: Waveform, ramp_s: float = 2.0) -> Waveform:
    """The waveform after a ramp to its first level from 0: a drive without a spring would be off at once."""
    time_s = np.concatenate([[0.0], ramp_s + wave.time_s])
    return Waveform(wave.name, time_s, np.concatenate([[0.0], wave.pressure_pa]))


def drawn_waveform(name: str, rng: np.random.Generator, low: float, high: float) -> Waveform:
    """The waveform of this name, after a hold of drawn length."""
    return held(WAVEFORMS[name](rng, low, high), float(rng.uniform(*_HOLD_S)))
