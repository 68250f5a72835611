"""Values that a slower device holds, and rows that a historian writes only where a value changed.

A device that refreshes at 20 Hz and is read at 100 Hz gives each value five times. Whatever the value does, it then
changes at the ticks of the device's clock and never between, which no stem does and no converter's step.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from estimators.data_faults.fault import SHOWN, DataFault
from estimators.samples import FloatArray, resolution
from valve.messages import say
from valve.nameplate import Nameplate
from valve.recording import Recording

_CHANNELS: Final = ("position_m", "pressure_pa", "force_n")
# Own choices; tests/estimators/data_faults/test_held_values.py has what must not be taken for one.
_LEAST_CHANGES: Final = 40
_DIGITS: Final = 1.5  # a change by more is no step of a converter that a slow value crosses
_MOST_ROWS: Final = 500.0  # that one value is held
_LEAST_ALONE: Final = 0.9  # of the changes of several digits: the value stands before and after
_LEAST_COHERENCE: Final = 0.75  # of the changes with one clock, 1 where all come with its ticks
_UNEVEN: Final = 0.2  # of the mean period, standard deviation
_SMOOTH: Final = 10  # rows to each side, for the speed of a channel
_ERRORS: Final = 8.0  # by so many standard errors do the periods differ where the stem moves
_DENSER: Final = 1.2
_NORMAL_95: Final = 1.96


def without_held_values(recording: Recording, place: str) -> tuple[Recording, list[DataFault]]:
    """Return the recording without the rows that repeat what the slowest channel held, and its device's rate."""
    found = {
        name: ticks
        for name in _CHANNELS
        if (channel := getattr(recording, name)) is not None
        and (ticks := _ticks(recording.time_s, channel)) is not None
    }
    if not found:
        return recording, []
    slowest = max(found, key=lambda name: found[name][1])
    rows, period_s = found[slowest]
    keep = np.zeros(recording.samples, dtype=np.bool_)
    keep[rows] = True
    names = tuple(SHOWN[name][0] for name in found)
    left_out = recording.samples - int(np.count_nonzero(keep))
    sentence = say(
        "held_by_slower_device",
        "The {held} held by a slower device: a new value comes every {period:.4g ms} ({rate:.4g} Hz), a row every "
        "{row:.4g ms}. {count} rows that repeat the last value are left out. Each value may be older than its row says "
        "by up to one refresh: read the device faster, or record in it.",
        held=say("channel_is", "{channel}{place} is", channel=names[0], place=place)
        if len(names) == 1
        else say("channels_are", "{channels: and }{place} are", channels=names, place=place),
        period=period_s,
        rate=1.0 / period_s,
        row=float(recording.sample_period_s),
        count=left_out,
    )
    fault = DataFault(
        slowest, "held_values", left_out, sentence, {"period_s": (period_s, "s"), "rate_hz": (1.0 / period_s, "Hz")}
    )
    return recording.rows(keep), [fault]


def _ticks(time_s: FloatArray, channel: FloatArray) -> tuple[npt.NDArray[np.intp], float] | None:
    """Return the rows with a fresh value and the device's period, s; None where the channel is not held."""
    rows = np.flatnonzero(np.isfinite(channel))
    own = channel[rows]
    if own.size < 4 * _LEAST_CHANGES:
        return None
    steps = np.diff(own)
    changes = np.flatnonzero(steps != 0.0)
    if changes.size < _LEAST_CHANGES or changes.size > 0.75 * steps.size:
        return None
    sizes = np.abs(steps[changes])
    bends = np.abs(np.diff(own[changes], 2))
    bends = bends[bends > 1.0e-6 * np.median(sizes)]
    # steady steps of a ramp look like a grid of their own, their differences show the converter's
    digit = min(resolution(own), float(np.percentile(bends, 5.0)) if bends.size else np.inf)
    large = changes[sizes > _DIGITS * digit]
    if large.size < _LEAST_CHANGES:
        return None
    inner = large[(large > 0) & (large < steps.size - 1)]
    alone = (steps[inner - 1] == 0.0) & (steps[inner + 1] == 0.0)
    if np.mean(alone) < _LEAST_ALONE:
        return None
    at_s = time_s[rows[large + 1]]
    period_s = _period_s(at_s, float(np.median(np.diff(time_s))))
    if period_s is None:
        return None
    fresh = _with_unchanged(rows[changes + 1], time_s, period_s)
    return np.concatenate([rows[:1], fresh]), period_s


def _period_s(at_s: FloatArray, row_s: float) -> float | None:
    """Return the period of the clock with whose ticks the changes come; None where they come with none."""
    gaps_s = np.diff(at_s)
    first_s = float(np.median(gaps_s))
    if not 1.5 * row_s < first_s < _MOST_ROWS * row_s:
        return None
    since_s = at_s - at_s[0]
    best: tuple[float, float] = (0.0, first_s)
    # over more and more changes the period is known better and better, and the clock must keep it
    count, width = 20, 0.3
    shares = np.linspace(-1.0, 1.0, 241)
    while True:
        part_s = since_s[:count]
        periods_s = best[1] * (1.0 + width * shares)
        coherence = np.abs(np.exp(2j * np.pi * part_s[None, :] / periods_s[:, None]).mean(axis=1))
        chosen = int(np.argmax(coherence - 1.0e-6 * np.abs(shares)))
        best = (float(coherence[chosen]), float(periods_s[chosen]))
        if count >= since_s.size:
            break
        width = 0.5 * best[1] / float(part_s[-1])
        count *= 2
    # a tick that lies between two rows is seen at the second one: over n rows its phase is spread by 1 / n
    expected = float(np.sinc(row_s / best[1]))
    return best[1] if best[0] > _LEAST_COHERENCE * max(expected, 0.6) / 0.8 and best[1] > 1.5 * row_s else None


def _with_unchanged(changed: npt.NDArray[np.intp], time_s: FloatArray, period_s: float) -> npt.NDArray[np.intp]:
    """Return the rows with a fresh value, those among them where the same value came again."""
    added: list[int] = []
    for first, last in pairwise(changed):
        missed = round(float(time_s[last] - time_s[first]) / period_s) - 1
        for number in range(1, missed + 1):
            row = int(np.searchsorted(time_s, time_s[first] + number * period_s * (1.0 - 1.0e-9)))
            if first < row < last:
                added.append(row)
    return np.union1d(changed, np.array(added, dtype=np.intp))


def exception_report(recording: Recording, place: str) -> list[DataFault]:
    """Return what a historian's rows at changes are, in words; nothing where the rows come at their own times."""
    if recording.samples < 200:
        return []
    time_s = recording.time_s
    periods_s = np.diff(time_s)
    if float(np.std(periods_s)) < _UNEVEN * float(np.mean(periods_s)):
        return []
    base_s = float(periods_s.min())
    for name in _CHANNELS:
        channel = getattr(recording, name)
        if channel is None or not _comes_with_changes(time_s, channel, periods_s):
            continue
        longest_s = float(periods_s.max())
        sentence = say(
            "rows_at_changes",
            "The rows{place} come only where a value changed, as a historian's exception report gives them: every "
            "{least:.4g in ms} to {most:.4g ms}, denser where the {channel} moves. What happened between two rows is "
            "not known, and small motions are missing; the intervals are widened by the usual change from row to row. "
            "Record every sample, without exception or compression limits.",
            place=place,
            least=base_s,
            most=longest_s,
            channel=SHOWN[name][0],
        )
        figures = {"period_s": (base_s, "s"), "longest_s": (longest_s, "s")}
        for other, unit in (("pressure_pa", "Pa"), ("force_n", "N"), ("position_m", "m")):
            if getattr(recording, other) is not None:
                figures[f"limit_{unit.lower()}"] = (_limit(getattr(recording, other)), unit)
        return [DataFault("time_s", "exception_report", 0, sentence, figures)]
    return []


def _limit(channel: FloatArray) -> float:
    """Return the change of a channel for which a row is written, as half of the rows have it at most."""
    changes = np.abs(np.diff(channel[np.isfinite(channel)]))
    changes = changes[changes > 0.0]
    return float(np.median(changes)) if changes.size else 0.0


def widened(analysis: Mapping[str, Any], fault: DataFault, nameplate: Nameplate) -> dict[str, Any]:
    """Return an analysis object whose forces and spring rate are known no better than an exception report's limit.

    A row comes when the noise carries a value over the limit, so that rows stand off the mean by a part of it, as the
    stem goes. A force is off by up to the limit, evenly: limit / sqrt(12) is its standard error, and the spring rate's
    that of two such forces over the stroke.
    """
    area_m2 = nameplate.actuator.diaphragm_area_m2
    limit_n = fault.parameters.get("limit_n", (0.0, "N"))[0]
    if "limit_n" not in fault.parameters and area_m2 is not None:
        limit_n = area_m2 * fault.parameters.get("limit_pa", (0.0, "Pa"))[0]
    force_n = limit_n / np.sqrt(12.0)
    stroke = analysis["recording"].get("stroke_m") or analysis["recording"].get("position_range_m")
    went_m = float(stroke[1] - stroke[0]) if stroke else 0.0
    errors = dict.fromkeys(("F_c", "F_s", "F_0"), force_n)
    if went_m > 0.0:
        errors["k"] = float(np.sqrt(2.0)) * force_n / went_m
    estimates = [
        {
            **one,
            "parameters": {
                symbol: _wider(entry, errors[symbol]) if symbol in errors else entry
                for symbol, entry in one["parameters"].items()
            },
        }
        for one in analysis["estimates"]
    ]
    return {**analysis, "estimates": estimates}


def _wider(entry: Mapping[str, Any], error: float) -> dict[str, Any]:
    if entry["value"] is None or entry["ci95"] is None:
        return dict(entry)
    low, high = entry["ci95"]
    more = _NORMAL_95 * error
    value = entry["value"]
    return {
        **entry,
        "std_error": None if entry["std_error"] is None else float(np.hypot(entry["std_error"], error)),
        "ci95": [float(value - np.hypot(value - low, more)), float(value + np.hypot(high - value, more))],
    }


def _comes_with_changes(time_s: FloatArray, channel: FloatArray, periods_s: FloatArray) -> bool:
    """Whether rows stand closer together where the channel goes faster, by far more than by chance."""
    rows = np.flatnonzero(np.isfinite(channel))
    if rows.size < channel.size // 2:
        return False
    own, at_s = channel[rows], time_s[rows]
    speed = np.abs((own[2 * _SMOOTH :] - own[: -2 * _SMOOTH]) / (at_s[2 * _SMOOTH :] - at_s[: -2 * _SMOOTH]))
    middle = rows[_SMOOTH:-_SMOOTH]
    inside = middle < periods_s.size
    speed, spacing_s = speed[inside], periods_s[middle[inside]]
    slow, fast = np.percentile(speed, (33.0, 67.0))
    at_rest, moving = spacing_s[speed <= slow], spacing_s[speed >= fast]
    if not fast > 3.0 * slow or min(at_rest.size, moving.size) < 50:
        return False
    difference = float(at_rest.mean() - moving.mean())
    # neighbouring rows are alike: a tenth of them counts
    error = float(np.sqrt(10.0 * (at_rest.var() / at_rest.size + moving.var() / moving.size)))
    return bool(at_rest.mean() > _DENSER * moving.mean() and difference > _ERRORS * error)
