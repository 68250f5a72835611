"""Which rows the stem moves in, told by a velocity whose window is as long as the noise asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.motion.windowed_slope import windowed_slope, windowed_slope_noise
from estimators.samples import FloatArray, Samples

SenseArray = npt.NDArray[np.int8]

# Own choices, tried on the four published valves at 0-100 um and 1-50 ms.
_COARSE_WINDOWS: Final = 200  # parts of the recording whose mean positions give the path travelled
_NOISE_OF_PATH_SPEED: Final = 0.08  # the windowed velocity's noise as a share of the mean speed
_SLOWER: Final = 0.2  # quantile of the coarse windows' speeds
_MUCH_SLOWER: Final = 0.4  # than the mean speed; a sine's quantile is 0.48 of it
_MOVING_SIGMAS: Final = 5.0
_MOVING_SHARE: Final = 0.1  # of the median moving speed
_SLOW_RAMP_SHARE: Final = 0.5  # of the slowest ramp's speed, where ramps differ
_SLOW_SHARE: Final = 0.2  # of the limit of motion: what drifts faster is not at rest


@dataclass(frozen=True, slots=True, eq=False)
class MovingRows:
    """``sense`` (n,): +1, -1 or 0 at rest; the windowed ``velocity`` (n,), m/s; the usual speed of the motion."""

    sense: SenseArray
    velocity: FloatArray
    half_window: int
    usual_speed: float


def find_moving_rows(samples: Samples) -> MovingRows | None:
    """Return the rows in motion; None where there is none beyond the noise."""
    speed = _path_speed(samples)
    if speed is None:
        return None
    half_window = _half_window(samples, speed)
    velocity = windowed_slope(samples, samples.position_m, half_window)
    noise = windowed_slope_noise(samples.position_noise_m, half_window, samples.period_s)
    pace = np.abs(velocity)
    lively = pace[pace > max(_MOVING_SIGMAS * noise, 0.2 * speed)]
    if lively.size < 3:
        return None
    usual_speed = float(np.median(lively))
    limit = max(_MOVING_SIGMAS * noise, min(_MOVING_SHARE * usual_speed, _SLOW_RAMP_SHARE * speed))
    sense = np.where(pace > limit, np.sign(velocity), 0.0).astype(np.int8)
    sense = _without_slow_motion(samples, sense, pace, limit, half_window)
    return MovingRows(sense, velocity, half_window, usual_speed)


def pieces_of(samples: Samples, sense: SenseArray) -> list[tuple[int, int, int]]:
    """First row, last row and sense of each stretch of rows without a change of ``sense``, shape (n,), or a gap."""
    edges = np.flatnonzero((sense[1:] != sense[:-1]) | (samples.run_first[1:] != samples.run_first[:-1])) + 1
    bounds = np.concatenate([[0], edges, [sense.size]])
    return [(first, end - 1, int(sense[first])) for first, end in pairwise(bounds.tolist())]


def _path_speed(samples: Samples) -> float | None:
    """Mean speed along the path, m/s, from mean positions of coarse windows; None where it is all noise."""
    width = max(1, samples.count // _COARSE_WINDOWS)
    windows = samples.count // width
    means = samples.position_m[: windows * width].reshape(windows, width).mean(axis=1)
    noise = samples.position_noise_m / math.sqrt(width)
    if float(np.ptp(means)) <= 8.0 * noise + 1.0e-9 * float(np.abs(means).max()):
        return None
    steps = np.abs(np.diff(means))
    path_m = float(steps[steps > 4.0 * noise].sum())
    duration_s = float(samples.time_s[-1] - samples.time_s[0])
    if not path_m > 0.0:
        return None
    # where ramps differ much the slower ones count too
    mean = path_m / duration_s
    slower = float(np.quantile(steps[steps > 4.0 * noise], _SLOWER)) / (duration_s / windows)
    return slower if slower < _MUCH_SLOWER * mean else mean


def _half_window(samples: Samples, speed: float) -> int:
    """Rows on each side that bring the windowed velocity's noise to a small share of the mean speed."""
    wanted = samples.position_noise_m * math.sqrt(2.0) / (_NOISE_OF_PATH_SPEED * speed * samples.period_s)
    most = max(1, samples.count // 100)
    return int(min(most, max(1.0, math.ceil(min(wanted, 1.0e9) ** (2.0 / 3.0)))))


def _without_slow_motion(
    samples: Samples, sense: SenseArray, pace: FloatArray, limit: float, half_window: int
) -> SenseArray:
    """The sense, with rests filled in that are none: between motions of one direction, the stem goes on slowly."""
    pieces = pieces_of(samples, sense)
    filled = sense.copy()
    for before, rest, after in zip(pieces, pieces[1:], pieces[2:], strict=False):
        if rest[2] != 0 or before[2] != after[2]:
            continue
        first, last = rest[0], rest[1]
        if not samples.run_first[before[1]] == samples.run_first[first] == samples.run_first[after[0]]:
            continue
        half = (last - first + 1) // 2
        if last - first < 2 * half_window or float(pace[first : last + 1].min()) > limit / 3.0:
            filled[first : last + 1] = before[2]
            continue
        early = float(np.median(samples.position_m[first : first + half]))
        late = float(np.median(samples.position_m[last + 1 - half : last + 1]))
        way_m = before[2] * (late - early)
        run_s = float(samples.time_s[last] - samples.time_s[first]) / 2.0
        noise_m = 1.25 * math.sqrt(2.0 / half) * samples.position_noise_m
        if way_m > 3.0 * noise_m and way_m > _SLOW_SHARE * limit * run_s:
            filled[first : last + 1] = before[2]
    return filled
