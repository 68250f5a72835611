"""How late one channel follows another, the pressure the command or the stem its signal: dead time and lag, s."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.signal import lfilter

from estimators.in_service.figure import LEAST_REPEATS, Figure, mean_of_repeats, not_known
from valve.messages import say
from valve.recording import FloatArray

_PARTS: Final = 12  # of the record, each with its own lag: their scatter gives the interval
_MOST_ROWS: Final = 3000  # of a part
_FEWEST_ROWS: Final = 100
_LAGS: Final = 28
_EXPLAINED: Final = 0.5  # of the pressure's variance: below it the command is not what drives the pressure
_LONGEST_S: Final = 20.0


def lag_of(time_s: FloatArray, command: FloatArray, pressure: FloatArray, *, names: tuple[str, str]) -> Figure:
    """Return the mean delay from command to pressure, shape (n,), any units, NaN for a gap; ``names``: what they are.

    Each part of the record is fitted by gain, offset and a first-order lag with a dead time; the delay is their sum.
    """
    known = np.isfinite(command) & np.isfinite(pressure)
    time_s, command, pressure = time_s[known], command[known], pressure[known]
    if time_s.size < 4 * _FEWEST_ROWS:
        few = say(
            "few_rows_with_both",
            "{count} rows have a {first} and a {second}, {needed} are needed",
            count=int(time_s.size),
            first=names[0],
            second=names[1],
            needed=4 * _FEWEST_ROWS,
        )
        return not_known("s", few)
    period_s = float(np.median(np.diff(time_s)))
    size = max(_FEWEST_ROWS, min(_MOST_ROWS, time_s.size // _PARTS))
    firsts = np.unique(np.linspace(0, time_s.size - size, min(_PARTS, time_s.size // size)).astype(np.int64))
    found, apart = [], []
    for first in firsts.tolist():
        part = slice(first, first + size)
        if np.ptp(time_s[part]) > 2.0 * size * period_s:
            continue
        even_s = np.arange(time_s[part][0], time_s[part][-1], period_s)
        delay = _delay(
            np.interp(even_s, time_s[part], command[part]), np.interp(even_s, time_s[part], pressure[part]), period_s
        )
        if delay is not None:
            found.append(delay)
            apart.append(0.25 * period_s)
    few = say(
        "few_parts_follow",
        "the {second} follows the {first} in {count} parts of the record, {needed} are needed: a longer record with "
        "more motion, or evenly spaced rows",
        second=names[1],
        first=names[0],
        count=len(found),
        needed=LEAST_REPEATS,
    )
    known_lags = np.array(found)
    if known_lags.size >= LEAST_REPEATS and float(np.median(known_lags)) < 0.5 * period_s:
        below = say("below_half_row", "below half of a row, {time:.2g} s: faster rows would tell", time=0.5 * period_s)
        return not_known("s", below)
    differ = say("parts_differ", "the parts of the record differ too much: faster rows would tell")
    return mean_of_repeats(known_lags, np.array(apart), "s", few, differ)


def _delay(command: FloatArray, pressure: FloatArray, period_s: float) -> float | None:
    """Delay that leaves least of the pressure, s; None where the command explains too little of it."""
    if np.ptp(command) == 0.0 or np.ptp(pressure) == 0.0:
        return None
    lags_s = np.concatenate([[0.0], np.geomspace(0.1 * period_s, _LONGEST_S, _LAGS)])
    least, best = np.inf, 0.0
    for dead in range(1 + min(4, int(_LONGEST_S / period_s))):
        shifted = np.concatenate([np.full(dead, command[0]), command[: command.size - dead]])
        for lag_s in lags_s.tolist():
            left = _unexplained(_lagged(shifted, lag_s, period_s), pressure)
            if left < least:
                least, best = left, dead * period_s + lag_s
    return best if least <= 1.0 - _EXPLAINED else None


def _lagged(values: FloatArray, lag_s: float, period_s: float) -> FloatArray:
    if lag_s == 0.0:
        return values
    keep = float(np.exp(-period_s / lag_s))
    return np.asarray(values[0] + lfilter([0.0, 1.0 - keep], [1.0, -keep], values - values[0]))


def _unexplained(driver: FloatArray, answer: FloatArray) -> float:
    """Share of the answer's variance that a straight line of the driver leaves."""
    driver, answer = driver - driver.mean(), answer - answer.mean()
    power = float(driver @ driver)
    if power == 0.0:
        return 1.0
    return 1.0 - float(driver @ answer) ** 2 / power / float(answer @ answer)
