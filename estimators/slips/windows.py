"""Which rows a slip is fitted to: from its rest through breakaway and steady motion until the stem rests again."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from estimators.motion.phases import After, Stretch
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.rests import Breakaway
from estimators.motion.stops import rows_off_stops
from estimators.samples import BoolArray, FloatArray, IntArray, Samples

# Own choices. A block as long as a share p of the age of the motion falsifies an exponential by 0.54 p^2 / 24 at most.
_LARGEST_SHARE_OF_AGE: Final = 0.06
_LEAST_SHARE_OF_AGE: Final = 0.008
_FALSIFIED: Final = 0.05  # of the position's noise: what blocks may do
_ROWS_ONE_BY_ONE: Final = 18
_DOUBTFUL_BLOCKS: Final = 40
_SWING_ROWS: Final = 30
_DOUBT: Final = 4.0  # times the uncertainty of the instant: how long before it a rest is no longer sure
_MOST_PAD_S: Final = 0.5
_FEWEST_REST_ROWS: Final = 2
_FEWEST_ROWS: Final = 5
_LINE_PARTS: Final = 6
_LINE_SIGMAS: Final = 5.0
_SEVERAL_RATES: Final = 1.5
_UNDITHERED: Final = 0.5  # noise in steps of the sensor's grid below which the grid's errors are not independent


@dataclass(frozen=True, slots=True, eq=False)
class SlipWindows:
    """Slips as ``slip_kernel`` takes them: ``slips`` (n, 6), ``first`` (n + 1,), and the rows, blocks of them, (r,).

    ``rest_m`` (n,) is where each rested; ``rest_rows`` (n,) how many rows say so; ``began_s`` (n,) is the origin of
    each one's times, ``began_n`` the force at breakaway as detected, ``within_n`` its error. ``rest_error_m`` is what
    all rows of a rest are wrong by together: a stem at rest sits on one step of the sensor's grid.
    """

    slips: FloatArray
    first: IntArray
    time_s: FloatArray
    position_m: FloatArray
    rows: FloatArray
    rest_m: FloatArray
    rest_rows: FloatArray
    began_s: FloatArray
    began_n: FloatArray
    within_n: FloatArray
    line_error_n: float
    rest_error_m: float
    undithered: bool  # the sensor's grid and not noise limits the position: its errors are not independent then

    @property
    def count(self) -> int:
        """Number of slips."""
        return int(self.slips.shape[0])

    @property
    def has_several_rates(self) -> bool:
        """Whether the slips are of ramps that differ by half in their rate."""
        rates = np.abs(self.slips[:, 1])
        return bool(rates.max() > _SEVERAL_RATES * rates.min())

    @property
    def slowest_rate(self) -> float:
        """Rate of the force on the slowest ramp, N/s."""
        return float(np.abs(self.slips[:, 1]).min())


@dataclass(frozen=True, slots=True)
class _Line:
    """Force = ``force_n`` + ``rate`` (t - origin), and the standard error of the force that noise leaves."""

    force_n: float
    rate: float
    error_n: float


def slip_windows(motion: RecordedMotion, spring_n_per_m: float) -> SlipWindows | None:
    """Return the slips whose force is a straight line, with what coasts after them; None where there is none."""
    made = []
    off_stops = rows_off_stops(motion.samples, motion.stops)
    stretches = motion.phases.stretches
    starts = {stretch.first: number for number, stretch in enumerate(stretches)}
    for breakaway in motion.phases.breakaways:
        number = starts.get(breakaway.row + 1)
        if number is None or not stretches[number].driven:
            continue
        one = _window(motion, breakaway, number, off_stops=off_stops, spring_n_per_m=spring_n_per_m)
        if one is not None:
            made.append(one)
    if not made:
        return None
    sizes = [one[1].size for one in made]
    told = np.array([one[4] for one in made])
    rest_error_m, undithered = grid_error(motion.samples)
    return SlipWindows(
        slips=np.array([one[0] for one in made]),
        first=np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64),
        time_s=np.concatenate([one[1] for one in made]),
        position_m=np.concatenate([one[2] for one in made]),
        rows=np.concatenate([one[3] for one in made]),
        rest_m=told[:, 0],
        rest_rows=told[:, 1],
        began_s=told[:, 2],
        began_n=told[:, 3],
        within_n=told[:, 4],
        line_error_n=float(np.median(told[:, 5])),
        rest_error_m=rest_error_m,
        undithered=undithered,
    )


def grid_error(samples: Samples) -> tuple[float, bool]:
    """Error of a mean position at rest by the sensor's grid, m, and whether noise is too small to hide the grid.

    Gaussian noise s dithers a grid of steps q: the mean's error falls from q / sqrt(12) with exp(-2 (pi s / q)^2).
    """
    step_m = samples.position_step_m
    if step_m <= 0.0:
        return 0.0, False
    noise = math.sqrt(max(0.0, (samples.position_noise_m / step_m) ** 2 - 1.0 / 12.0))
    # 0.7: on a grid the noise is not known better, and too little is the safe side
    return step_m / math.sqrt(12.0) * math.exp(-2.0 * (0.7 * math.pi * noise) ** 2), noise < _UNDITHERED


def _window(
    motion: RecordedMotion,
    breakaway: Breakaway,
    number: int,
    *,
    off_stops: BoolArray,
    spring_n_per_m: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[float, ...]] | None:
    samples, stretch = motion.samples, motion.phases.stretches[number]
    origin_s = breakaway.time_s
    pad_s = min(_DOUBT * breakaway.within_s + 2.0 * samples.period_s, _MOST_PAD_S)
    rest_first = _rest_first(motion, number, breakaway.row)
    sure = int(np.searchsorted(samples.time_s, origin_s - pad_s))
    if sure - rest_first < _FEWEST_REST_ROWS:
        sure = rest_first + min(_FEWEST_REST_ROWS, breakaway.row - rest_first)
    if sure - rest_first < _FEWEST_REST_ROWS:
        return None
    last = _last_row(motion, stretch, off_stops)
    if last - breakaway.row < _FEWEST_ROWS:
        return None
    line = _force_line(motion, max(rest_first, breakaway.row - 400), last, origin_s, spring_n_per_m)
    if line is None or line.rate * stretch.direction <= 0.0:
        return None
    corner_s, rate_after, end = math.inf, 0.0, last
    if last == stretch.last:
        coast = _coast(motion, number, line, origin_s, off_stops=off_stops, spring_n_per_m=spring_n_per_m)
        if coast is not None:
            corner_s, rate_after, end = coast
    time_s = samples.time_s[sure : end + 1] - origin_s
    swing_m = float(np.ptp(samples.position_m[breakaway.row : min(end, breakaway.row + _SWING_ROWS) + 1]))
    share = math.sqrt(24.0 / 0.54 * _FALSIFIED * samples.position_noise_m / max(swing_m, 1.0e-9))
    share = min(max(share, _LEAST_SHARE_OF_AGE), _LARGEST_SHARE_OF_AGE)
    edges = _block_edges(time_s, corner_s, pad_s, share)
    lengths = np.diff(np.append(edges, time_s.size))
    rest = samples.position_m[rest_first:sure]
    rest_m, rest_rows = float(rest.mean()), float(rest.size)
    rest_s = float(samples.time_s[rest_first]) - origin_s - 1.0
    times = np.concatenate([[rest_s], np.add.reduceat(time_s, edges) / lengths])
    seen = np.concatenate([[rest_m], np.add.reduceat(samples.position_m[sure : end + 1], edges) / lengths])
    rows = np.concatenate([[rest_rows], lengths.astype(np.float64)])
    slip = np.array([stretch.direction, line.rate, line.force_n, corner_s, rate_after, 0.0], dtype=np.float64)
    within_n = abs(line.rate) * breakaway.within_s
    return slip, times, seen, rows, (rest_m, rest_rows, origin_s, line.force_n, within_n, line.error_n)


def _rest_first(motion: RecordedMotion, number: int, row: int) -> int:
    """First row of the later half of the rest: the earlier half belongs to what coasted into it."""
    first = int(motion.samples.run_first[row])
    if number == 0:
        return first
    before = motion.phases.stretches[number - 1]
    if before.last + 1 < first:
        return first
    return before.last + 1 + (row - before.last) // 2


def _last_row(motion: RecordedMotion, stretch: Stretch, off_stops: BoolArray) -> int:
    """Last row that surely is in free motion on the stretch's line of the force."""
    last = stretch.last
    corners = motion.phases.corners
    if not bool((np.abs(corners - last) <= 2).any()):
        last -= 3 + motion.phases.half_window // 2  # it came to rest by itself
    touching = np.flatnonzero(~off_stops[stretch.first : last + 1])
    # a slip from a stop touches it in its first rows
    touching = touching[touching > 3]
    return stretch.first + int(touching[0]) - 3 if touching.size else last


def _force_line(motion: RecordedMotion, first: int, last: int, origin_s: float, spring_n_per_m: float) -> _Line | None:
    """The straight line of the force over these rows, None where it bends by more than noise and resolution hide."""
    samples = motion.samples
    corners = motion.phases.corners
    inside = corners[(corners + 1 >= first) & (corners < (first + last) // 2)]
    if inside.size:
        first = max(first, int(inside[-1]) + 2)
    later = corners[(corners > first) & (corners <= last + 1)]
    if later.size:
        last = min(last, int(later[0]) - 1)
    if last - first < _FEWEST_ROWS:
        return None
    time_s = samples.time_s[first : last + 1] - origin_s
    force_n = samples.force_n[first : last + 1]
    middle_s, middle_n = float(time_s.mean()), float(force_n.mean())
    spread_s = time_s - middle_s
    square = float(spread_s @ spread_s)
    rate = float(spread_s @ (force_n - middle_n)) / square
    left = force_n - middle_n - rate * spread_s
    parts = min(_LINE_PARTS, left.size // 3)
    means = [float(part.mean()) for part in np.array_split(left, max(1, parts))]
    hidden_n = 0.2 * spring_n_per_m * samples.position_noise_m + 1.0e-6 * float(np.ptp(force_n))
    noise_n = samples.force_noise_n * math.sqrt(max(1, parts) / left.size)
    if max(abs(mean) for mean in means) > _LINE_SIGMAS * noise_n + hidden_n:
        return None
    error_n = samples.force_noise_n * math.sqrt(1.0 / left.size + middle_s**2 / square)
    return _Line(middle_n - rate * middle_s, rate, error_n)


def _coast(
    motion: RecordedMotion, number: int, line: _Line, origin_s: float, *, off_stops: BoolArray, spring_n_per_m: float
) -> tuple[float, float, int] | None:
    """Time of the corner, force rate after it and the last row of the rest that the stem coasts to; None for none."""
    phases, samples = motion.phases, motion.samples
    stretch = phases.stretches[number]
    end_of_line = int(samples.run_last[stretch.last])
    corners = phases.corners[phases.corners >= stretch.last - 1]
    if corners.size == 0 or int(corners[0]) > stretch.last + 2 or int(corners[0]) + 3 >= end_of_line:
        return None
    corner = int(corners[0])
    if corners.size > 1:
        end_of_line = min(end_of_line, int(corners[1]) - 2)
    after = number + 1
    coasts = after < len(phases.stretches) and phases.stretches[after].after is After.CORNER
    coast_last = phases.stretches[after].last if coasts else stretch.last
    if coasts and (phases.stretches[after].driven or phases.stretches[after].direction != stretch.direction):
        return None
    following = phases.stretches[after + coasts].first if after + coasts < len(phases.stretches) else end_of_line
    end = min(end_of_line, coast_last + (following - coast_last) // 2)
    if end - corner < _FEWEST_ROWS or not bool(off_stops[corner : end + 1].all()):
        return None
    later = _force_line(motion, corner + 2, max(end, min(end_of_line, following - 1)), origin_s, spring_n_per_m)
    if later is None or later.rate == line.rate:
        return None
    corner_s = (later.force_n - line.force_n) / (line.rate - later.rate)
    if abs(corner_s + origin_s - float(samples.time_s[corner])) > 2.0 * samples.period_s + 0.01:
        return None
    return corner_s, later.rate, end


def _block_edges(time_s: FloatArray, corner_s: float, pad_s: float, share: float) -> IntArray:
    """First rows of blocks that grow with the age of the motion, which begins anew at the corner."""
    turn = int(np.searchsorted(time_s, corner_s, side="right")) if math.isfinite(corner_s) else time_s.size
    # where the instant of breakaway may lie, rows stand alone or in blocks that time it well enough
    doubtful = int(np.searchsorted(time_s[:turn], pad_s))
    before = _growing(time_s[:turn], 0.0, doubtful, share)
    return np.concatenate([before, turn + _growing(time_s[turn:], corner_s, 0, share)])


@njit(cache=True)
def _growing(time_s: FloatArray, start_s: float, doubtful: int, share: float) -> IntArray:
    """First rows of blocks as long as this share of their age, after some that are doubtful and some of one row."""
    edges = np.empty(time_s.size, np.int64)
    count = row = 0
    while row < time_s.size:
        edges[count] = row
        count += 1
        if row < doubtful:
            row += 1 + doubtful // _DOUBTFUL_BLOCKS
            continue
        latest_s = time_s[row] + share * (time_s[row] - start_s)
        alone = row < doubtful + _ROWS_ONE_BY_ONE
        row += 1
        while not alone and row < time_s.size and time_s[row] <= latest_s:
            row += 1
    return edges[:count]
