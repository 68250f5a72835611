"""Samples that no stem and no actuator can have made: single spikes, and stretches where the sensor stood still.

A spike goes out and comes back within two samples, many times the noise; a stem cannot, as its friction would have to
turn round twice. A sensor that is frozen, or at the end of its range, repeats one value to the last digit while the
noise elsewhere is several digits wide. Such samples are left out as gaps, never filled in, and are told.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from estimators.data_faults.fault import SHOWN, BoolArray, DataFault, off_line, runs
from estimators.samples import FloatArray, position_noise, resolution
from valve.messages import say
from valve.recording import Recording

# Own choices; tests/estimators/data_faults/test_odd_samples.py has what must not be taken for one.
_SPIKE_NOISES: Final = 12.0
_SPIKE_OF_SPAN: Final = 1.0e-3
_SPIKE_WINDOW: Final = 7
_BESIDE: Final = 3  # good samples on each side that a spike is judged by
_QUIET_BESIDE: Final = 1.0 / 6.0  # of the spike's height
_MOST_SPIKES: Final = 0.01  # of all samples: more is no spike but the signal
_LONGEST_PULSE_PERIOD_S: Final = 0.02  # polled slower, a pulse of pressure may be a true one
_STILL_SAMPLES: Final = 20
_STILL_S: Final = 0.2
_MOST_STILLS: Final = 5  # more, away from the ends, is how this sensor reports and no fault
_WENT_ON: Final = 0.15  # of what the stem goes in all
_MOST_LEFT_OUT: Final = 0.6
# Of 2nd differences, in digits: white noise of 1.65 d / (2 sqrt(pi) p) repeats a value with the probability p a row. It
# must not do so in a whole stretch with more than 1e-16.
_DIGITS: Final = 0.465
_CHANCE: Final = 16.0
_LEAST_DIGITS: Final = 1.5
_LEAST_NOISE_M: Final = 1.0e-7
_LEAST_NOISE_PA: Final = 1.0
_LEAST_TURNS: Final = 0.6  # 2nd differences of white noise change sign 0.73 of the time, those of a motion hardly


def without_odd_samples_of(recording: Recording, place: str) -> tuple[Recording, list[DataFault]]:
    """Return the recording with its odd samples made gaps, and what was left out; ``place`` is put behind a channel."""
    time_s, position_m = recording.time_s, np.array(recording.position_m)
    told = []
    spikes = _spikes(time_s, position_m, 2)
    if spikes.any():
        told.append(_told_spikes("position_m", place, position_m, time_s, spikes))
        position_m[spikes] = np.nan
    for rows, reason in _stills(time_s, position_m, _LEAST_NOISE_M):
        told.append(_told_still("position_m", place, position_m, time_s, (rows, reason)))
        position_m[rows] = np.nan
    pressure_pa = None if recording.pressure_pa is None else np.array(recording.pressure_pa)
    if pressure_pa is not None:
        told += _clean_pressure(time_s, pressure_pa, position_m, place)
    if not told:
        return recording, []
    return replace(recording, position_m=position_m, pressure_pa=pressure_pa), told


def _clean_pressure(time_s: FloatArray, pressure_pa: FloatArray, position_m: FloatArray, place: str) -> list[DataFault]:
    """Make odd values of the pressure NaN in place.

    Its ends stay, where a gauge or a supply may truly stand, unless the stem goes on meanwhile.
    """
    told = []
    if time_s.size > 1 and float(np.median(np.diff(time_s))) < _LONGEST_PULSE_PERIOD_S:
        spikes = _spikes(time_s, pressure_pa, 1)
        if spikes.any():
            told.append(_told_spikes("pressure_pa", place, pressure_pa, time_s, spikes))
            pressure_pa[spikes] = np.nan
    for rows, reason in _stills(time_s, pressure_pa, _LEAST_NOISE_PA):
        if reason == "frozen" or _went_on(position_m, rows):
            told.append(_told_still("pressure_pa", place, pressure_pa, time_s, (rows, reason)))
            pressure_pa[rows] = np.nan
    return told


def _went_on(position_m: FloatArray, rows: BoolArray) -> bool:
    """Whether the stem goes far while the pressure stands at its end."""
    known = np.isfinite(position_m)
    if not (known & rows).any():
        return False
    went_m = max(float(np.ptp(part)) if (part := position_m[first:last][known[first:last]]).size else 0.0
                 for first, last in runs(rows))  # fmt: skip
    return went_m > _WENT_ON * float(np.ptp(position_m[known]))


def _spikes(time_s: FloatArray, values: FloatArray, longest: int) -> BoolArray:
    """Return which values go out and come back within ``longest`` samples, shape as ``values``."""
    odd = np.zeros(values.shape, dtype=np.bool_)
    rows = np.flatnonzero(np.isfinite(values))
    if rows.size < 100:
        return odd
    own = values[rows]
    half = _SPIKE_WINDOW // 2
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(own, half, mode="edge"), _SPIKE_WINDOW)
    off = own - np.median(windows, axis=1)
    low, high = np.percentile(own, (0.5, 99.5))
    noise = position_noise(time_s[rows], own, np.zeros(own.size, dtype=np.intp))
    candidates = np.abs(off) > max(_SPIKE_NOISES * noise, _SPIKE_OF_SPAN * float(high - low))
    if not candidates.any() or np.count_nonzero(candidates) > _MOST_SPIKES * own.size:
        return odd
    good = np.flatnonzero(~candidates)
    for first, last in runs(candidates):
        place = int(np.searchsorted(good, first))
        beside = own[good[max(place - _BESIDE, 0) : place + _BESIDE]]
        on_both_sides = place >= _BESIDE and place + _BESIDE <= good.size
        height = float(np.abs(off[first:last]).min())
        if on_both_sides and last - first <= longest and float(np.ptp(beside)) < _QUIET_BESIDE * height:
            odd[rows[first:last]] = True
    return odd


def _stills(time_s: FloatArray, values: FloatArray, least_noise: float) -> list[tuple[BoolArray, str]]:
    """Return the rows of each frozen stretch, and of each end at which the values are clipped."""
    rows = np.flatnonzero(np.isfinite(values))
    if rows.size < 10 * _STILL_SAMPLES:
        return []
    own = values[rows]
    repeats = [
        (first, last + 1)
        for first, last in runs(np.diff(own) == 0.0)
        if last - first >= _STILL_SAMPLES and time_s[rows[last]] - time_s[rows[first]] >= _STILL_S
    ]
    still = np.zeros(own.size, dtype=np.bool_)
    for first, last in repeats:
        still[first:last] = True
    if not repeats or np.count_nonzero(still) > _MOST_LEFT_OUT * own.size:
        return []
    digits = _noise_in_digits(time_s[rows], own, still, least_noise)
    repeats = [one for one in repeats if digits > max(_LEAST_DIGITS, _DIGITS * 10.0 ** (_CHANCE / (one[1] - one[0])))]
    ends: dict[float, BoolArray] = {}
    frozen: list[tuple[BoolArray, str]] = []
    for first, last in repeats:
        taken = np.zeros(values.shape, dtype=np.bool_)
        taken[rows[first:last]] = True
        if own[first] in (own.min(), own.max()):
            ends[float(own[first])] = values == own[first]
        else:
            frozen.append((taken, "frozen"))
    kept = frozen if len(frozen) <= _MOST_STILLS else []
    return [*kept, *((taken, "clipped") for taken in ends.values())]


def _noise_in_digits(time_s: FloatArray, values: FloatArray, still: BoolArray, least: float) -> float:
    """Median of the 2nd differences of values that are not still, in digits; 0 where they are no white noise."""
    bends = 2.0 * off_line(time_s, values)[~(still[:-2] | still[1:-1] | still[2:])]
    steps = np.abs(np.diff(values))
    steps = steps[steps > 0.0]
    if bends.size < 10 * _STILL_SAMPLES or steps.size == 0:
        return 0.0
    # The smallest step but for rounding: a converter's digit divides all of them.
    digit = float(np.percentile(steps, 1.0)) if steps.min() < 1.0e-3 * np.median(steps) else float(steps.min())
    if least == _LEAST_NOISE_PA:  # on a ramp every step of a pressure is many digits
        digit = min(digit, max(resolution(values), 1.0e-12 * float(np.abs(values).max())))
    usual = float(np.median(np.abs(bends)))
    turns = float(np.mean(np.sign(bends[1:]) != np.sign(bends[:-1])))
    return usual / digit if usual > least and turns > _LEAST_TURNS else 0.0


def _told_spikes(channel: str, place: str, values: FloatArray, time_s: FloatArray, spikes: BoolArray) -> DataFault:
    called, unit = SHOWN[channel]
    count, first = int(np.count_nonzero(spikes)), int(np.argmax(spikes))
    worst = float(np.abs(values[spikes] - np.interp(time_s[spikes], time_s[~spikes], values[~spikes])).max())
    sentence = say(
        "single_spikes",
        "The {channel}{place} has single spikes of up to {worst:.3g {unit}}, the first at {first:.6g} s: {many} left "
        "out. Look at the sensor's cable, its screen and its plug.",
        channel=called,
        place=place,
        worst=worst,
        unit=unit,
        first=float(time_s[first]),
        many=say("samples", "{count} samples", count=count) if count > 1 else say("one_sample", "1 sample"),
    )
    return DataFault(channel, "spike", count, sentence)


def _told_still(
    channel: str, place: str, values: FloatArray, time_s: FloatArray, still: tuple[BoolArray, str]
) -> DataFault:
    rows, reason = still
    called, unit = SHOWN[channel]
    count, first = int(np.count_nonzero(rows)), int(np.argmax(rows))
    last = rows.size - 1 - int(np.argmax(rows[::-1]))
    value = float(values[first])
    if reason == "clipped":
        said = say(
            "sensor_clipped",
            "The {channel}{place} reads its {end} value, {value:.4g {unit}}, again and again to the last digit, and is "
            "noisy elsewhere: the sensor is at the end of its range. {count} samples left out; what the stem does "
            "there is not seen. Correct the sensor's range or its zero.",
            channel=called,
            place=place,
            end=say("highest", "highest") if value >= np.nanmax(values) else say("lowest", "lowest"),
            value=value,
            unit=unit,
            count=count,
        )
    else:
        said = say(
            "channel_frozen",
            "The {channel}{place} stands at {value:.4g {unit}} to the last digit from {first:.6g} to {last:.6g} s, and "
            "is noisy elsewhere: the sensor or its link was frozen. {count} samples left out. Look at the sensor, its "
            "supply and the gateway.",
            channel=called,
            place=place,
            value=value,
            unit=unit,
            first=float(time_s[first]),
            last=float(time_s[last]),
            count=count,
        )
    return DataFault(channel, reason, count, said)
