"""The actuator's force, freed of the gauge's noise: straight lines where there are any, else what was measured.

Gauge noise that drove the model would look like motion that the stem did not make. So where a command was recorded
the force is the command passed through the path that the measured pressure shows (gain, offset, dead time and lag),
and without one the pressure's own straight lines. Neither is used where the measured pressure leaves them by more than
a gauge's noise explains: then it is the measured pressure itself, with its noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import partial
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.optimize import minimize

from estimators.engine.rows import runs_between_gaps
from estimators.engine.segmentation import extremes, moving_mean
from estimators.samples import channel_noise
from valve.nameplate import Nameplate
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

_MOST_LEFT: Final = 0.006  # of the force's range, rms: what a gauge's noise and a hunting I/P may leave beside lines
_QUIET: Final = 0.2  # of the position's noise times the spring rate: so quiet a force needs no lines
_LEAST_TURN: Final = 0.004  # of the force's range: a smaller turn is noise or hunting
_EVEN_S: Final = 0.02
_FEWEST_EVEN: Final = 200
_SPECTRUM_WIDTH: Final = 15  # frequencies that are averaged
_SLOW_HZ: Final = 5.0  # an I/P that hunts does it slower
_HIGHEST_SHARE: Final = 0.9  # of the highest frequency
_LEAST_AVERAGED: Final = 0.05
_POLES_HZ: Final = (4.0, 30.0)  # of a gauge's noise, from which its pole is sought
_SURELY: Final = 2.5  # times the gauge's noise: chance makes no frequency so loud
GAUGE_LAG_S: Final = 0.03  # a gauge's filter is no slower
_GAUGE_ALONE_S: Final = 0.012  # so short a lag is the gauge's, as far as the stem shows
_MOST_LAG_S: Final = 3.0
_MOST_CORNERS: Final = 150
_CORNER_SHARE: Final = 0.004  # of the range: how far from a line a corner must lie
_REFINEMENTS: Final = 6
_SMOOTHED_S: Final = 0.05
# A lag and a dead time, to see what the force makes of it: of a millisecond they look alike between rows of 20 ms.
_VARIED_S: Final = 0.01
_FIRST_ROWS: Final = 6000  # that show which lag and dead time are near
_DONE: Final = 1.0e-9  # of the squares that are left
_BATCH_S: Final = 1.0  # longer than a gauge's noise, or an I/P's hunting, remembers
_ANEW_SHARE: Final = 0.02  # of the command's range, across a gap
_FEWEST_RUN_ROWS: Final = 20
_PEAK_ROWS: Final = 7  # on either side of a turn, that show whether the force is straight there
_PEAK_LEFT: Final = 0.05  # of the bend in a row's time: so straight must it be
_PEAK_APART: Final = 1.0e-3  # of a row's time: a turn nearer to its row is there


class Source(StrEnum):
    """What the force is made of."""

    COMMAND = "the command's path"  # fitted to the measured pressure
    LINES = "the pressure's straight lines"
    MEASURED = "the measured pressure"
    FORCE = "the measured force"
    COMMAND_ALONE = "the command alone"


@dataclass(frozen=True, slots=True, eq=False)
class ForcePath:
    """Force at the rows, N, shape (n,), with its noise from row to row and where it turns back, s.

    ``left_n`` is what the measured force has beside it, shape (n,): noise, and what an I/P does by itself.
    ``lag_s``, with its standard error ``lag_error_s``, and ``dead_time_s`` are the path's, 0 where there is none;
    ``commanded_n`` is the command's force before them, shape (n,), where they are not 0, and from ``bends_s`` on such a
    force bends. The force may be later than said by up to ``late_s``: a short lag may be the gauge's or the I/P's.
    Below 0 it is by how much the force may be earlier: a gauge without a command is behind its filter.
    At ``peaks_s`` straight lines meet between two rows, at the forces ``peaks_n``, shape (p,).
    ``by_converter`` is the same path where that lateness is the I/P's: its force turns as slowly as the gauge shows.
    """

    source: Source
    force_n: FloatArray
    noise_n: float
    corners_s: FloatArray
    left_n: FloatArray
    lag_s: float = 0.0
    dead_time_s: float = 0.0
    late_s: float = 0.0
    commanded_n: FloatArray | None = None
    bends_s: FloatArray = field(default_factory=lambda: np.empty(0))
    lag_error_s: float = 0.0
    peaks_s: FloatArray = field(default_factory=lambda: np.empty(0))
    peaks_n: FloatArray = field(default_factory=lambda: np.empty(0))
    by_converter: ForcePath | None = None

    def knots(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return times, s, and forces, N, between which it is straight: those of the rows, shape (n,), and peaks."""
        place = np.searchsorted(time_s, self.peaks_s)
        return np.insert(time_s, place, self.peaks_s), np.insert(self.force_n, place, self.peaks_n)


@njit(cache=True, error_model="numpy")
def lagged(time_s: FloatArray, values: FloatArray, lag_s: float, restarts: BoolArray) -> FloatArray:
    """Values, straight between rows, behind a first-order lag that begins in balance; shape (n,), in any unit.

    It begins so again in the rows that ``restarts`` marks, shape (n,).
    """
    out = np.empty(values.size)
    out[0] = values[0]
    for row in range(1, values.size):
        if restarts[row]:
            out[row] = values[row]
            continue
        step = time_s[row] - time_s[row - 1]
        slope = (values[row] - values[row - 1]) / step
        fades = np.exp(-step / lag_s) if lag_s > 0.0 else 0.0
        # a ramp is followed lag_s late
        target = values[row - 1] - slope * lag_s
        out[row] = target + slope * step + (out[row - 1] - target) * fades
    return out


def force_path(
    recording: Recording,
    nameplate: Nameplate,
    rows: IntArray,
    *,
    spring_n_per_m: float,
    noise_m: float,
) -> ForcePath:
    """Return the force at these complete rows, shape (n,).

    Raises RecordingError where the diaphragm area is needed and unknown.
    """
    path = _at_rows(recording, nameplate, rows, spring_n_per_m=spring_n_per_m, noise_m=noise_m)
    return path if path.lag_s > 0.0 else _with_peaks(recording.time_s[rows], path)


def _at_rows(
    recording: Recording, nameplate: Nameplate, rows: IntArray, *, spring_n_per_m: float, noise_m: float
) -> ForcePath:
    time_s = recording.time_s[rows]
    run_first, _ = runs_between_gaps(time_s)
    measured_n = recording.actuator_force_n(nameplate)[rows]
    noise_n = channel_noise(time_s, measured_n, run_first)
    range_n = max(float(np.ptp(measured_n)), 1.0e-12)
    nothing = np.zeros(rows.size)
    if recording.force_n is not None:
        corners_s = turns(time_s, measured_n, noise_n, range_n)
        return ForcePath(Source.FORCE, measured_n, noise_n, corners_s, nothing)
    if recording.pressure_pa is None:
        corners_s = turns(time_s, measured_n, noise_n, range_n)
        return ForcePath(Source.COMMAND_ALONE, measured_n, noise_n, corners_s, nothing)
    quiet = noise_n <= _QUIET * spring_n_per_m * noise_m
    if not quiet:
        command = recording.command_pa
        if command is not None and np.isfinite(command[rows]).all() and float(np.ptp(command[rows])) > 0.0:
            path = through_command(time_s, command[rows], measured_n, run_first)
            if float(path.left_n.std()) <= _MOST_LEFT * range_n:
                return path
        lines = _straight_runs(time_s, measured_n, range_n, run_first)
        if lines is not None and float(lines.left_n.std()) <= _MOST_LEFT * range_n:
            return lines
    return ForcePath(Source.MEASURED, measured_n, noise_n, turns(time_s, measured_n, noise_n, range_n), nothing)


def _with_peaks(time_s: FloatArray, path: ForcePath) -> ForcePath:
    """Return the path with the turns between two rows at which straight lines meet.

    Straight from row to row the force would miss the tip of a triangle: in rows of 20 ms by more than some valves'
    friction varies.
    """
    corners_s = path.corners_s.copy()
    peaks_s: list[float] = []
    peaks_n: list[float] = []
    for number, row in enumerate(np.searchsorted(time_s, path.corners_s).tolist()):
        peak = _peak(time_s, path.force_n, _tip(time_s, path.force_n, row))
        # turns so near to each other that they share a tip have one peak
        if peak is not None and (not peaks_s or peak[0] > peaks_s[-1]):
            corners_s[number] = peak[0]
            peaks_s.append(peak[0])
            peaks_n.append(peak[1])
    return replace(path, corners_s=np.sort(corners_s), peaks_s=np.array(peaks_s), peaks_n=np.array(peaks_n))


def _tip(time_s: FloatArray, force_n: FloatArray, row: int) -> int:
    """Row of the largest or the smallest force near a turn, which smoothing puts elsewhere between unlike ramps."""
    first = int(np.searchsorted(time_s, time_s[row] - _SMOOTHED_S))
    end = int(np.searchsorted(time_s, time_s[row] + _SMOOTHED_S, side="right"))
    near = force_n[first:end]
    is_upper = force_n[row] > 0.5 * (near[0] + near[-1])
    return first + int(np.argmax(near) if is_upper else np.argmin(near))


def _peak(time_s: FloatArray, force_n: FloatArray, row: int) -> tuple[float, float] | None:
    """Instant, s, and force, N, at which the lines before and after a turn meet near its row; None if they do not."""
    # the turn may lie on either side of its row
    before, after = slice(row - _PEAK_ROWS, row), slice(row + 1, row + 1 + _PEAK_ROWS)
    if before.start < 0 or after.stop > time_s.size:
        return None
    lines, left = [], 0.0
    for side, near in ((before, -1), (after, 0)):
        at_s, values = time_s[side] - time_s[row], force_n[side]
        slope, level = np.polyfit(at_s, values, 1)
        off = values - level - slope * at_s
        left = max(left, float(np.abs(off[near])), float(np.std(off)))
        lines.append((float(slope), float(level)))
    (rising, at_row), (falling, level) = lines
    bend = rising - falling
    period_s = float(np.median(np.diff(time_s[before.start : after.stop])))
    if rising * falling >= 0.0 or left > _PEAK_LEFT * abs(bend) * period_s:
        return None
    meets_s = (level - at_row) / bend
    peak_s = float(time_s[row]) + meets_s
    if not time_s[row - 1] < peak_s < time_s[row + 1] or abs(meets_s) < _PEAK_APART * period_s:
        return None
    return peak_s, at_row + rising * meets_s


def turns(time_s: FloatArray, force_n: FloatArray, noise_n: float, range_n: float) -> FloatArray:
    """Return the times at which the force turns back, s, shape (t,); arrays of shape (n,)."""
    width = 2 * (max(1, round(_SMOOTHED_S / float(np.median(np.diff(time_s))))) // 2) + 1
    smooth = moving_mean(force_n, width)
    least_n = max(_LEAST_TURN * range_n, 8.0 * noise_n / np.sqrt(width))
    return np.asarray(time_s[extremes(smooth, least_n)[1:-1]])


def restarts_of(command: FloatArray, run_first: IntArray) -> BoolArray:
    """Rows after a gap at which the command is another than before it: another recording begins there.

    ``command``, ``run_first``: shape (n,), the command in any unit.
    """
    first = np.flatnonzero(np.diff(run_first) > 0) + 1
    restarts = np.zeros(command.size, np.bool_)
    jumps = np.abs(command[first] - command[first - 1]) > _ANEW_SHARE * float(np.ptp(command))
    restarts[first[jumps]] = True
    return restarts


def through_command(time_s: FloatArray, command: FloatArray, measured_n: FloatArray, run_first: IntArray) -> ForcePath:
    """The command behind a dead time and a lag, with the gain and offset that fit the measured force best.

    All arrays: shape (n,), ``command`` in any unit.
    """
    restarts = restarts_of(command, run_first)
    begins_s = time_s[np.maximum.accumulate(np.where(restarts, np.arange(time_s.size), 0))]
    thin = np.unique(
        np.concatenate([np.arange(0, time_s.size, 1 + time_s.size // _FIRST_ROWS), np.flatnonzero(restarts)])
    )

    def passed(logarithms: FloatArray, rows: slice | IntArray = slice(None)) -> tuple[FloatArray, float, float]:
        lag_s, dead_s = float(np.exp(logarithms[0])), float(np.exp(logarithms[1]))
        late = np.interp(np.maximum(time_s[rows] - dead_s, begins_s[rows]), time_s, command)
        return lagged(time_s[rows], late, lag_s, restarts[rows]), lag_s, dead_s

    def cost(logarithms: FloatArray, rows: slice | IntArray = slice(None)) -> float:
        if logarithms.max() > np.log(_MOST_LAG_S) or logarithms.min() < -12.0:
            return 1.0e30
        _, _, left = _line(passed(logarithms, rows)[0], measured_n[rows])
        return float(left @ left)

    found = None
    # lag and dead time are nearly alike on ramps: each start is followed to its own end, on some of the rows
    for start in (np.log([0.01, 0.001]), np.log([0.3, 0.01]), np.log([0.05, 0.001]), np.log([0.003, 0.05])):
        least = 1.0e-6 * cost(start, thin)
        one = minimize(
            partial(cost, rows=thin), start, method="Nelder-Mead", options={"maxfev": 60, "xatol": 0.01, "fatol": least}
        )
        if found is None or one.fun < found.fun:
            found = one
    assert found is not None
    least = _DONE * float(found.fun) * time_s.size / thin.size
    found = minimize(cost, found.x, method="Nelder-Mead", options={"maxfev": 200, "xatol": 1.0e-3, "fatol": least})
    shape, lag_s, dead_s = passed(np.asarray(found.x))
    gain, force_n, left_n = _line(shape, measured_n)
    steps = np.diag(np.log1p(_VARIED_S / np.array([lag_s, dead_s])))
    slopes = [gain[1] * (passed(np.asarray(found.x) + step)[0] - shape) / _VARIED_S for step in steps]
    covariance = coloured_covariance(np.column_stack([np.ones(shape.size), shape, *slopes]), left_n, time_s)
    commanded_n = gain[0] + gain[1] * command
    hunting_n = _hunting(time_s, left_n)

    def path(sharp: bool) -> ForcePath:
        turning_n = commanded_n if sharp else force_n
        range_n = max(float(np.ptp(turning_n)), 1.0e-12)
        bends_s = np.empty(0) if sharp else turns(time_s, commanded_n, 0.0, range_n) + dead_s
        return ForcePath(
            Source.COMMAND,
            turning_n + hunting_n,
            0.0,
            turns(time_s, turning_n, 0.0, range_n),
            left_n,
            0.0 if sharp else lag_s,
            0.0 if sharp else dead_s,
            lag_s + dead_s if sharp else GAUGE_LAG_S,
            None if sharp else commanded_n,
            bends_s,
            float(np.sqrt(covariance[2, 2])),
        )

    if lag_s + dead_s > GAUGE_LAG_S:
        return path(sharp=False)
    # so late a pressure may be the gauge's alone: the force turns as sharply as the command, at an unknown instant
    sharp = path(sharp=True)
    if lag_s + dead_s <= _GAUGE_ALONE_S:
        return sharp
    # rows are averaged around the bends: those of both, or their likelihoods were not to be compared
    slow = path(sharp=False)
    events_s = np.unique(np.concatenate([sharp.corners_s, slow.corners_s, slow.bends_s]))
    return replace(sharp, bends_s=events_s, by_converter=replace(slow, bends_s=events_s))


def _line(shape: FloatArray, measured_n: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Offset and gain by which a shape fits a force best, the force so, N, and what is left, N."""
    away, mean_n = shape - shape.mean(), measured_n.mean()
    gain = float(away @ measured_n) / max(float(away @ away), 1.0e-300)
    force_n = mean_n + gain * away
    return np.array([mean_n - gain * shape.mean(), gain]), force_n, measured_n - force_n


def coloured_covariance(design: FloatArray, left: FloatArray, time_s: FloatArray) -> FloatArray:
    """Covariance of least squares whose residuals are coloured, shape (p, p): Newey and West (1987), by batches.

    ``design``: shape (n, p), ``left``: shape (n,), in any units.
    """
    batch = max(1, int(np.searchsorted(time_s, time_s[0] + _BATCH_S)))
    scores = np.add.reduceat(design * left[:, None], np.arange(0, left.size, batch))
    inverse = np.linalg.pinv(design.T @ design)
    return np.asarray(inverse @ (scores.T @ scores) @ inverse)


def _hunting(time_s: FloatArray, left_n: FloatArray) -> FloatArray:
    """What an I/P does slowly by itself beside its lines, N: the part of what is left that is above a gauge's noise.

    A Wiener filter below _SLOW_HZ. Noise that it let pass would drive the model, whose damping would grow to smooth it.
    """
    period_s = float(np.median(np.diff(time_s)))
    even_s = np.arange(time_s[0], time_s[-1], max(period_s, _EVEN_S))
    if even_s.size < _FEWEST_EVEN:
        return np.zeros(time_s.size)
    width = 2 * (max(1, round(_EVEN_S / period_s)) // 2) + 1
    even = np.interp(even_s, time_s, moving_mean(left_n, width))
    spectrum = np.fft.rfft(even - even.mean())
    frequency = np.asarray(np.fft.rfftfreq(even.size, float(even_s[1] - even_s[0])), np.float64)
    averaged = np.abs(np.sinc(frequency * width * period_s)) if width > 1 else np.ones(frequency.size)
    power = np.asarray(np.abs(spectrum) ** 2 / np.maximum(averaged, _LEAST_AVERAGED) ** 2, np.float64)
    floor = _gauge_noise(frequency, power)
    if floor is None:
        return np.zeros(time_s.size)
    power = moving_mean(power, _SPECTRUM_WIDTH)
    gain = np.where(power > _SURELY * floor, 1.0 - floor / np.maximum(power, floor), 0.0)
    gain[frequency > _SLOW_HZ] = 0.0
    return np.interp(time_s, even_s, np.fft.irfft(gain * spectrum, even.size))


def _gauge_noise(frequency: FloatArray, power: FloatArray) -> FloatArray | None:
    """The power of a gauge's noise at all frequencies, shape (n,), by its power above _SLOW_HZ; None with too few.

    Noise behind a filter of one pole is likeliest where sum(ln P + power / P) is least (Whittle 1953).
    """
    known = (frequency > _SLOW_HZ) & (frequency < _HIGHEST_SHARE * frequency[-1])
    if int(known.sum()) < _SPECTRUM_WIDTH:
        return None
    squared, measured = frequency[known] ** 2, power[known] / max(float(power[known].mean()), 1.0e-300)

    def surprise(logarithms: FloatArray) -> float:
        shape = math.exp(logarithms[0]) / (1.0 + squared * math.exp(min(-2.0 * logarithms[1], 50.0)))
        return float(np.sum(np.log(shape) + measured / shape))

    found = min(
        (minimize(surprise, [0.0, math.log(pole_hz)], method="Nelder-Mead") for pole_hz in _POLES_HZ),
        key=lambda one: float(one.fun),
    )
    level, pole = (float(one) for one in found.x)
    most = max(float(power[known].mean()), 1.0e-300)
    return np.asarray(most * math.exp(level) / (1.0 + frequency**2 * math.exp(min(-2.0 * pole, 50.0))))


def _straight_runs(time_s: FloatArray, force_n: FloatArray, range_n: float, run_first: IntArray) -> ForcePath | None:
    """The force as straight lines within each run, None where it is made of too many."""
    firsts = np.unique(run_first)
    if firsts.size == 1:
        return _straight(time_s, force_n, range_n)
    parts = []
    for first, end in pairwise([*firsts.tolist(), time_s.size]):
        if end - first < _FEWEST_RUN_ROWS:
            own = force_n[first:end]
            none = np.zeros(own.size)
            parts.append(ForcePath(Source.LINES, own, 0.0, np.empty(0), none, late_s=-0.5 * GAUGE_LAG_S))
            continue
        one = _straight(time_s[first:end], force_n[first:end], range_n)
        if one is None:
            return None
        parts.append(one)

    def whole(name: str) -> FloatArray:
        return np.concatenate([getattr(one, name) for one in parts])

    return replace(
        parts[0],
        force_n=whole("force_n"),
        corners_s=whole("corners_s"),
        left_n=whole("left_n"),
    )


def _straight(time_s: FloatArray, force_n: FloatArray, range_n: float) -> ForcePath | None:
    """The force as straight lines between corners, None where it is made of too many."""
    period_s = float(np.median(np.diff(time_s)))
    width = 2 * (max(1, round(_SMOOTHED_S / period_s)) // 2) + 1
    smooth = moving_mean(force_n, width)
    thin = np.unique(np.linspace(0, time_s.size - 1, min(time_s.size, 4000)).astype(np.int64))
    spread_n = float((force_n - smooth).std())
    tolerance_n = max(_CORNER_SHARE * range_n, 6.0 * spread_n / np.sqrt(max(1, width // 16)))
    corners = _corners(time_s[thin], smooth[thin], tolerance_n)
    if corners.size > _MOST_CORNERS:
        return None
    knots_s = time_s[thin][corners]
    for _ in range(_REFINEMENTS):
        values, slopes = _polyline(time_s, force_n, knots_s)
        bend = np.diff(slopes)
        # the corner moves to where the lines beside it, each fitted by itself, meet
        moved = knots_s.copy()
        moved[1:-1] += np.clip(_meeting(time_s, force_n, knots_s), -0.2, 0.2) * (np.abs(bend) > 0.0)
        if np.any(np.diff(moved) <= 2.0 * period_s):
            break
        done = float(np.abs(moved - knots_s).max()) < 1.0e-3 * period_s
        knots_s = moved
        if done:
            break
    values, _ = _polyline(time_s, force_n, knots_s)
    line_n = np.interp(time_s, knots_s, values)
    corners_s = turns(time_s, line_n, 0.0, range_n)
    left_n = force_n - line_n
    late_s = -0.5 * GAUGE_LAG_S  # the filter of a gauge so noisy is not known
    return ForcePath(Source.LINES, line_n + _hunting(time_s, left_n), 0.0, corners_s, left_n, late_s=late_s)


def _corners(time_s: FloatArray, values: FloatArray, tolerance: float) -> IntArray:
    """Rows of the corners of a polygon that stays within the tolerance of the values (Ramer, Douglas, Peucker)."""
    kept = {0, time_s.size - 1}
    parts = [(0, time_s.size - 1)]
    while parts and len(kept) <= _MOST_CORNERS + 1:
        first, last = parts.pop()
        if last - first < 2:
            continue
        inside = slice(first + 1, last)
        slope = (values[last] - values[first]) / (time_s[last] - time_s[first])
        away = np.abs(values[inside] - values[first] - slope * (time_s[inside] - time_s[first]))
        row = int(np.argmax(away))
        if away[row] > tolerance:
            row += first + 1
            kept.add(row)
            parts += [(first, row), (row, last)]
    return np.array(sorted(kept), dtype=np.int64)


def _polyline(time_s: FloatArray, force_n: FloatArray, knots_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least-squares values at the knots of a continuous polygon, and the slopes between them."""
    count = knots_s.size
    at = np.clip(np.searchsorted(knots_s, time_s, side="right") - 1, 0, count - 2)
    share = (time_s - knots_s[at]) / np.diff(knots_s)[at]
    normal = np.zeros((count, count))
    right = np.zeros(count)
    np.add.at(normal, (at, at), (1.0 - share) ** 2)
    np.add.at(normal, (at + 1, at + 1), share**2)
    cross = np.bincount(at, weights=share * (1.0 - share), minlength=count - 1)[: count - 1]
    index = np.arange(count - 1)
    normal[index, index + 1] += cross
    normal[index + 1, index] += cross
    np.add.at(right, at, (1.0 - share) * force_n)
    np.add.at(right, at + 1, share * force_n)
    values = np.linalg.solve(normal + 1.0e-9 * np.eye(count), right)
    return np.asarray(values), np.asarray(np.diff(values) / np.diff(knots_s))


def _meeting(time_s: FloatArray, force_n: FloatArray, knots_s: FloatArray) -> FloatArray:
    """How far from each inner knot the lines beside it meet, s, each line fitted to the inner part of its stretch."""
    lines = []
    for left_s, right_s in pairwise(knots_s.tolist()):
        margin_s = min(0.1 * (right_s - left_s), 0.2)
        first, end = np.searchsorted(time_s, [left_s + margin_s, right_s - margin_s])
        part = slice(int(first), max(int(end), int(first) + 2))
        middle_s = float(time_s[part].mean())
        spread_s = time_s[part] - middle_s
        square = max(float(spread_s @ spread_s), 1.0e-300)
        slope = float(spread_s @ force_n[part]) / square
        lines.append((float(force_n[part].mean()) - slope * middle_s, slope))
    away = []
    for number, knot_s in enumerate(knots_s[1:-1]):
        (left, left_slope), (right, right_slope) = lines[number], lines[number + 1]
        bend = left_slope - right_slope
        away.append((right - left) / bend - knot_s if bend != 0.0 else 0.0)
    return np.array(away)
