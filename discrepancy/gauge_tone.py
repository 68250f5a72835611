"""A periodic force that only undoes a tone of the measured pressure: the gauge has it, and the stem never felt it."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from discrepancy.causes.forces import VIBRATION
from discrepancy.least_squares import Fit
from discrepancy.observed import Segment

_POINTS: Final = 16  # of a period
_PERIODS: Final = 4  # of a window: more than its line and its wave have unknowns, and short beside a ramp
_FEWEST_WINDOWS: Final = 3
# The whole tone undone leaves nothing; another force of the same frequency may come at any phase and be of any size.
_LEFT: Final = 0.5  # of the periodic force, beside the tone


def gauge_tone(fit: Fit) -> str:
    """Return how the pressure swings where the stem does not, with what to do; "" where no periodic force says so.

    With A sin(w t + phi) as A exp(i phi), a tone T of the force that drives the simulated stem and a periodic force V
    in its model, V = -T means that the stem rests while the gauge swings.
    """
    if VIBRATION.name not in fit.model.causes or fit.model.observed.command_only:
        return ""
    force_n, frequency_hz, phase_rad = (
        fit.values[VIBRATION.own(name)] for name in ("force_n", "frequency_hz", "phase_rad")
    )
    found = [tone for one in fit.model.observed.segments for tone in _tones(one, frequency_hz)]
    if len(found) < _FEWEST_WINDOWS:
        return ""
    # the median: a window with a corner in it has the corner's wave
    tone_n = complex(float(np.median(np.real(found))), float(np.median(np.imag(found))))
    periodic_n = force_n * complex(math.cos(phase_rad), math.sin(phase_rad))
    if abs(periodic_n + tone_n) > _LEFT * abs(periodic_n):
        return ""
    area_m2 = fit.model.observed.nameplate.actuator.diaphragm_area_m2
    swing = f"{abs(tone_n):.3g} N" if area_m2 is None else f"{abs(tone_n) / area_m2:.0f} Pa"
    return (
        f"The pressure swings by {swing} to either side at {frequency_hz:.2f} Hz, and the stem moves as if it did not: "
        "the gauge or its line has that, and not the diaphragm. No cause is named. Look at the gauge's cable, its "
        "screen and its line, and repeat the test."
    )


def _tones(segment: Segment, frequency_hz: float) -> list[complex]:
    """Return the wave at this frequency in each window of the force, N, beside a straight line."""
    since_s = segment.elapsed_s - float(segment.time_s[0])  # the wave's clock begins with the recording
    step_s = 1.0 / (_POINTS * frequency_hz)
    first = math.ceil((float(segment.time_s[0]) + since_s) / step_s)
    last = math.floor((float(segment.time_s[-1]) + since_s) / step_s)
    clock_s = step_s * np.arange(first, last + 1, dtype=np.float64)
    force_n = np.interp(clock_s - since_s, segment.corner_s, segment.corner_n)
    size = _POINTS * _PERIODS
    turn = 2.0 * math.pi * frequency_hz * clock_s[:size]
    columns = np.column_stack([np.ones(turn.size), turn - turn.mean(), np.sin(turn), np.cos(turn)])
    # windows of whole periods all have the phase of the first
    solved = [
        np.linalg.lstsq(columns, force_n[begin : begin + size], rcond=None)[0]
        for begin in range(0, force_n.size - size + 1, size)
    ]
    return [complex(float(one[2]), float(one[3])) for one in solved]
