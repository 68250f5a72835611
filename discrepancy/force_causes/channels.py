"""Causes in the position reading and from outside, as columns of the balance of forces."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from discrepancy.force_causes.base import ForceCause, Found, Shape, Values, fitted_value
from discrepancy.force_causes.fitted import Fitted, with_interval
from discrepancy.force_record import ForceRecord
from estimators.samples import FloatArray
from valve.messages import Message, say

_SLOWEST_HZ: Final = 1.5  # slower than that it is the motion itself
_FREQUENCIES: Final = 6
_PERIODS: Final = 1.0  # of sampling: a delay between the channels that every record may have


def _lag_shapes(record: ForceRecord, _left: FloatArray) -> Iterator[Shape]:
    yield {"period_s": record.samples.period_s}


def _no_column(record: ForceRecord, _shape: Shape) -> FloatArray:
    """The jerk's own column, which is in every fit, with its bound taken off (discrepancy.force_fit)."""
    return np.empty((record.samples.count, 0))


def _read_lag(values: Values, _found: Found, shape: Shape) -> dict[str, Fitted] | None:
    (jerk, error), mass = values["jerk"], values["m"][0]
    if not (mass > 0.0 and jerk - 4.0 * error > _PERIODS * shape["period_s"] * mass):
        return None
    return {"lag_s": fitted_value(jerk / mass, error / mass, "s")}


def _say_lag(parameters: Mapping[str, Fitted], _values: Values) -> Message:
    return say(
        "position_reading_lags", "The position reading lags by {lag}.", lag=with_interval(parameters["lag_s"], "ms")
    )


LAG: Final = ForceCause(
    "position_lag",
    _lag_shapes,
    _no_column,
    _read_lag,
    _say_lag,
    say("take_filter_out", "Take the filter out of the position transmitter, or tell its time constant."),
)


def _vibration_shapes(record: ForceRecord, left: FloatArray) -> Iterator[Shape]:
    for frequency_hz in _strongest_frequencies(record.time_s, left, _FREQUENCIES):
        if frequency_hz >= _SLOWEST_HZ:
            yield {"frequency_hz": frequency_hz}


def _vibration_columns(record: ForceRecord, shape: Shape) -> FloatArray:
    turn = 2.0 * np.pi * shape["frequency_hz"] * record.time_s
    return np.column_stack([np.sin(turn), np.cos(turn)])


def _read_vibration(_values: Values, found: Found, shape: Shape) -> dict[str, Fitted] | None:
    # the force that shakes stands on the other side of the balance
    (sine, error), (cosine, _) = found
    hertz, phase = shape["frequency_hz"], float(np.arctan2(-cosine, -sine))
    return {
        "force_n": fitted_value(float(np.hypot(sine, cosine)), error, "N"),
        "frequency_hz": Fitted(hertz, hertz, hertz, "Hz"),
        "phase_rad": Fitted(phase, phase, phase, "rad"),
    }


def _say_vibration(parameters: Mapping[str, Fitted], _values: Values) -> Message:
    return say(
        "periodic_force",
        "A periodic force of {force} shakes the drive at {frequency:.2f} Hz.",
        force=with_interval(parameters["force_n"], "N"),
        frequency=parameters["frequency_hz"].value,
    )


def _strongest_frequencies(time_s: FloatArray, residual: FloatArray, most: int) -> list[float]:
    """Return the frequencies, Hz, at which residuals, shape (n,), hold most power, between 0.3 and 60 Hz."""
    period_s = float(np.median(np.diff(time_s)))
    even_s = np.arange(time_s[0], time_s[-1], max(period_s, 5.0e-3))
    signal = np.interp(even_s, time_s, residual)
    window = np.hanning(signal.size)
    power = np.abs(np.fft.rfft((signal - signal.mean()) * window)) ** 2
    frequency_hz = np.fft.rfftfreq(signal.size, float(even_s[1] - even_s[0]))
    # what drifts fills the low frequencies: each line is judged against its neighbours
    wide = max(5, signal.size // 200)
    floor = np.convolve(power, np.ones(wide) / wide, mode="same")
    contrast = np.where((frequency_hz > 0.3) & (frequency_hz < 60.0), power / (floor + 1.0e-300), 0.0)
    found: list[float] = []
    for place in np.argsort(contrast)[::-1]:
        at_hz = float(frequency_hz[place])
        if all(abs(at_hz - other) > 3.0 * frequency_hz[1] for other in found):
            found.append(at_hz)
        if len(found) == most or contrast[place] == 0.0:
            break
    return found


VIBRATION: Final = ForceCause(
    "vibration",
    _vibration_shapes,
    _vibration_columns,
    _read_vibration,
    _say_vibration,
    say("look_what_shakes", "Look for what shakes at this frequency: a pump, flow past the plug, a loose bracket."),
)

CHANNELS: Final = (LAG, VIBRATION)
