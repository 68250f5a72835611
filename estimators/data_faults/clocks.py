"""Faults of the clock: an origin far away, stamps that jitter beside even samples, a pressure on a clock of its own."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from estimators.data_faults.fault import DataFault, off_line
from estimators.samples import FloatArray, resolution
from valve.messages import say
from valve.recording import INTERVAL_CHANNELS, Acquisition, Recording

_FAR: Final = 1.0e5  # s: below it float64 keeps a nanosecond's tenth, and any recording may begin there
_UNIX_S: Final = (0.5e9, 4.0e9)  # the years 1985 to 2096
# Own choices; tests/estimators/data_faults/test_found.py has what must not be taken for one.
_LEAST_JITTER: Final = 0.005  # of the period, rms
_MOST_JITTER: Final = 0.5  # of the period, for nine of ten: more, and nobody knows which sample is which
_LATEST: Final = 5.0  # periods
_KNOWN: Final = 0.1  # the share of the stamps' jitter that a channel shows is known to this
_NO_SHARE: Final = 0.3
_RAMP: Final = 0.3  # of a slope: so alike it is before and after a row
_TELLING_ROWS: Final = 150.0
_OF_DIGIT: Final = 0.1  # of the resolution: so far the jitter moves a sample, rms
_SMOOTHED: Final = 8  # rows to each side, for the slope of a channel
_LEAST_TURNS: Final = 5
_MOST_OF_TURNS: Final = 0.6  # are alike
_AWAY: Final = 6.0  # times the median of what the line leaves: 4 standard deviations
_SAME_S: Final = 0.001
_ROUNDS: Final = 30
_MOST_APART_S: Final = 1.0
_SPREADS: Final = 3.0  # so many times the scatter of the turns do the clocks come apart
_POINTS: Final = 240  # that a corner is found among
# How long a pressure may stand still where it turns, behind a dead band or on a hold: of what is seen to a side.
_HELD: Final = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.75, 0.9])
_FINER: Final = np.array([0.03, 0.003])  # of the same: how near the corner is sought next
_CLEARER: Final = 0.5  # of the misfit without such a hold
_FLAT: Final = 1.0e-12  # of a design that is singular, as where a corner has no rows behind it
_ERRORS: Final = 6.0
_CLEARLY_BY_TIME: Final = 0.6  # of the squares that the sweeps' times leave
_LEAST_DRIFT_S: Final = 0.02
_BETTER: Final = 0.95  # of what the balance of forces leaves: so much a clock that is put right mends
_AS_LATE: Final = (0.5, 1.0, 1.5, 2.0)  # of the stem's mean delay: a pressure that is late alike must not do so, too
_SPEED_S: Final = 0.05  # to both sides, that show a speed
_MOVES: Final = 0.05  # of the usual speed
_LEAST_MOVING: Final = 100  # rows
_ENOUGH_ROWS: Final = 20_000  # to find the reversals among
_TURN_OF_SPAN: Final = 0.15  # a reversal of the pressure goes so far to both sides


def from_first_row(recording: Recording, place: str) -> tuple[Recording, list[DataFault]]:
    """Return the recording with its time counted from the first row, and where the origin was, if it was far away.

    Far from zero float64 rounds a time to 0.2 microseconds (1.8e9 s); what is left is rounded to what that holds.
    """
    origin_s = float(recording.time_s[0])
    if origin_s == 0.0:
        return recording, []
    far = max(abs(origin_s), abs(float(recording.time_s[-1]))) > _FAR
    # the last decimal that the file can have meant
    decimals = int(np.floor(-np.log10(2.0 * np.spacing(abs(origin_s))))) if far else None

    def counted(times_s: FloatArray | None) -> FloatArray | None:
        if times_s is None:
            return None
        since_s = times_s - origin_s
        return since_s if decimals is None else np.round(since_s, decimals)

    time_s = counted(recording.time_s)
    assert time_s is not None
    if (np.diff(time_s) <= 0.0).any():
        time_s = recording.time_s - origin_s
    moved: dict[str, Any] = {name: counted(getattr(recording, name)) for name in INTERVAL_CHANNELS}
    put_right = replace(recording, time_s=time_s, **moved)
    if not far:
        return put_right, []
    if _UNIX_S[0] < origin_s < _UNIX_S[1]:
        sentence = say(
            "origin_unix_time",
            "The time{place} begins at {origin:.10g} s, which is {at:%Y-%m-%d %H:%M:%S} as unix time: it is counted "
            "from the first row here.",
            place=place,
            origin=origin_s,
            at=datetime.fromtimestamp(origin_s, UTC),
        )
    else:
        sentence = say(
            "origin_far_away",
            "The time{place} begins at {origin:.10g} s: it is counted from the first row here.",
            place=place,
            origin=origin_s,
        )
    return put_right, [DataFault("time_s", "far_origin", 0, sentence, {"origin_s": (origin_s, "s")})]


def with_even_stamps(recording: Recording, place: str) -> tuple[Recording, list[DataFault]]:
    """Return the recording at even times where its samples were taken evenly and only their stamps jitter.

    A file says nothing of its stamps. On a ramp a sample that was taken late lies off the line of its neighbours by
    the slope times the delay, one that was only stamped late lies on it: the channels tell which it was.
    """
    if recording.provenance.acquisition is not Acquisition.FILE or recording.samples < 200:
        return recording, []
    if recording.sent_s is not None or recording.received_s is not None:
        return recording, []
    even_s = _even(recording.time_s)
    if even_s is None:
        return recording, []
    off_s = recording.time_s - even_s
    jitter_s, period_s = float(np.std(off_s)), float(np.median(np.diff(even_s)))
    if jitter_s < _LEAST_JITTER * period_s:
        return recording, []
    believed = [
        found
        for name in ("pressure_pa", "force_n", "position_m")
        if (channel := getattr(recording, name)) is not None
        and (found := _share_of_stamps(even_s, off_s, channel)) is not None
    ]
    # the channel that tells most; any that needs the stamps speaks for them
    if not believed or any(share > 0.5 for share, error in believed if error < _KNOWN):
        return recording, []
    share, error = min(believed, key=lambda one: one[1])
    if error > _KNOWN or share > _NO_SHARE:
        return recording, []
    sentence = say(
        "stamps_jitter",
        "The stamps{place} jitter by {jitter:.3g ms} rms beside samples that were taken evenly, every {period:.4g ms}, "
        "as those of a busy PC do: the even times are used.",
        place=place,
        jitter=jitter_s,
        period=period_s,
    )
    fault = DataFault("time_s", "stamp_jitter", 0, sentence, {"jitter_s": (jitter_s, "s"), "period_s": (period_s, "s")})
    return replace(recording, time_s=even_s), [fault]


def _even(time_s: FloatArray) -> FloatArray | None:
    """Return the even times of a row's number that lie nearest to the stamps; None where rows are not to be counted."""
    periods_s = np.diff(time_s)
    every = np.arange(time_s.size, dtype=np.float64)
    missing = np.concatenate([[0.0], np.cumsum(np.maximum(1.0, np.rint(periods_s / np.median(periods_s))))])
    for slots in (every, missing):
        slope, offset = np.polyfit(slots, time_s, 1)
        even_s = np.asarray(slope * slots + offset)
        off_s = np.abs(time_s - even_s)
        if float(np.percentile(off_s, 90.0)) < _MOST_JITTER * slope and float(off_s.max()) < _LATEST * slope:
            return even_s
    return None


def _share_of_stamps(even_s: FloatArray, off_s: FloatArray, channel: FloatArray) -> tuple[float, float] | None:
    """Return how much of the stamps' jitter shows in a channel, with its error: 1 where samples came when they say.

    On a ramp of slope s a sample that was taken late by e lies s e above its place at the even time.
    """
    reach = _SMOOTHED
    before = (channel[reach:-reach] - channel[: -2 * reach]) / (even_s[reach:-reach] - even_s[: -2 * reach])
    after = (channel[2 * reach :] - channel[reach:-reach]) / (even_s[2 * reach :] - even_s[reach:-reach])
    slope = 0.5 * (before + after)
    ramp = np.abs(after - before) <= _RAMP * np.abs(slope)  # and no step or corner, whose slope is no sample's own
    inner = slice(reach - 1, 1 - reach)
    expected = slope * off_line(even_s, off_s)[inner]
    seen = off_line(even_s, channel)[inner]
    known = np.isfinite(expected) & np.isfinite(seen) & ramp
    expected, seen = expected[known], seen[known]
    if expected.size < 100:
        return None
    # corners and slips have bends of their own
    plain = np.abs(seen) <= np.percentile(np.abs(seen), 90.0)
    expected, seen = expected[plain], seen[plain]
    weight = float(expected @ expected)
    # a few rows tell nothing
    if weight**2 < _TELLING_ROWS * float(np.sum(expected**4)):
        return None
    # a step of the converter hides what is smaller than it
    if weight <= expected.size * (_OF_DIGIT * resolution(channel[np.isfinite(channel)])) ** 2:
        return None
    share = float(expected @ seen) / weight
    left = seen - share * expected
    return share, float(np.sqrt(np.sum(left**2) / left.size / weight))


def on_one_clock(recording: Recording, place: str) -> tuple[Recording, list[DataFault]]:
    """Return the recording with its pressure on the position's clock where the two clocks drift apart.

    Where the pressure turns, a moving stem stops, within milliseconds and with any friction. Both instants, each from
    lines on its two sides, come further and further apart where the clocks run at different speeds. Behind a reading
    that lags they do so by how long a sweep takes, and a pressure that is late alike all along mends as much.
    """
    pressure_pa = recording.pressure_pa
    if pressure_pa is None or recording.samples < 500:
        return recording, []
    at_s, apart_s, upper, sweeps_s = [], [], [], []
    for first, turn, last in _turns(pressure_pa):
        found = _apart_s(recording, first, turn, last)
        if found is not None and abs(found) < _MOST_APART_S:
            at_s.append(float(recording.time_s[turn]))
            apart_s.append(found)
            upper.append(float(pressure_pa[turn] > pressure_pa[first]))
            sweeps_s.append(float(recording.time_s[turn] - recording.time_s[first]))
    if len(at_s) < _LEAST_TURNS:
        return recording, []
    when_s, late_s = np.array(at_s), np.array(apart_s)
    # above and below a stem may stop at another delay: at a stop, or as friction differs
    matrix = np.column_stack([when_s - when_s.mean(), np.ones_like(when_s), np.array(upper) - np.mean(upper)])
    solution, alike = _line_of_most(matrix, late_s)
    if np.count_nonzero(alike) < max(_LEAST_TURNS, _MOST_OF_TURNS * alike.size):
        return recording, []
    matrix, when_s, late_s = matrix[alike], when_s[alike], late_s[alike]
    rate, offset_s = float(solution[0]), float(solution[1] - solution[0] * np.mean(at_s))
    left_s = late_s - matrix @ solution
    spread_s = max(float(np.sqrt(np.sum(left_s**2) / (when_s.size - 3))), 1.0e-9)
    by_sweep = np.column_stack([np.array(sweeps_s)[alike], matrix[:, 1:]])
    by_sweep_s = late_s - by_sweep @ np.linalg.lstsq(by_sweep, late_s, rcond=None)[0]
    if float(left_s @ left_s) > _CLEARLY_BY_TIME * float(by_sweep_s @ by_sweep_s):
        return recording, []
    error = spread_s * float(np.sqrt(np.linalg.pinv(matrix.T @ matrix)[0, 0]))
    drift_s = abs(rate) * float(when_s[-1] - when_s[0])
    enough_s = max(_LEAST_DRIFT_S, recording.sample_period_s, _SPREADS * spread_s)
    if abs(rate) < _ERRORS * error or drift_s < enough_s:
        return recording, []
    moved = _moved(recording, rate * recording.time_s + offset_s)
    late_alike_s = float(late_s.mean())
    as_late = (_moved(recording, np.full_like(recording.time_s, part * late_alike_s)) for part in _AS_LATE)
    if not _left_pa(moved) < _BETTER * min(map(_left_pa, (recording, *as_late))):
        return recording, []
    runs_by = (
        say("runs_fast", "{rate:.3g ms} a second fast", rate=abs(rate))
        if rate < 0.0
        else say("runs_slow", "{rate:.3g ms} a second slow", rate=abs(rate))
    )
    sentence = say(
        "clock_of_its_own",
        "The pressure{place} is on a clock of its own, which runs {runs} beside the position's: where the pressure "
        "turns, the stem stops {first:.3g ms} later at the begin and {last:.3g ms} later at the end. It was set onto "
        "the position's clock; friction is known the worse for it. Record both channels by one device.",
        place=place,
        runs=runs_by,
        first=float(late_s[0]),
        last=float(late_s[-1]),
    )
    fault = DataFault(
        "pressure_pa", "own_clock", 0, sentence, {"rate": (float(rate), "s/s"), "drift_s": (drift_s, "s")}
    )
    return moved, [fault]


def _moved(recording: Recording, by_s: FloatArray) -> Recording:
    """The recording with its pressure later by that much, s, shape (n,)."""
    pressure_pa = recording.pressure_pa
    assert pressure_pa is not None
    known = np.isfinite(pressure_pa)
    there_s = recording.time_s + by_s
    moved_pa = np.interp(recording.time_s, there_s[known], pressure_pa[known], left=np.nan, right=np.nan)
    moved_pa[~known] = np.nan
    return replace(recording, pressure_pa=moved_pa)


def _line_of_most(matrix: FloatArray, late_s: FloatArray) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Least squares of the turns that are alike, shape (3,), and which these are.

    On a hold or a small loop a corner may lie anywhere: from the line that is nearest to most it is far away.
    """
    off_s = np.ones_like(late_s)
    for _ in range(_ROUNDS):
        root = np.maximum(off_s, _SAME_S) ** -0.5
        solution = np.linalg.lstsq(matrix * root[:, None], late_s * root, rcond=None)[0]
        off_s = np.abs(late_s - matrix @ solution)
    alike = off_s <= max(_AWAY * float(np.median(off_s)), _SAME_S)
    return np.asarray(np.linalg.lstsq(matrix[alike], late_s[alike], rcond=None)[0]), alike


def _left_pa(recording: Recording) -> float:
    """What place, way and speed leave of the pressure while the stem moves, Pa rms: least on the right clock."""
    time_s, position_m, pressure_pa = recording.time_s, recording.position_m, recording.pressure_pa
    assert pressure_pa is not None
    step = max(1, time_s.size // _ENOUGH_ROWS)
    reach = max(1, round(_SPEED_S / (step * recording.sample_period_s)))
    own_s, own_m, own_pa = time_s[::step], position_m[::step], pressure_pa[::step]
    speed = (own_m[2 * reach :] - own_m[: -2 * reach]) / (own_s[2 * reach :] - own_s[: -2 * reach])
    inner = slice(reach, -reach)
    known = np.isfinite(speed) & np.isfinite(own_m[inner]) & np.isfinite(own_pa[inner])
    moves = known & (np.abs(speed) > _MOVES * float(np.quantile(np.abs(speed[known]), 0.95))) if known.any() else known
    if np.count_nonzero(moves) < _LEAST_MOVING:
        return math.inf
    ways = [np.ones_like(speed), own_m[inner], np.sign(speed), speed]
    design, asked_pa = np.column_stack(ways)[moves], own_pa[inner][moves]
    found, *_ = np.linalg.lstsq(design, asked_pa, rcond=None)
    return float(np.sqrt(np.mean((asked_pa - design @ found) ** 2)))


def _turns(channel: FloatArray) -> list[tuple[int, int, int]]:
    """Return the rows of each large reversal, with those of the reversals before and after it."""
    rows = np.flatnonzero(np.isfinite(channel))
    rows = rows[:: 1 + rows.size // _ENOUGH_ROWS]
    own = channel[rows]
    low, high = np.percentile(own, (1.0, 99.0))
    least = _TURN_OF_SPAN * float(high - low)
    if least <= 0.0:
        return []
    found = [0]
    way = highest = lowest = 0
    for row in range(own.size):
        if way >= 0 and own[row] > own[highest]:
            highest = row
        if way <= 0 and own[row] < own[lowest]:
            lowest = row
        if way >= 0 and own[highest] - own[row] > least:
            found.append(highest)
            way, lowest = -1, row
        elif way <= 0 and own[row] - own[lowest] > least:
            found.append(lowest)
            way, highest = 1, row
    ends = [*dict.fromkeys(found), own.size - 1]
    inner = range(1, len(ends) - 1)
    return [(int(rows[ends[at - 1]]), int(rows[ends[at]]), int(rows[ends[at + 1]])) for at in inner]


def _apart_s(recording: Recording, first: int, turn: int, last: int) -> float | None:
    """Return by how much later than the pressure turns the stem stops, s; None where it was not on its way."""
    assert recording.pressure_pa is not None
    time_s, pressure_pa = recording.time_s, recording.pressure_pa
    reach = max(8, min(turn - first, last - turn) // 3)
    rows = slice(max(0, turn - reach), min(time_s.size, turn + reach + 1))
    at_s = time_s[rows] - time_s[turn]
    corner_s = _corner_s(at_s, pressure_pa[rows], rests=False)
    stop_s = _corner_s(at_s, recording.position_m[rows], rests=True)
    return None if corner_s is None or stop_s is None else stop_s - corner_s


def _corner_s(at_s: FloatArray, values: FloatArray, *, rests: bool) -> float | None:
    """Return when the values turn from one line to another, s from the middle; None where they do not.

    If they hold in between, it is when they begin to. What ``rests`` holds until the end, else it turns back at once,
    unless a hold of another length is clearer.
    """
    known = np.isfinite(values)
    at_s, values = at_s[known], values[known]
    if at_s.size < 12:
        return None
    together = at_s.size // _POINTS
    if together > 1:
        kept = together * (at_s.size // together)
        at_s, values = (one[:kept].reshape(-1, together).mean(axis=1) for one in (at_s, values))
    reach_s = float(min(-at_s[0], at_s[-1]))
    values = values - values.mean()
    total = float(values @ values)
    left, corner_s = _sought(at_s, values, reach_s, np.array([2.0 * reach_s if rests else 0.0]))
    held, held_from_s = _sought(at_s, values, reach_s, _HELD * reach_s)
    if held < _CLEARER * left:
        left, corner_s = held, held_from_s
    if left > 0.05 * total or abs(corner_s) > 0.55 * reach_s:
        return None
    return corner_s


def _sought(at_s: FloatArray, values: FloatArray, reach_s: float, holds_s: FloatArray) -> tuple[float, float]:
    """Return the least squared misfit of two lines with a hold between them, of those to try, s, and the corner, s."""
    corners_s, is_free = 0.6 * reach_s * np.linspace(-1.0, 1.0, 41), holds_s.size > 1
    left, corner_s = math.inf, 0.0
    for step_s in [*(_FINER * reach_s).tolist(), 0.0]:
        corners, holds = (one.ravel() for one in np.meshgrid(corners_s, holds_s))
        misfits = _hinges(at_s, values, corners, holds)
        best = int(np.argmin(misfits))
        left, corner_s, hold_s = float(misfits[best]), float(corners[best]), float(holds[best])
        corners_s = corner_s + step_s * np.linspace(-1.0, 1.0, 21)
        if is_free:
            holds_s = np.maximum(hold_s + 4.0 * step_s * np.linspace(-1.0, 1.0, 17), 0.0)
    return left, corner_s


def _hinges(at_s: FloatArray, values: FloatArray, corners_s: FloatArray, holds_s: FloatArray) -> FloatArray:
    """Squared misfits of two lines with a hold between them, shape (c,) as the corners."""
    since_s = at_s - corners_s[:, None]
    beyond_s = np.maximum(since_s - holds_s[:, None], 0.0)
    design = np.stack([np.ones_like(since_s), np.minimum(since_s, 0.0), beyond_s], axis=-1)
    answer = design.transpose(0, 2, 1) @ values
    normal = design.transpose(0, 2, 1) @ design
    held = _FLAT * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    found = np.linalg.solve(normal + held, answer[..., None])[..., 0]
    return np.asarray(values @ values - np.sum(answer * found, axis=-1))
