"""Passes: the stem's ways over the travel in steady motion, sorted by the rate of the ramp."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.phases import After, Stretch
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.stops import rows_off_stops
from estimators.motion.uniform_motion import UniformMotion, steady_rows
from estimators.samples import FloatArray, IntArray, Samples
from valve.nameplate import Action

# Own choices.
_RATES_APART: Final = 1.2  # rates that differ by less than this factor are one
_LONGEST_SETTLING: Final = 0.4  # of a stretch, as in the steady motion of the two methods
_EARLY_SHARE: Final = 0.1  # of a stretch, at its start: left out of a first line
_OFF_LINE: Final = 0.01  # of the force's change: what a ramp may be off its line
_WINDOW_UNEVEN: Final = 0.15  # of a stretch in which a transient is looked for where the friction varies
_TRANSIENT_LEFT: Final = 1.0e-4  # of the friction: what may be left of a transient where the settled part begins
_MOST_LEFT: Final = 2.0e-3  # of the friction: a way on which more than that is left never settled
_SURE_OF_A_TRANSIENT: Final = 25.0  # fall of chi-square that a transient must bring
_UNSTEADY: Final = 0.25  # by which the speed may miss that of the ramp: a stem after a step misses it by all of it
_BINS: Final = 120
_FEWEST_ROWS: Final = 8
_EVEN: Final = 3.0  # noises, that rows in uniform motion may lie off the line
_EVEN_SHARE: Final = 1.0e-3  # of the friction, that they may besides: ten times what is left of a transient


@dataclass(frozen=True, slots=True)
class StartLine:
    """F = k x + F_0 +- A as a start, N/m and N; ``even``: the motion was uniform and hardly left the line."""

    spring_n_per_m: float
    preload_n: float
    friction_n: float
    even: bool


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """One way in one direction: the rows in settled motion, the lowest and the highest travel of them, m."""

    rows: IntArray
    direction: int
    low_m: float
    high_m: float


@dataclass(frozen=True, slots=True, eq=False)
class PassesAtRate:
    """All passes at one rate of the force, N/s, with their median speed, m/s.

    ``left_n`` bounds what is left of the transients where a pass begins, ``transient_n`` its part in the mean.
    """

    passes: tuple[Pass, ...]
    rate_n_per_s: float
    speed_m_per_s: float
    left_n: float
    transient_n: float

    def towards(self, direction: int) -> tuple[Pass, ...]:
        """The passes in this direction."""
        return tuple(one for one in self.passes if one.direction == direction)


@dataclass(frozen=True, slots=True)
class _Transient:
    """A force that is off by ``height_n`` after breakaway and settles with the time constant ``time_s``."""

    height_n: float
    time_s: float


def start_line(motion: RecordedMotion) -> StartLine | None:
    """Return the line of uniform motion, or that of all motion on straight ramps where friction varies over travel.

    None where there is no motion on straight ramps both ways.
    """
    uniform = motion.uniform
    if uniform is not None:
        preload_n = uniform.preload_n
        both_ways = preload_n is not None or motion.action is Action.DOUBLE
        even = not lies_off(motion, uniform, _EVEN, _EVEN_SHARE)
        line = StartLine(uniform.spring_n_per_m, preload_n or 0.0, uniform.friction_n, even=even)
        return line if both_ways else None
    samples, rows, way = motion.samples, [], []
    for stretch in motion.phases.stretches:
        first = stretch.first + math.ceil(_EARLY_SHARE * (stretch.last - stretch.first))
        inside = np.arange(first, stretch.last - motion.phases.half_window)
        if stretch.driven and inside.size >= _FEWEST_ROWS and _straight(samples, inside):
            rows.append(inside)
            way.append(np.full(inside.size, float(stretch.direction)))
    if len({float(one[0]) for one in way}) < 2:
        return None
    chosen, sense = np.concatenate(rows), np.concatenate(way)
    columns = np.column_stack([samples.position_m[chosen], np.ones(chosen.size), sense])
    (spring, preload, friction), _, rank, _ = np.linalg.lstsq(columns, samples.force_n[chosen], rcond=None)
    if rank < 3 or spring <= 0.0 or friction <= 0.0:
        return None
    return StartLine(float(spring), float(preload), float(friction), even=False)


def lies_off(motion: RecordedMotion, uniform: UniformMotion, noises: float, share: float) -> bool:
    """Whether the rows of the uniform motion lie off its lines by more than these noises and this share of friction."""
    samples = motion.samples
    noise_n = math.hypot(samples.force_noise_n, uniform.spring_n_per_m * samples.position_noise_m)
    return uniform.residual_rms_n > math.hypot(noises * noise_n, share * uniform.friction_n)


def _straight(samples: Samples, rows: IntArray) -> bool:
    """Whether the force goes along a straight line over these rows."""
    time_s = samples.time_s[rows] - float(samples.time_s[rows].mean())
    force_n = samples.force_n[rows] - float(samples.force_n[rows].mean())
    slope = float(time_s @ force_n) / float(time_s @ time_s)
    off_n = float(np.sqrt(np.mean((force_n - slope * time_s) ** 2)))
    return off_n <= _OFF_LINE * abs(slope) * float(time_s[-1] - time_s[0]) + 2.0 * samples.force_noise_n


def passes_by_rate(motion: RecordedMotion, line: StartLine) -> list[PassesAtRate]:
    """Return the settled passes, the slowest rate first; a rate at which nothing settles is left out."""
    if motion.action is Action.DOUBLE:
        parts = steady_rows(motion.samples, motion.phases, motion.action)[1]
        return _without_spring(motion, parts)
    driven = [one for one in motion.phases.stretches if one.driven and _long_enough(motion, one)]
    rates = np.array([_rate(motion, stretch) for stretch in driven])
    found = []
    for chosen in _clusters(rates):
        stretches = [driven[number] for number in chosen]
        at_rate = _settled(motion, line, stretches)
        if at_rate is not None:
            found.append(at_rate)
    return found


def _long_enough(motion: RecordedMotion, stretch: Stretch) -> bool:
    inside = np.arange(stretch.first, stretch.last + 1)
    return inside.size >= _FEWEST_ROWS and _straight(motion.samples, inside[2:-2])


def _rate(motion: RecordedMotion, stretch: Stretch) -> float:
    return float(np.median(np.abs(motion.phases.force_rate[stretch.rows])))


def _clusters(rates: FloatArray) -> list[list[int]]:
    """Numbers of the stretches by rate, the slowest first."""
    clusters: list[list[int]] = []
    for number in np.argsort(rates).tolist():
        if clusters and rates[number] <= _RATES_APART * rates[clusters[-1][0]]:
            clusters[-1].append(number)
        else:
            clusters.append([number])
    return [sorted(cluster) for cluster in clusters]


def _settled(motion: RecordedMotion, line: StartLine, stretches: list[Stretch]) -> PassesAtRate | None:
    samples, half_window = motion.samples, motion.phases.half_window
    transient = _transient(motion, line, [one for one in stretches if one.after is After.BREAKAWAY])
    left_n = _TRANSIENT_LEFT * abs(line.friction_n)
    wait_s = 0.0 if transient is None else transient.time_s * math.log(max(1.0, transient.height_n / left_n))
    off_stops = rows_off_stops(samples, motion.stops)
    passes, lengths_s, rates = [], [], []
    for stretch in stretches:
        length_s = float(samples.time_s[stretch.last] - samples.time_s[stretch.first])
        if wait_s > _LONGEST_SETTLING * length_s and transient is not None:
            own_n = transient.height_n * math.exp(-_LONGEST_SETTLING * length_s / transient.time_s)
            if own_n > _MOST_LEFT * abs(line.friction_n):
                continue
            left_n = max(left_n, own_n)
        begin_s = float(samples.time_s[stretch.first]) + min(wait_s, _LONGEST_SETTLING * length_s)
        begin = int(np.searchsorted(samples.time_s, begin_s)) + (3 if wait_s > 0.0 else 0)
        rows = np.arange(begin, max(begin, stretch.last - half_window - 2), dtype=np.int64)
        rows = rows[off_stops[rows]]
        if rows.size >= _FEWEST_ROWS:
            passes.append(_pass(motion, rows, stretch.direction))
            lengths_s.append(length_s)
            rates.append(_rate(motion, stretch))
    if not passes:
        return None
    share = 0.0 if transient is None else min(1.0, transient.time_s / float(np.median(lengths_s)))
    speed = float(np.median([np.median(np.abs(motion.phases.velocity[one.rows])) for one in passes]))
    rate_n_per_s = float(np.median(rates))
    steady = rate_n_per_s / line.spring_n_per_m
    if abs(speed - steady) > _UNSTEADY * steady:
        return None
    return PassesAtRate(_merged(motion, passes), rate_n_per_s, speed, left_n if transient else 0.0, left_n * share)


def _pass(motion: RecordedMotion, rows: IntArray, direction: int) -> Pass:
    ends = 1 + min(4, rows.size // 4)
    first_m = float(np.median(motion.samples.position_m[rows[:ends]]))
    last_m = float(np.median(motion.samples.position_m[rows[-ends:]]))
    return Pass(rows, direction, min(first_m, last_m), max(first_m, last_m))


def _merged(motion: RecordedMotion, passes: list[Pass]) -> tuple[Pass, ...]:
    """Join what goes on in one direction without a way back between: a gap or a rest does not end a pass."""
    merged: list[Pass] = []
    for one in passes:
        before = merged[-1] if merged else None
        back = before is not None and any(
            stretch.direction != one.direction and before.rows[-1] < stretch.first < one.rows[0]
            for stretch in motion.phases.stretches
        )
        if before is not None and before.direction == one.direction and not back:
            rows = np.concatenate([before.rows, one.rows])
            low_m, high_m = min(before.low_m, one.low_m), max(before.high_m, one.high_m)
            merged[-1] = Pass(rows, one.direction, low_m, high_m)
        else:
            merged.append(one)
    return tuple(merged)


def _transient(motion: RecordedMotion, line: StartLine, stretches: list[Stretch]) -> _Transient | None:
    """Least squares of c + B exp(-t / tau) to the friction after breakaway, all stretches together; None if unseen."""
    samples = motion.samples
    if not stretches:
        return None
    shortest_s = min(float(samples.time_s[one.last] - samples.time_s[one.first]) for one in stretches)
    shortest_s *= 1.0 if line.even else _WINDOW_UNEVEN
    if shortest_s <= 8.0 * samples.period_s:
        return None
    edges_s = np.concatenate([[0.0], np.geomspace(1.5 * samples.period_s, shortest_s, _BINS)])
    total, count = np.zeros(_BINS), np.zeros(_BINS)
    for one in stretches:
        rows = one.rows
        time_s = samples.time_s[rows] - samples.time_s[one.first]
        friction_n = one.direction * (
            samples.force_n[rows] - line.spring_n_per_m * samples.position_m[rows] - line.preload_n
        )
        inside = time_s < edges_s[-1]
        bins = np.searchsorted(edges_s, time_s[inside], side="right") - 1
        total += np.bincount(bins, friction_n[inside], _BINS)
        count += np.bincount(bins, minlength=_BINS)
    used = count > 0
    weight, level = count[used], total[used] / count[used]
    time_s = (0.5 * (edges_s[1:] + edges_s[:-1]))[used]
    noise_n = math.hypot(line.spring_n_per_m * samples.position_noise_m, samples.force_noise_n)
    noise_n = max(noise_n, 1.0e-6 * abs(line.friction_n))
    best: tuple[float, float, float] = (-_SURE_OF_A_TRANSIENT * noise_n**2, 0.0, 0.0)
    middle = float(weight @ level) / float(weight.sum())
    # friction that varies over the travel is a trend within the window; even friction has none
    trend = time_s - float(weight @ time_s) / float(weight.sum())
    slope_power = float(weight @ (trend * trend)) if not line.even else math.inf
    for tau_s in np.geomspace(samples.period_s, 0.25 * shortest_s, 40).tolist():
        shape = np.exp(-time_s / tau_s)
        shape -= float(weight @ shape) / float(weight.sum())
        shape -= float(weight @ (shape * trend)) / slope_power * trend
        power = float(weight @ (shape * shape))
        product = float(weight @ (shape * (level - middle)))
        if power > 0.0 and -(product**2) / power < best[0]:
            best = (-(product**2) / power, abs(product) / power, tau_s)
    return _Transient(best[1], best[2]) if best[2] > 0.0 else None


def _without_spring(motion: RecordedMotion, parts: list[tuple[Stretch, slice]]) -> list[PassesAtRate]:
    """Plateaus of the speed by speed, the slowest first; the rate of the force means nothing there."""
    if not parts:
        return []
    velocity = motion.phases.velocity
    speeds = np.array([float(np.median(np.abs(velocity[rows]))) for _, rows in parts])
    found = []
    for chosen in _clusters(speeds):
        passes = [
            _pass(motion, np.arange(parts[number][1].start, parts[number][1].stop), parts[number][0].direction)
            for number in chosen
        ]
        found.append(PassesAtRate(_merged(motion, passes), 0.0, float(np.median(speeds[chosen])), 0.0, 0.0))
    return found
